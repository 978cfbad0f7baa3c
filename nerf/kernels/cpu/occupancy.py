"""Upkeep of an occupancy grid, compiled: nerf/twin/occupancy.py bit for bit, in passes over flat memory."""

import numpy as np

from nerf.kernels.cpu.lanes import load_ints, shared_bits, store
from nerf.kernels.cpu.march import ONE, TWO, ZERO, cell
from nerf.types import BOX, CUBE, SPHERES
from priors.machine.compiled import compiled

FOUR = np.float32(4)
SPAN = 64
"""Cells that are looked over together: a cache line of `kept`, four of `thickness`."""


@compiled(error_model="numpy", inline="always")
def _size(x, y, z, kind):  # type: ignore[no-untyped-def]
    """Return how far out a place lies: twin.space.size."""
    if kind == CUBE:
        return max(abs(x), abs(y), abs(z))
    return np.float32(np.sqrt(np.float64(x * x + y * y + z * z)))


@compiled(error_model="numpy", inline="always")
def _stretch(x, y, z, table, kind, inner, outer, nearest):  # type: ignore[no-untyped-def]
    """Return the metres that one unit of u spans: twin.space.stretch; `nearest`: 1 / the farthest place."""
    if kind == BOX or (kind == SPHERES and table == 0):
        return inner
    x, y, z = x * FOUR - TWO, y * FOUR - TWO, z * FOUR - TWO
    radius = _size(x, y, z, kind)
    if radius > ONE:
        factor = (ONE / max(TWO - radius, nearest)) / max(radius, ONE)
        radius = _size(x * factor, y * factor, z * factor, kind)
    radius = max(radius, ONE)
    return outer * (radius * radius)


@compiled(error_model="numpy")
def note(thickness, u, table, sigma, resolution, extent, decay):  # type: ignore[no-untyped-def]
    """Note densities (m,) at u (3, m) in flat cells; extent: see nerf.kernels.cpu.sample, _extent.

    Decayed values are read before any is written: a cell with many samples decays once.
    """
    kind, inner, outer, nearest, air = extent
    count = sigma.size
    where, found, decayed = np.empty(count, np.int64), np.empty(count, np.float32), np.empty(count, np.float32)
    size = np.float32(resolution)
    for i in range(count):
        x, y, z = u[0, i], u[1, i], u[2, i]
        where[i] = cell(x, y, z, np.int64(table[i]), resolution)
        thick = sigma[i] * _stretch(x, y, z, table[i], kind, inner, outer, nearest) / size
        found[i] = max(thick, sigma[i] * air)
        decayed[i] = thickness[where[i]] * decay
    for i in range(count):
        thickness[where[i]] = decayed[i]
    for i in range(count):
        thickness[where[i]] = max(thickness[where[i]], found[i])


@compiled(error_model="numpy")
def stretch(u, table, extent, out, first, last):  # type: ignore[no-untyped-def]
    """Fill out (n,) with the metres that one unit of u (3, n) spans."""
    kind, inner, outer, nearest, _ = extent
    for i in range(first, last):
        out[i] = _stretch(u[0, i], u[1, i], u[2, i], table[i], kind, inner, outer, nearest)


@compiled(inline="always")
def _unseen(thickness, start, last):  # type: ignore[no-untyped-def]
    """Tell whether SPAN cells from `start` on lie before `last`, and none was looked at: their signs say so."""
    if start + SPAN > last:
        return False
    one = load_ints(thickness, start) & load_ints(thickness, start + 16)
    two = load_ints(thickness, start + 32) & load_ints(thickness, start + 48)
    return shared_bits(one & two) < 0


@compiled(error_model="numpy")
def total(thickness, sums, first, last):  # type: ignore[no-untyped-def]
    """Set sums (2,) to the sum and the number of the cells first to last that were looked at: from 0 on.

    After carving, most cells never are: SPAN of them are passed together, here and in `prune`.
    """
    thick, count = 0.0, 0
    for start in range(first, last, SPAN):
        if not _unseen(thickness, start, last):
            for i in range(start, min(start + SPAN, last)):
                if thickness[i] >= ZERO:
                    thick += np.float64(thickness[i])
                    count += 1
    sums[0], sums[1] = thick, count


@compiled(error_model="numpy")
def prune(thickness, allowed, limit, kept, first, last):  # type: ignore[no-untyped-def]
    """Keep the allowed cells of first to last that are thicker than the limit, or below 0: never looked at."""
    for start in range(first, last, SPAN):
        if _unseen(thickness, start, last):
            store(kept, start, load_ints(allowed, start))
        else:
            for i in range(start, min(start + SPAN, last)):
                kept[i] = allowed[i] if thickness[i] > limit or thickness[i] < ZERO else np.uint8(0)
