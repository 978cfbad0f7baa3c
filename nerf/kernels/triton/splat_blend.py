"""Blending on GPUs, near to far: a tile a program, a few Gaussians at a time. Equals nerf/twin/splat.py, `blend`.

Arrays are (CHUNK, pixels): a thread has some pixels, and a chunk's Gaussians of each. With keep = 1 - alpha and T the
product of keep up to and with a Gaussian, the light that arrives at it is T + w, its weight w = T alpha / keep.
"""

import triton
import triton.language as tl

from nerf.gaussians.types import MOST_ALPHA
from nerf.kernels.triton import splat_project as record

SIDE = tl.constexpr(record.TILE_PX)
_MOST_ALPHA = tl.constexpr(MOST_ALPHA)
_BEYOND, _NEVER = tl.constexpr(1e30), tl.constexpr(-1e30)


@triton.jit
def pixels(width, height, across, ROWS: tl.constexpr):  # type: ignore[no-untyped-def]
    """Return the program's tile, its pixels' columns, rows and numbers, and which are in the image.

    A program has ROWS rows of a tile: the second number of the program says which.
    """
    tile = tl.program_id(0)
    lane = tl.arange(0, SIDE * ROWS)
    column = tile % across * SIDE + lane % SIDE
    row = tile // across * SIDE + tl.program_id(1) * ROWS + lane // SIDE
    return tile, column, row, row.to(tl.int64) * width + column, (column < width) & (row < height)


@triton.jit
def chunk(members, at, end, records, COUNT: tl.constexpr):  # type: ignore[no-untyped-def]
    """Return which Gaussians come next, where their records are, and which of them are there."""
    k = at + tl.arange(0, COUNT)
    here = k < end
    which = tl.load(members + k, mask=here, other=0).to(tl.int64)
    return which, records + record.RECORD * which, here


@triton.jit
def stopped(own, here, column, row, rest, least_log, enough):  # type: ignore[no-untyped-def]
    """Return of a chunk's Gaussians at each pixel, (CHUNK, pixels): dx, dy, and the share alpha of the light that they
    stop, before it is held to MOST_ALPHA; alpha / keep; the weight; and what of the light is left behind.

    The last three know where a pixel is finished.
    """
    dx = column.to(tl.float32)[None, :] - tl.load(own + record.X, mask=here, other=0.0)[:, None]
    dy = row.to(tl.float32)[None, :] - tl.load(own + record.Y, mask=here, other=0.0)[:, None]
    along = tl.load(own + record.XX, mask=here, other=0.0)[:, None] * dx
    along += tl.load(own + record.XY, mask=here, other=0.0)[:, None] * dy
    across = tl.load(own + record.YY, mask=here, other=0.0)[:, None] * dy
    log = along * dx + (across * dy + tl.load(own + record.LOG, mask=here, other=_NEVER)[:, None])
    alpha = tl.where(log >= least_log, tl.exp2(tl.minimum(log, 1.0)), 0.0)
    held = tl.minimum(alpha, _MOST_ALPHA)
    after = rest[None, :] * tl.cumprod(1 - held, axis=0)
    odds = held / (1 - held)
    weight = after * odds
    finished = after + weight < enough
    odds, weight = tl.where(finished, 0.0, odds), tl.where(finished, 0.0, weight)
    return dx, dy, alpha, odds, weight, tl.where(finished, rest[None, :], after)


@triton.jit
def column_of(own, here, WHICH: tl.constexpr):  # type: ignore[no-untyped-def]
    """Return a number of each record, (CHUNK, 1)."""
    return tl.load(own + WHICH, mask=here, other=0.0)[:, None]


@triton.jit
def draw(  # type: ignore[no-untyped-def]
    records, members, starts, least_log, enough, width, height, across, rgb, depth_sum, opacity, median_m,
    MEDIAN: tl.constexpr, ROWS: tl.constexpr, COUNT: tl.constexpr,
):  # fmt: skip
    """Fill rgb (h, w, 3), before black, depth_sum, opacity, and where MEDIAN median_m (h, w).

    members: the Gaussians of all tiles, near first; a tile's are starts[tile] to starts[tile + 1] - 1.
    """
    tile, column, row, pixel, inside = pixels(width, height, across, ROWS)
    at, end = tl.load(starts + tile), tl.load(starts + tile + 1)
    rest = inside.to(tl.float32)
    red, green, blue = tl.zeros_like(rest), tl.zeros_like(rest), tl.zeros_like(rest)
    depth, middle = tl.zeros_like(rest), tl.zeros_like(rest)
    most = tl.max(rest, axis=0)
    while (at < end) & (most >= enough):
        _, own, here = chunk(members, at, end, records, COUNT)
        _, _, _, _, weight, after = stopped(own, here, column, row, rest, least_log, enough)
        red += tl.sum(weight * column_of(own, here, record.RED), axis=0)
        green += tl.sum(weight * column_of(own, here, record.RED + 1), axis=0)
        blue += tl.sum(weight * column_of(own, here, record.RED + 2), axis=0)
        depth += tl.sum(weight * column_of(own, here, record.CAPPED), axis=0)
        if MEDIAN:
            crosses = (weight > 0) & (after + weight > 0.5) & (after <= 0.5)
            found = tl.min(tl.where(crosses, column_of(own, here, record.DEPTH), _BEYOND), axis=0)
            middle = tl.where((middle == 0) & (found < _BEYOND), found, middle)
        rest = tl.min(after, axis=0)
        most = tl.max(rest, axis=0)
        at += COUNT
    tl.store(rgb + 3 * pixel, red, mask=inside)
    tl.store(rgb + 3 * pixel + 1, green, mask=inside)
    tl.store(rgb + 3 * pixel + 2, blue, mask=inside)
    tl.store(depth_sum + pixel, depth, mask=inside)
    tl.store(opacity + pixel, 1 - rest, mask=inside)
    if MEDIAN:
        tl.store(median_m + pixel, middle, mask=inside)
