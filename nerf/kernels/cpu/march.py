"""Ray marching and carving, compiled: each ray alone, so that the number of threads changes nothing.

Bit for bit what nerf/twin/sample.py and nerf/twin/space.py compute in float32: no fast-math here, and every constant is
a float32, since Python's own numbers would make a double of everything they touch.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nerf.types import BOX, CUBE, SPHERES
from priors.machine.compiled import compiled

ZERO, HALF, ONE, TWO, QUARTER = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2), np.float32(0.25)
LARGEST = np.float32(1e15)
Floats = npt.NDArray[np.float32]


class Paths(NamedTuple):
    """Along what each ray's candidates lie, as nerf.types.Course; (r, 3) or (r,) float32 arrays."""

    origins: Floats
    directions: Floats
    norm: Floats
    knee: Floats
    low: Floats
    span: Floats
    start: Floats
    stop: Floats
    band0: Floats
    band1: Floats
    shift: Floats
    candidates: npt.NDArray[np.int32]
    band_count: int
    ends: Floats
    """(2, r, slots); or (2, r, 0): candidates lie in the stretch and the band."""
    near: np.float32
    far: np.float32
    kind: int


class Cells(NamedTuple):
    """An occupancy grid: flat uint8, or empty where every cell is kept; cells along an axis."""

    kept: npt.NDArray[np.uint8]
    resolution: int


class Packed(NamedTuple):
    """Samples to be filled, as nerf.types.Samples; (m,) arrays, u is (3, m)."""

    ray: npt.NDArray[np.int32]
    t: Floats
    dt_m: Floats
    s0: Floats
    s1: Floats
    u: Floats
    table: npt.NDArray[np.int32]


@compiled(error_model="numpy", inline="always")
def size(x, y, z, kind):  # type: ignore[no-untyped-def]
    """Return how far out a place lies: twin.space.size."""
    return max(abs(x), abs(y), abs(z)) if kind == CUBE else np.sqrt(x * x + y * y + z * z)


@compiled(error_model="numpy", inline="always")
def warp(x, y, z, kind):  # type: ignore[no-untyped-def]
    """Map a place to u and its table: twin.space.warp."""
    if kind == BOX:
        x, y, z = x * HALF + HALF, y * HALF + HALF, z * HALF + HALF
        return min(max(x, ZERO), ONE), min(max(y, ZERO), ONE), min(max(z, ZERO), ONE), 0
    largest = max(abs(x), abs(y), abs(z))
    if largest > LARGEST:
        scale = ONE / largest * LARGEST
        x, y, z = x * scale, y * scale, z * scale
    inverse = ONE / max(size(x, y, z, kind), ONE)
    if kind == SPHERES and inverse >= ONE:
        return x * HALF + HALF, y * HALF + HALF, z * HALF + HALF, 0
    factor = (TWO - inverse) * inverse
    table = 1 if kind == SPHERES else 0
    return x * factor * QUARTER + HALF, y * factor * QUARTER + HALF, z * factor * QUARTER + HALF, table


@compiled(error_model="numpy", inline="always")
def cell(u, v, w, table, resolution):  # type: ignore[no-untyped-def]
    """Return the flat index of the cell that holds u: twin.sample.cells."""
    size, last = np.float32(resolution), resolution - 1
    x, y, z = min(int(u * size), last), min(int(v * size), last), min(int(w * size), last)
    return ((table * resolution + z) * resolution + y) * resolution + x


@compiled(error_model="numpy", inline="always")
def unramp(g, knee):  # type: ignore[no-untyped-def]
    """Turn a ramp's value into a depth: twin.space.unramp."""
    return TWO * knee * g if g < HALF else knee / (TWO * (ONE - g))


@compiled(error_model="numpy", inline="always")
def ramp(t, knee):  # type: ignore[no-untyped-def]
    """Squeeze a depth into [0, 1): twin.space.ramp."""
    return t / (TWO * knee) if t < knee else ONE - knee / (TWO * t)


@compiled(error_model="numpy", inline="always")
def share(index, shift, count):  # type: ignore[no-untyped-def]
    """Return where candidate `index` of `count` ends, [0, 1]; it begins where the one before ends."""
    return min(max((np.float32(index) + shift) / np.float32(count), ZERO), ONE)


@compiled(error_model="numpy", inline="always")
def depth(s, ray, paths):  # type: ignore[no-untyped-def]
    """Map s to a depth: twin.space.depth."""
    return min(max(unramp(paths.low[ray] + s * paths.span[ray], paths.knee[ray]), paths.near), paths.far)


@compiled(error_model="numpy", inline="always")
def spacing(t, ray, paths):  # type: ignore[no-untyped-def]
    """Map a depth to s: twin.space.spacing."""
    return min(max((ramp(t, paths.knee[ray]) - paths.low[ray]) / paths.span[ray], ZERO), ONE)


@compiled(error_model="numpy", inline="always")
def interval(slot, ray, paths):  # type: ignore[no-untyped-def]
    """Return the ends of a ray's candidate in s and in depth: twin.sample._edges."""
    if paths.ends.shape[2]:
        s0, s1 = paths.ends[0, ray, slot], paths.ends[1, ray, slot]
        return s0, s1, depth(s0, ray, paths), depth(s1, ray, paths)
    count, shift = paths.candidates[ray], paths.shift[ray]
    step = slot - count - 1
    if step < 0:
        start, length = paths.start[ray], paths.stop[ray] - paths.start[ray]
        s0, s1 = start + share(slot - 1, shift, count) * length, start + share(slot, shift, count) * length
        t0 = depth(s0, ray, paths)
        return s0, s1, t0, depth(s1, ray, paths) if length > ZERO else t0
    begin, width = paths.band0[ray], paths.band1[ray] - paths.band0[ray]
    if step > paths.band_count or not width > ZERO:
        return ZERO, ZERO, paths.near, paths.near
    t0 = begin + share(step - 1, shift, paths.band_count) * width
    t1 = begin + share(step, shift, paths.band_count) * width
    return spacing(t0, ray, paths), spacing(t1, ray, paths), t0, t1


@compiled(error_model="numpy", inline="always")
def ending(slot, ray, paths):  # type: ignore[no-untyped-def]
    """Return the depth where a ray's candidate ends, of a stretch or a band: `interval`, its last value."""
    count, shift = paths.candidates[ray], paths.shift[ray]
    step = slot - count - 1
    if step < 0:
        start, length = paths.start[ray], paths.stop[ray] - paths.start[ray]
        return depth(start + share(slot, shift, count) * length, ray, paths) if length > ZERO else ZERO
    begin, width = paths.band0[ray], paths.band1[ray] - paths.band0[ray]
    if step > paths.band_count or not width > ZERO:
        return ZERO
    return begin + share(step, shift, paths.band_count) * width


@compiled(error_model="numpy", inline="always")
def _holds(t, place, direction, cells, kind):  # type: ignore[no-untyped-def]
    """Tell whether the cell at a depth on a ray is kept."""
    x, y, z = place[0] + t * direction[0], place[1] + t * direction[1], place[2] + t * direction[2]
    u, v, w, table = warp(x, y, z, kind)
    return cells.kept[cell(u, v, w, table, cells.resolution)] > 0


@compiled(error_model="numpy")
def choose(paths, cells, chosen, counts, first_ray, last_ray):  # type: ignore[no-untyped-def]
    """Mark the candidates to keep, chosen (r, slots) uint8, and count them, (r,).

    A candidate of a stretch or a band begins where the one before ends: its depth is computed once.
    """
    given = paths.ends.shape[2] > 0
    for ray in range(first_ray, last_ray):
        place = paths.origins[ray, 0], paths.origins[ray, 1], paths.origins[ray, 2]
        direction = paths.directions[ray, 0], paths.directions[ray, 1], paths.directions[ray, 2]
        band, count, begin = paths.candidates[ray] + 1, 0, ZERO
        for slot in range(chosen.shape[1]):
            if given or slot == 0 or slot == band:
                _, _, begin, end = interval(slot, ray, paths)
            else:
                end = ending(slot, ray, paths)
            keep = end > begin
            if keep and cells.kept.size:
                keep = _holds((begin + end) * HALF, place, direction, cells, paths.kind)
            chosen[ray, slot] = keep
            count += keep
            begin = end
        counts[ray] = count


@compiled(error_model="numpy")
def fill(paths, chosen, offsets, out, first_ray, last_ray):  # type: ignore[no-untyped-def]
    """Write the chosen candidates, packed."""
    for ray in range(first_ray, last_ray):
        ox, oy, oz = paths.origins[ray, 0], paths.origins[ray, 1], paths.origins[ray, 2]
        dx, dy, dz = paths.directions[ray, 0], paths.directions[ray, 1], paths.directions[ray, 2]
        at = offsets[ray]
        for slot in range(chosen.shape[1]):
            if not chosen[ray, slot]:
                continue
            s0, s1, t0, t1 = interval(slot, ray, paths)
            t = (t0 + t1) * HALF
            out.ray[at], out.t[at], out.dt_m[at], out.s0[at], out.s1[at] = ray, t, (t1 - t0) * paths.norm[ray], s0, s1
            u, v, w, table = warp(ox + t * dx, oy + t * dy, oz + t * dz, paths.kind)
            out.u[0, at], out.u[1, at], out.u[2, at], out.table[at] = u, v, w, table
            at += 1


@compiled(error_model="numpy")
def trace(origins, directions, first_m, last_m, kind, resolution, grid, first_ray, last_ray):  # type: ignore[no-untyped-def]
    """Set the cells (flat uint8 grid) that rays pass between depths first_m and last_m (r,), half a cell a step.

    Threads may set the same cell at the same time: to the same value.
    """
    side = np.float32((2 if kind == BOX else 4) / resolution)
    for ray in range(first_ray, last_ray):
        ox, oy, oz = origins[ray, 0], origins[ray, 1], origins[ray, 2]
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        speed = np.sqrt(dx * dx + dy * dy + dz * dz)
        t, last = first_m[ray], last_m[ray]
        inside = HALF if kind == SPHERES else ONE
        while t <= last:
            x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
            u, v, w, table = warp(x, y, z, kind)
            grid[cell(u, v, w, table, resolution)] = 1
            # Outside, a cell is r times as wide (and more than r times as deep).
            radius = size(x, y, z, kind)
            stretch = ONE if kind == BOX else (inside if radius < ONE else radius)
            step = HALF * side * stretch / speed
            if t < last and t + step > last:
                t = last
            else:
                t += step
