"""Adam on GPUs: one pass over the numbers, with the rounded copy that the grid's lookups read."""

import triton
import triton.language as tl

from nerf.twin.adam import BETA_MEAN, BETA_SQUARE, EPSILON
from nerf.types import STEEPEST

_BETA_MEAN, _BETA_SQUARE, _EPSILON = tl.constexpr(BETA_MEAN), tl.constexpr(BETA_SQUARE), tl.constexpr(EPSILON)
_STEEPEST = tl.constexpr(STEEPEST)


@triton.jit
def adam(  # type: ignore[no-untyped-def]
    weights, gradient, mean, square, copy, count, rate, raised, COPY: tl.constexpr, BLOCK: tl.constexpr
):
    """Move weights; `rate` is divided by 1 - beta^step of the mean, `raised` is 1 / (1 - beta^step) of the square."""
    i = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    here = i < count
    g = tl.load(gradient + i, mask=here, other=0.0)
    g = tl.where(g > _STEEPEST, _STEEPEST, tl.where(g < -_STEEPEST, -_STEEPEST, g))
    m = _BETA_MEAN * tl.load(mean + i, mask=here, other=0.0) + (1 - _BETA_MEAN) * g
    v = _BETA_SQUARE * tl.load(square + i, mask=here, other=0.0) + (1 - _BETA_SQUARE) * g * g
    w = tl.load(weights + i, mask=here, other=0.0) - rate * m / (tl.sqrt(v * raised) + _EPSILON)
    tl.store(mean + i, m, mask=here)
    tl.store(square + i, v, mask=here)
    tl.store(weights + i, w, mask=here)
    if COPY:
        tl.store(copy + i, w.to(tl.bfloat16), mask=here)
