"""Hash-grid lookups on the CPU: 16 samples at a time, one level after the other, so that a level's rows stay in cache.

A row of the grid is two features as bfloat16 in one 32-bit word: one gathered word per corner. Sums are float32.
"""

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.lanes import (
    add_pair,
    exponential,
    floats,
    fma,
    gather,
    high_float,
    ints,
    larger,
    load_floats,
    load_int,
    load_ints,
    low_float,
    pack,
    smaller,
    store,
    store_pairs,
    to_floats,
    truncate,
)
from priors.machine.compiled import compiled

Words = npt.NDArray[np.int32]
Numbers = npt.NDArray[np.float32]


@compiled
def _axis(u, resolution):  # type: ignore[no-untyped-def]
    """Return a coordinate's cell and the place in it, [0, 1]."""
    place = u * floats(np.float32(resolution))
    cell = smaller(larger(truncate(place), ints(0)), ints(resolution - 1))
    return cell, place - to_floats(cell)


@compiled
def _row(number, shift, mask):  # type: ignore[no-untyped-def]
    """Return the row of a corner's number: see nerf.grid.level_shapes."""
    return (number ^ (number >> shift)) & mask


@compiled
def _kept(footprint, resolution):  # type: ignore[no-untyped-def]
    """Return erf(1 / sqrt(8 (footprint resolution)^2)), absolute error below 2e-7 (Abramowitz and Stegun 7.1.26)."""
    x = floats(np.float32(0.35355339)) / larger(footprint * floats(np.float32(resolution)), floats(1e-6))
    t = floats(1.0) / fma(x, floats(0.3275911), floats(1.0))
    p = fma(t, floats(1.061405429), floats(-1.453152027))
    p = fma(t, p, floats(1.421413741))
    p = fma(t, p, floats(-0.284496736))
    p = fma(t, p, floats(0.254829592))
    return floats(1.0) - t * p * exponential(floats(0.0) - smaller(x * x, floats(80.0)))


@compiled
def encode(
    u: Numbers, base: Words, footprint: Numbers, words: Words, shape: Words, out: Words, first: int, last: int
) -> None:
    """Interpolate one level for samples first to last, multiples of 16.

    u (3, m); base (m,) first row of the sample's table, or empty; footprint (m,) or empty; words (rows,) of all tables;
    shape: the level's row of `level_shapes`; out (m,).
    """
    resolution, step_y, step_z, start = shape[0], ints(shape[1]), ints(shape[2]), np.int64(shape[5])
    shift, mask = ints(shape[3]), ints(shape[4])
    for i in range(first, last, 16):
        x, fx = _axis(load_floats(u[0], i), resolution)
        y, fy = _axis(load_floats(u[1], i), resolution)
        z, fz = _axis(load_floats(u[2], i), resolution)
        corner = x + y * step_y + z * step_z
        low, high = floats(0.0), floats(0.0)
        offset = ints(0)
        if base.size:
            offset = load_ints(base, i)
        for dz in range(2):
            wz = fz if dz else floats(1.0) - fz
            plane = corner + step_z if dz else corner
            for dy in range(2):
                wy = wz * (fy if dy else floats(1.0) - fy)
                line = plane + step_y if dy else plane
                word = gather(words, start, _row(line, shift, mask) + offset)
                weight = wy * (floats(1.0) - fx)
                low, high = fma(weight, low_float(word), low), fma(weight, high_float(word), high)
                word = gather(words, start, _row(line + ints(1), shift, mask) + offset)
                weight = wy * fx
                low, high = fma(weight, low_float(word), low), fma(weight, high_float(word), high)
        if footprint.size:
            kept = _kept(load_floats(footprint, i), resolution)
            low, high = low * kept, high * kept
        store(out, i, pack(low, high))


@compiled
def spread(
    u: Numbers,
    base: Words,
    footprint: Numbers,
    words: Words,
    shape: Words,
    end: int,
    rows_of_table: int,
    gradient: Numbers,
) -> None:
    """Set one level's gradient in all tables, flat pairs, from its features' gradient `words` (m,), in their order.

    shape: the level's row of `level_shapes`; `end`: the row of a table behind its last one.
    """
    resolution, step_y, step_z, start = shape[0], ints(shape[1]), ints(shape[2]), np.int64(shape[5])
    for table in range(0, gradient.size // 2, rows_of_table):
        gradient[2 * (table + start) : 2 * (table + end)] = 0
    shift, mask = ints(shape[3]), ints(shape[4])
    rows = np.empty(8 * 16, dtype=np.int32)  # of the 8 corners of 16 samples
    pairs = np.empty(8 * 32, dtype=np.float32)  # what to add there
    for i in range(0, len(words), 16):
        x, fx = _axis(load_floats(u[0], i), resolution)
        y, fy = _axis(load_floats(u[1], i), resolution)
        z, fz = _axis(load_floats(u[2], i), resolution)
        corner = x + y * step_y + z * step_z
        word = load_ints(words, i)
        low, high = low_float(word), high_float(word)
        if footprint.size:
            kept = _kept(load_floats(footprint, i), resolution)
            low, high = low * kept, high * kept
        offset = ints(0)
        if base.size:
            offset = load_ints(base, i)
        for dz in range(2):
            wz = fz if dz else floats(1.0) - fz
            plane = corner + step_z if dz else corner
            for dy in range(2):
                wy = wz * (fy if dy else floats(1.0) - fy)
                line = plane + step_y if dy else plane
                k = 64 * dz + 32 * dy
                weight = wy * (floats(1.0) - fx)
                store(rows, k, _row(line, shift, mask) + offset)
                store_pairs(pairs, 2 * k, weight * low, weight * high)
                weight = wy * fx
                store(rows, k + 16, _row(line + ints(1), shift, mask) + offset)
                store_pairs(pairs, 2 * k + 32, weight * low, weight * high)
        for lane in range(16):  # a sample's corners are 8 rows: no addition waits for the one before
            for k in range(lane, 128, 16):
                add_pair(gradient, start + load_int(rows, k), pairs, k)
