"""Gaussians into an image on GPUs: a record and a box of each, its colour, and its tiles' keys. Equals the twin."""

import triton
import triton.language as tl

from nerf.kernels.triton import splat_colour as colour
from nerf.kernels.triton import splat_shape as shape
from nerf.twin.splat import BOX_MARGIN_PX

TILE_PX = 16
"""Pixels along a side of a tile."""
RECORD_NUMBERS = 12
X, Y, XX, XY, YY, LOG = (tl.constexpr(k) for k in range(6))
RED, CAPPED, DEPTH = tl.constexpr(6), tl.constexpr(9), tl.constexpr(10)
"""What stands where in a record: the mean, pixels; the exponent's coefficients and the opacity's logarithm, base 2, so
that alpha = 2^(XX dx^2 + XY dx dy + YY dy^2 + LOG); the colour; min(z, cap) and z."""
TILE, RECORD = tl.constexpr(TILE_PX), tl.constexpr(RECORD_NUMBERS)
LEAST_DET = tl.constexpr(1.2e-38)
_TO_BASE_2, _MARGIN_PX = tl.constexpr(1.4426950408889634), tl.constexpr(BOX_MARGIN_PX)


@triton.jit
def project(  # type: ignore[no-untyped-def]
    means_m, log_scales, rotations, opacities, lens, width, height, count, records, boxes, tiles,
    COMPENSATE: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Fill the records (count, RECORD), boxes (count, 4) and numbers of tiles (count,), 0 of what is not in view."""
    i = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    here = i < count
    p, _ = shape.place(means_m, lens, i, here)
    near = p[2] >= tl.load(lens + shape.NEAR)
    z = tl.where(near, p[2], 1.0)
    x, y = p[0] / z, p[1] / z
    tx, _ = shape.held(x, lens, shape.REACH_X)
    ty, _ = shape.held(y, lens, shape.REACH_Y)
    q, _ = shape.quaternion(rotations, i, here)
    s, _ = shape.scales(log_scales, i, here)
    row0, row1, _ = shape.rows(lens, z, tx, ty, shape.scaled(shape.turned(lens, q), s))
    a, b, c, area, det, _ = shape.covariance(lens, row0, row1)
    some = det >= LEAST_DET
    safe = tl.where(some, det, 1.0)
    opacity = shape.logistic(tl.load(opacities + i, mask=here, other=0.0))
    if COMPENSATE:
        opacity *= tl.sqrt(area / safe)
    least = tl.load(lens + shape.LEAST_ALPHA)
    seen = here & near & some & (opacity >= least)
    log, log_least = tl.log2(tl.where(seen, opacity, 1.0)), tl.log2(least)
    double = 2 / _TO_BASE_2 * tl.maximum(log - log_least, 0.0)
    mx = x * tl.load(lens + shape.FOCAL) + tl.load(lens + shape.MIDDLE)
    my = y * tl.load(lens + shape.FOCAL + 1) + tl.load(lens + shape.MIDDLE + 1)
    left, right = _span(mx, tl.sqrt(double * a) + _MARGIN_PX, width)
    top, bottom = _span(my, tl.sqrt(double * c) + _MARGIN_PX, height)
    seen &= (right >= left) & (bottom >= top)
    scale = _TO_BASE_2 / safe
    at = RECORD * i
    tl.store(records + at + X, mx, mask=seen)
    tl.store(records + at + Y, my, mask=seen)
    tl.store(records + at + XX, -0.5 * scale * c, mask=seen)
    tl.store(records + at + XY, scale * b, mask=seen)
    tl.store(records + at + YY, -0.5 * scale * a, mask=seen)
    tl.store(records + at + LOG, log, mask=seen)
    tl.store(records + at + CAPPED, tl.minimum(z, tl.load(lens + shape.CAP)), mask=seen)
    tl.store(records + at + DEPTH, z, mask=seen)
    left, right = tl.where(seen, left, 0.0).to(tl.int32), tl.where(seen, right, 0.0).to(tl.int32)
    top, bottom = tl.where(seen, top, 0.0).to(tl.int32), tl.where(seen, bottom, 0.0).to(tl.int32)
    tl.store(boxes + 4 * i, left, mask=seen)
    tl.store(boxes + 4 * i + 1, right, mask=seen)
    tl.store(boxes + 4 * i + 2, top, mask=seen)
    tl.store(boxes + 4 * i + 3, bottom, mask=seen)
    found = (right // TILE - left // TILE + 1) * (bottom // TILE - top // TILE + 1)
    tl.store(tiles + i, tl.where(seen, found, 0), mask=here)


@triton.jit
def _span(middle, half, size):  # type: ignore[no-untyped-def]
    """Return the first and the last pixel within half of the middle, as floats; last < first: none. NaN stays NaN."""
    low, high = tl.ceil(middle - half), tl.floor(middle + half)
    last = (size - 1) * 1.0  # Triton takes a size of 1 for a constant, which has no type to be changed
    return tl.where(low < 0, 0.0, tl.where(low > last, last + 1, low)), tl.where(high > last, last, high)


@triton.jit
def shade(  # type: ignore[no-untyped-def]
    index, means_m, harmonics, lens, count, stored, records, USED: tl.constexpr, BLOCK: tl.constexpr
):
    """Write the colours of the Gaussians index (count,) into their records (count, RECORD)."""
    k = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    here = k < count
    i = tl.load(index + k, mask=here, other=0)
    _, away = shape.place(means_m, lens, i, here)
    unit, _ = colour.direction(away)
    red, green, blue = colour.shade(harmonics, 3 * stored * i, unit, here, USED)
    shape.store_three(records, RECORD * k + RED, (red, green, blue), here)


@triton.jit
def enlist(  # type: ignore[no-untyped-def]
    owners, first, records, boxes, across, count, keys, BLOCK: tl.constexpr
):
    """Fill keys (count,): the tile's number and the depth's bits, of each tile of each Gaussian.

    owners (count,): which Gaussian in view; first: where each one's begin.
    """
    e = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    here = e < count
    k = tl.load(owners + e, mask=here, other=0).to(tl.int64)
    turn = (e - tl.load(first + k, mask=here, other=0)).to(tl.int32)
    left = tl.load(boxes + 4 * k, mask=here, other=0) // TILE
    wide = tl.load(boxes + 4 * k + 1, mask=here, other=0) // TILE - left + 1
    top = tl.load(boxes + 4 * k + 2, mask=here, other=0) // TILE
    tile = (top + turn // wide) * across + left + turn % wide
    # a depth is above 0, so its bits are in its order
    bits = tl.load(records + RECORD * k + DEPTH, mask=here, other=0.0).to(tl.int32, bitcast=True)
    tl.store(keys + e, tile.to(tl.int64) * 4294967296 + bits, mask=here)
