"""Spherical harmonics of directions: what a colour is told about where it is seen from."""

import torch
from torch import Tensor

COUNT = 16
"""Degrees 0 to 3."""
Y0 = 0.28209479177387814
"""The harmonic of degree 0, the same in all directions."""


def harmonics(units: Tensor) -> Tensor:
    """Return the 16 real orthonormal harmonics of degrees 0 to 3 at unit directions (r, 3): (r, 16).

    Order (l, m) = (0, 0), (1, -1), (1, 0), ..., (3, 3); with the Condon-Shortley phase of the complex ones.
    """
    x, y, z = units.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    return torch.stack(
        [
            torch.full_like(x, Y0),
            -0.48860251190291987 * y,
            0.48860251190291987 * z,
            -0.48860251190291987 * x,
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (3 * zz - 1),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
            -0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (5 * zz - 1),
            0.3731763325901154 * z * (5 * zz - 3),
            -0.4570457994644658 * x * (5 * zz - 1),
            1.445305721320277 * z * (xx - yy),
            -0.5900435899266435 * x * (xx - 3 * yy),
        ],
        dim=-1,
    )
