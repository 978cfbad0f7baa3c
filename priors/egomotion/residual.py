"""Residual flow: what depth and poses leave over of the flow between two frames."""

from typing import NamedTuple

import numpy as np

from priors.egomotion.corners import Corners
from priors.types import Matrix

FEWEST = 30
IN_FRONT_M = 0.5


class Residual(NamedTuple):
    """The median over corners: signed, so that noise goes and what all corners share is left, px of the image."""

    sideways_px: float
    """Above 0: things are seen to the right of where the poses put them."""
    vertical_px: float
    """Above 0: below."""


def residual(corners: Corners, T_other_this: Matrix) -> Residual | None:
    """Compare where corners are seen with where a motion (4, 4) puts them; None where they are few."""
    xyz_m = corners.xyz_m @ T_other_this[:3, :3].T + T_other_this[:3, 3]
    seen = xyz_m[:, 2] > IN_FRONT_M
    if np.count_nonzero(seen) < FEWEST:
        return None
    homogeneous = xyz_m[seen] @ corners.camera.K.T
    off_px = corners.end_px[seen] - homogeneous[:, :2] / homogeneous[:, 2:]
    sideways, vertical = np.median(off_px, axis=0).tolist()
    return Residual(sideways, vertical)
