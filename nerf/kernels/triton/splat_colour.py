"""Colours of Gaussians from where they are seen, on GPUs, a Gaussian a thread. Equals nerf/twin/splat.py, `colours`.

The harmonics are those of nerf/harmonics.py.
"""

import triton
import triton.language as tl

from nerf.kernels.triton import splat_shape as shape

_Y0, _Y1 = tl.constexpr(0.28209479177387814), tl.constexpr(0.48860251190291987)
_Y20, _Y21, _Y22 = tl.constexpr(1.0925484305920792), tl.constexpr(0.31539156525252005), tl.constexpr(0.5462742152960396)
_Y30, _Y31, _Y32 = tl.constexpr(0.5900435899266435), tl.constexpr(2.890611442640554), tl.constexpr(0.4570457994644658)
_Y33, _Y34 = tl.constexpr(0.3731763325901154), tl.constexpr(1.445305721320277)
_LEAST_M = tl.constexpr(1e-12)
"""What is seen from nearer has no direction."""


@triton.jit
def direction(away):  # type: ignore[no-untyped-def]
    """Return unit directions, and 1 / length."""
    inverse = 1 / tl.maximum(tl.sqrt(shape.dot(away, away)), _LEAST_M)
    return shape.times(away, inverse), inverse


@triton.jit
def harmonic(unit, K: tl.constexpr):  # type: ignore[no-untyped-def]
    """Return harmonic K of unit directions."""
    x, y, z = unit
    if K == 0:
        found = x * 0 + _Y0
    elif K == 1:
        found = -_Y1 * y
    elif K == 2:
        found = _Y1 * z
    elif K == 3:
        found = -_Y1 * x
    elif K == 4:
        found = _Y20 * x * y
    elif K == 5:
        found = -_Y20 * y * z
    elif K == 6:
        found = _Y21 * (3 * z * z - 1)
    elif K == 7:
        found = -_Y20 * x * z
    elif K == 8:
        found = _Y22 * (x * x - y * y)
    elif K == 9:
        found = -_Y30 * y * (3 * x * x - y * y)
    elif K == 10:
        found = _Y31 * x * y * z
    elif K == 11:
        found = -_Y32 * y * (5 * z * z - 1)
    elif K == 12:
        found = _Y33 * z * (5 * z * z - 3)
    elif K == 13:
        found = -_Y32 * x * (5 * z * z - 1)
    elif K == 14:
        found = _Y34 * z * (x * x - y * y)
    else:
        found = -_Y30 * x * (x * x - 3 * y * y)
    return found


@triton.jit
def slope(unit, K: tl.constexpr):  # type: ignore[no-untyped-def]
    """Return the derivatives of harmonic K by the direction's parts, each on its own."""
    x, y, z = unit
    none = x * 0
    d_x, d_y, d_z = none, none, none
    if K == 1:
        d_y = none - _Y1
    elif K == 2:
        d_z = none + _Y1
    elif K == 3:
        d_x = none - _Y1
    elif K == 4:
        d_x, d_y = _Y20 * y, _Y20 * x
    elif K == 5:
        d_y, d_z = -_Y20 * z, -_Y20 * y
    elif K == 6:
        d_z = 6 * _Y21 * z
    elif K == 7:
        d_x, d_z = -_Y20 * z, -_Y20 * x
    elif K == 8:
        d_x, d_y = 2 * _Y22 * x, -2 * _Y22 * y
    elif K == 9:
        d_x, d_y = -6 * _Y30 * x * y, -3 * _Y30 * (x * x - y * y)
    elif K == 10:
        d_x, d_y, d_z = _Y31 * y * z, _Y31 * x * z, _Y31 * x * y
    elif K == 11:
        d_y, d_z = -_Y32 * (5 * z * z - 1), -10 * _Y32 * y * z
    elif K == 12:
        d_z = _Y33 * (15 * z * z - 3)
    elif K == 13:
        d_x, d_z = -_Y32 * (5 * z * z - 1), -10 * _Y32 * x * z
    elif K == 14:
        d_x, d_y, d_z = 2 * _Y34 * x * z, -2 * _Y34 * y * z, _Y34 * (x * x - y * y)
    elif K == 15:
        d_x, d_y = -3 * _Y30 * (x * x - y * y), 6 * _Y30 * x * y
    return d_x, d_y, d_z


@triton.jit
def shade(harmonics, at, unit, here, USED: tl.constexpr):  # type: ignore[no-untyped-def]
    """Return the colours, red, green, blue, of coefficients that begin at places `at`; NaN stays NaN."""
    sums = unit[0] * 0 + 0.5, unit[0] * 0 + 0.5, unit[0] * 0 + 0.5
    for k in tl.static_range(USED):
        sums = shape.plus(sums, shape.times(shape.three(harmonics, at + 3 * k, here), harmonic(unit, k)))
    red, green, blue = sums
    return tl.where(red < 0, 0.0, red), tl.where(green < 0, 0.0, green), tl.where(blue < 0, 0.0, blue)


@triton.jit
def unshade(harmonics, at, unit, d_rgb, here, d_harmonics, to, USED: tl.constexpr):  # type: ignore[no-untyped-def]
    """Write the derivatives by the coefficients to places `to` on, and return those by the direction's parts."""
    none = unit[0] * 0
    d_unit = none, none, none
    for k in tl.static_range(USED):
        shape.store_three(d_harmonics, to + 3 * k, shape.times(d_rgb, harmonic(unit, k)), here)
        pull = shape.dot(d_rgb, shape.three(harmonics, at + 3 * k, here))
        d_unit = shape.plus(d_unit, shape.times(slope(unit, k), pull))
    return d_unit
