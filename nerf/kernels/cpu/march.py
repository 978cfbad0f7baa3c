"""Compiled samplers and carving: rays in parallel, each alone, so that the number of threads changes nothing.

Bit for bit what nerf/twin/sample.py and nerf/twin/space.py compute in float32: no fast-math here, and every constant is
a float32, since Python's own numbers would make a double of everything they touch.
"""

import numpy as np

from priors.machine.compiled import compiled

BOX, BALL, SPHERES = 0, 1, 2
ZERO, HALF, ONE, TWO, QUARTER = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2), np.float32(0.25)
LARGEST = np.float32(1e15)


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
    inverse = ONE / max(np.sqrt(x * x + y * y + z * z), ONE)
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
def interval(  # type: ignore[no-untyped-def]
    slot, knee, low, span, start, stop, count, band0, band1, band_count, shift, near, far
):
    """Return the ends of a candidate in s and in depth: twin.sample._edges."""
    step = slot - count - 1
    if step < 0:
        whole = np.float32(count)
        share0 = min(max((np.float32(slot - 1) + shift) / whole, ZERO), ONE)
        share1 = min(max((np.float32(slot) + shift) / whole, ZERO), ONE)
        s0, s1 = start + share0 * (stop - start), start + share1 * (stop - start)
        t0 = min(max(unramp(low + s0 * span, knee), near), far)
        if not stop > start:
            return s0, s1, t0, t0
        return s0, s1, t0, min(max(unramp(low + s1 * span, knee), near), far)
    if step > band_count or not band1 > band0:
        return ZERO, ZERO, near, near
    whole = np.float32(band_count)
    share0 = min(max((np.float32(step - 1) + shift) / whole, ZERO), ONE)
    share1 = min(max((np.float32(step) + shift) / whole, ZERO), ONE)
    t0, t1 = band0 + share0 * (band1 - band0), band0 + share1 * (band1 - band0)
    s0 = min(max((ramp(t0, knee) - low) / span, ZERO), ONE)
    return s0, min(max((ramp(t1, knee) - low) / span, ZERO), ONE), t0, t1


@compiled(error_model="numpy")
def choose(  # type: ignore[no-untyped-def]
    origins,
    directions,
    rays,
    count,
    band_count,
    slots,
    ends,
    near,
    far,
    kind,
    kept,
    resolution,
    chosen,
    counts,
    first_ray,
    last_ray,
):
    """Mark the candidates to keep, chosen (r, slots) uint8, and count them, (r,).

    rays (9, r): norm, knee, low, span, start, stop, band0, band1, shift, see twin.sample.Course; count (r,) int32; ends
    (2, r, slots) or (2, r, 0); kept: flat uint8 grid, or empty.
    """
    for ray in range(first_ray, last_ray):
        ox, oy, oz = origins[ray, 0], origins[ray, 1], origins[ray, 2]
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        knee, low, span = rays[1, ray], rays[2, ray], rays[3, ray]
        start, stop, band0, band1, shift = rays[4, ray], rays[5, ray], rays[6, ray], rays[7, ray], rays[8, ray]
        own = count[ray]
        found = 0
        for slot in range(slots):
            if ends.shape[2]:
                t0 = min(max(unramp(low + ends[0, ray, slot] * span, knee), near), far)
                t1 = min(max(unramp(low + ends[1, ray, slot] * span, knee), near), far)
            else:
                _, _, t0, t1 = interval(
                    slot, knee, low, span, start, stop, own, band0, band1, band_count, shift, near, far
                )
            keep = t1 > t0
            if keep and kept.size:
                t = (t0 + t1) * HALF
                u, v, w, table = warp(ox + t * dx, oy + t * dy, oz + t * dz, kind)
                keep = kept[cell(u, v, w, table, resolution)] > 0
            chosen[ray, slot] = keep
            found += keep
        counts[ray] = found


@compiled(error_model="numpy")
def fill(  # type: ignore[no-untyped-def]
    origins,
    directions,
    rays,
    count,
    band_count,
    ends,
    near,
    far,
    kind,
    chosen,
    offsets,
    ray_of,
    t,
    dt_m,
    s0,
    s1,
    u,
    table,
    first_ray,
    last_ray,
):
    """Write the chosen candidates, packed; u is (3, m)."""
    for ray in range(first_ray, last_ray):
        ox, oy, oz = origins[ray, 0], origins[ray, 1], origins[ray, 2]
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        norm, knee, low, span = rays[0, ray], rays[1, ray], rays[2, ray], rays[3, ray]
        start, stop, band0, band1, shift = rays[4, ray], rays[5, ray], rays[6, ray], rays[7, ray], rays[8, ray]
        own = count[ray]
        at = offsets[ray]
        for slot in range(chosen.shape[1]):
            if not chosen[ray, slot]:
                continue
            if ends.shape[2]:
                a, b = ends[0, ray, slot], ends[1, ray, slot]
                t0 = min(max(unramp(low + a * span, knee), near), far)
                t1 = min(max(unramp(low + b * span, knee), near), far)
            else:
                a, b, t0, t1 = interval(
                    slot, knee, low, span, start, stop, own, band0, band1, band_count, shift, near, far
                )
            middle = (t0 + t1) * HALF
            ray_of[at], t[at], dt_m[at], s0[at], s1[at] = ray, middle, (t1 - t0) * norm, a, b
            u[0, at], u[1, at], u[2, at], table[at] = warp(ox + middle * dx, oy + middle * dy, oz + middle * dz, kind)
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
            radius = np.sqrt(x * x + y * y + z * z)
            stretch = ONE if kind == BOX else (inside if radius < ONE else radius)
            step = HALF * side * stretch / speed
            if t < last and t + step > last:
                t = last
            else:
                t += step
