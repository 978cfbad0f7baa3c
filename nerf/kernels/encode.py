"""Hash-grid lookups on the CPU: 16 samples at a time, one level after the other, so that a level's rows stay in cache.

A row of the grid is two features as bfloat16 in one 32-bit word: one gathered word per corner. Sums are float32.
"""

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from nerf.kernels.lanes import (
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

Words = npt.NDArray[np.int32]
Numbers = npt.NDArray[np.float32]


@njit(cache=True, nogil=True)
def _axis(u, resolution):  # type: ignore[no-untyped-def]
    """Return a coordinate's cell and the place in it, [0, 1]."""
    place = u * floats(np.float32(resolution))
    cell = smaller(larger(truncate(place), ints(0)), ints(resolution - 1))
    return cell, place - to_floats(cell)


@njit(cache=True, nogil=True)
def _row(number, shift, mask):  # type: ignore[no-untyped-def]
    """Return the row of a corner's number: see nerf.grid.level_shapes."""
    return (number ^ (number >> shift)) & mask


@njit(cache=True, nogil=True)
def _kept(footprint, resolution):  # type: ignore[no-untyped-def]
    """Return erf(1 / sqrt(8 (footprint resolution)^2)), absolute error below 2e-7 (Abramowitz and Stegun 7.1.26)."""
    x = floats(np.float32(0.35355339)) / larger(footprint * floats(np.float32(resolution)), floats(1e-6))
    t = floats(1.0) / fma(x, floats(0.3275911), floats(1.0))
    p = fma(t, floats(1.061405429), floats(-1.453152027))
    p = fma(t, p, floats(1.421413741))
    p = fma(t, p, floats(-0.284496736))
    p = fma(t, p, floats(0.254829592))
    return floats(1.0) - t * p * exponential(floats(0.0) - smaller(x * x, floats(80.0)))


@njit(cache=True, nogil=True)
def _encode_level(u, base, footprint, words, shape, out, first, last):  # type: ignore[no-untyped-def]
    """Interpolate one level for samples [first, last); `shape` is a row of `level_shapes`."""
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


@njit(cache=True, nogil=True)
def _spread_level(u, base, footprint, words, shape, gradient, count):  # type: ignore[no-untyped-def]
    """Add every sample's gradient to its 8 rows of one level."""
    resolution, step_y, step_z, start = shape[0], ints(shape[1]), ints(shape[2]), np.int64(shape[5])
    shift, mask = ints(shape[3]), ints(shape[4])
    rows = np.empty(8 * 16, dtype=np.int32)  # of the 8 corners of 16 samples
    pairs = np.empty(8 * 32, dtype=np.float32)  # what to add there
    for i in range(0, count, 16):
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


@njit(cache=True, nogil=True, parallel=True)
def encode(
    u: Numbers, base: Words, footprint: Numbers, words: Words, shapes: Words, out: Words, threads: int, parts: int
) -> None:
    """Interpolate all levels.

    u (3, m), m a multiple of 16; base (m,) first row of the sample's table, or empty; footprint (m,) or empty; words
    (rows,) of all tables; shapes (levels, 6) of `level_shapes`; out (levels, m). Each level is done in `parts`
    stretches of samples; thread t of `threads` takes every threads-th of them.
    """
    levels, count = out.shape
    stretch = (count // 16 + parts - 1) // parts * 16
    for thread in prange(threads):
        for task in range(thread, levels * parts, threads):
            level, part = task // parts, task % parts
            last = min(count, (part + 1) * stretch)
            _encode_level(u, base, footprint, words, shapes[level], out[level], part * stretch, last)


@njit(cache=True, nogil=True, parallel=True)
def spread(
    u: Numbers,
    base: Words,
    footprint: Numbers,
    words: Words,
    shapes: Words,
    rows: int,
    gradient: Numbers,
    threads: int,
) -> None:
    """Set the gradient of all tables, flat pairs, from the features' gradient `words` (levels, m); `rows` of a table.

    A level belongs to one thread: the sums are in the samples' order, whatever the number of threads.
    """
    levels, count = words.shape
    for thread in prange(threads):
        for level in range(thread, levels, threads):
            first, last = shapes[level, 5], shapes[level + 1, 5] if level + 1 < levels else rows
            for table in range(0, gradient.size // 2, rows):
                gradient[2 * (table + first) : 2 * (table + last)] = 0
            _spread_level(u, base, footprint, words[level], shapes[level], gradient, count)
