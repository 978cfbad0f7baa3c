"""Hash-grid lookups on GPUs: a program for a block of samples on one level. Equals nerf/twin/encode.py.

A row of the grid is two features as bfloat16 in one 32-bit word: one gathered word per corner. Sums are float32.
Programs of one level start together, so that its rows stay in the second-level cache.
"""

import triton
import triton.language as tl


@triton.jit
def _axis(place, resolution):  # type: ignore[no-untyped-def]
    """Return a coordinate's cell and the place in it, [0, 1]."""
    cell = tl.minimum(tl.maximum(place.to(tl.int32), 0), resolution - 1)
    return cell, place - cell.to(tl.float32)


@triton.jit
def _cell(u, sample, count, shapes, level):  # type: ignore[no-untyped-def]
    """Return a cell's level (a row of `level_shapes`), its first corner's number, and the place in it."""
    shape = shapes + 6 * level
    resolution, stride_y, stride_z = tl.load(shape), tl.load(shape + 1), tl.load(shape + 2)
    shift, mask, start = tl.load(shape + 3), tl.load(shape + 4), tl.load(shape + 5)
    x, fx = _axis(tl.load(u + sample) * resolution, resolution)
    y, fy = _axis(tl.load(u + count + sample) * resolution, resolution)
    z, fz = _axis(tl.load(u + 2 * count + sample) * resolution, resolution)
    return resolution, stride_y, stride_z, shift, mask, start, x + y * stride_y + z * stride_z, fx, fy, fz


@triton.jit
def _corner(k: tl.constexpr, first, stride_y, stride_z, shift, mask, fx, fy, fz):  # type: ignore[no-untyped-def]
    """Return the row of a cell's k-th corner, see nerf.grid.level_shapes, and its share."""
    number = first + (k & 1) + ((k >> 1) & 1) * stride_y + (k >> 2) * stride_z
    share = fx if k & 1 else 1 - fx
    share *= fy if (k >> 1) & 1 else 1 - fy
    share *= fz if k >> 2 else 1 - fz
    return (number ^ (number >> shift)) & mask, share


@triton.jit
def _kept(footprint, sample, resolution):  # type: ignore[no-untyped-def]
    """Return how much of a level samples of this size see: erf(1 / sqrt(8 (footprint resolution)^2))."""
    size = tl.maximum(tl.load(footprint + sample) * resolution, 1e-6)
    return tl.math.erf(0.35355339059327373 / size)


@triton.jit
def encode(  # type: ignore[no-untyped-def]
    u, table, footprint, words, shapes, out, count, rows,
    TABLES: tl.constexpr, FOOTPRINT: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Fill the words out (levels, count); u (3, count), words (tables, rows); grid (count / BLOCK, levels)."""
    level = tl.program_id(1)
    sample = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    resolution, stride_y, stride_z, shift, mask, start, first, fx, fy, fz = _cell(u, sample, count, shapes, level)
    if TABLES > 1:
        start = start + tl.load(table + sample) * rows
    low = tl.zeros([BLOCK], tl.float32)
    high = tl.zeros([BLOCK], tl.float32)
    for k in tl.static_range(8):
        row, share = _corner(k, first, stride_y, stride_z, shift, mask, fx, fy, fz)
        word = tl.load(words + start + row)
        low += share * (word << 16).to(tl.float32, bitcast=True)
        high += share * (word & -65536).to(tl.float32, bitcast=True)
    if FOOTPRINT:
        kept = _kept(footprint, sample, resolution)
        low *= kept
        high *= kept
    tl.store(out + level * count + sample, pack(low, high))


@triton.jit
def spread(  # type: ignore[no-untyped-def]
    u, table, footprint, words, shapes, gradient, count, rows,
    TABLES: tl.constexpr, FOOTPRINT: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add to the gradient (tables, rows, 2) from the features' gradient, words (levels, count); grid as `encode`."""
    level = tl.program_id(1)
    sample = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    resolution, stride_y, stride_z, shift, mask, start, first, fx, fy, fz = _cell(u, sample, count, shapes, level)
    if TABLES > 1:
        start = start + tl.load(table + sample) * rows
    word = tl.load(words + level * count + sample)
    # Both features side by side: Hopper adds such a pair at once.
    feature = tl.arange(0, 2)[None, :]
    pair = tl.where(feature == 0, (word << 16)[:, None], (word & -65536)[:, None]).to(tl.float32, bitcast=True)
    if FOOTPRINT:
        pair *= _kept(footprint, sample, resolution)[:, None]
    for k in tl.static_range(8):
        row, share = _corner(k, first, stride_y, stride_z, shift, mask, fx, fy, fz)
        place = (start + row)[:, None] * 2 + feature
        tl.atomic_add(gradient + place, share[:, None] * pair, sem="relaxed")


@triton.jit
def pack(low, high):  # type: ignore[no-untyped-def]
    """Round two float32 to bfloat16 (nearest, ties to even) in one 32-bit word."""
    low_bits = low.to(tl.bfloat16).to(tl.float32).to(tl.int32, bitcast=True)
    high_bits = high.to(tl.bfloat16).to(tl.float32).to(tl.int32, bitcast=True)
    return ((low_bits >> 16) & 0xFFFF) | high_bits
