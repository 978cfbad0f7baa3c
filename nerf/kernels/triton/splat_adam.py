"""Adam on GPUs for the Gaussians in view: rows of a few numbers, wherever they lie. Equals nerf/twin/adam.py."""

import triton
import triton.language as tl

from nerf.twin.adam import BETA_MEAN, BETA_SQUARE, EPSILON
from nerf.types import STEEPEST

_BETA_MEAN, _BETA_SQUARE, _EPSILON = tl.constexpr(BETA_MEAN), tl.constexpr(BETA_SQUARE), tl.constexpr(EPSILON)
_STEEPEST = tl.constexpr(STEEPEST)


@triton.jit
def move(  # type: ignore[no-untyped-def]
    index, parameter, gradient, mean, square, unit, count, stored, given, rate, rate_of_rest, alike, raised,
    UNITS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Move rows index (v,) of a parameter (n, stored) by its gradient (v, given); count = v * given.

    Rates are divided by 1 - beta^step of the mean, and are the row's unit (n,) times that where UNITS; the first
    `alike` columns have one, the others that of the rest. raised: 1 / (1 - beta^step) of the square.
    """
    e = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    here = e < count
    column = e % given
    i = tl.load(index + e // given, mask=here, other=0)
    at = stored * i + column
    g = tl.load(gradient + e, mask=here, other=0.0)
    g = tl.where(g > _STEEPEST, _STEEPEST, tl.where(g < -_STEEPEST, -_STEEPEST, g))
    m, v = tl.load(mean + at, mask=here, other=0.0), tl.load(square + at, mask=here, other=0.0)
    m += (1 - _BETA_MEAN) * (g - m)
    v = _BETA_SQUARE * v + (1 - _BETA_SQUARE) * g * g
    pace = tl.where(column < alike, rate, rate_of_rest)
    if UNITS:
        pace *= tl.load(unit + i, mask=here, other=0.0)
    w = tl.load(parameter + at, mask=here, other=0.0) - pace * m / (tl.sqrt(v * raised) + _EPSILON)
    tl.store(mean + at, m, mask=here)
    tl.store(square + at, v, mask=here)
    tl.store(parameter + at, w, mask=here)


@triton.jit
def straighten(index, rotations, count, BLOCK: tl.constexpr):  # type: ignore[no-untyped-def]
    """Make the quaternions of some Gaussians as long as 1."""
    k = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    here = k < count
    at = rotations + 4 * tl.load(index + k, mask=here, other=0)
    w, x = tl.load(at, mask=here, other=0.0), tl.load(at + 1, mask=here, other=0.0)
    y, z = tl.load(at + 2, mask=here, other=0.0), tl.load(at + 3, mask=here, other=0.0)
    squared = w * w + x * x + y * y + z * z
    length = tl.where(squared > 0, tl.sqrt(squared), 1.0)
    tl.store(at, w / length, mask=here)
    tl.store(at + 1, x / length, mask=here)
    tl.store(at + 2, y / length, mask=here)
    tl.store(at + 3, z / length, mask=here)
