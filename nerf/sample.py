"""Samplers: rays to packed samples, near to far, only where the occupancy grid has something.

    march     evenly in the space's spacing; without a grid, the uniform baseline
    guided    rays with a prior depth: half in a band around it, half in front, none behind
    resample  where a histogram of weights says so: the proposal rounds of MipNeRF-360

A `key` (seed, step) shifts each ray's candidates by a random share of an interval, the same for the same key; without
a key (rendering) they stand still.
"""

from dataclasses import replace
from typing import TypeAlias

import numpy as np
import torch
from torch import Tensor

from nerf.occupancy import Occupancy
from nerf.rays import Rays
from nerf.samples import BLOCK, Samples
from nerf.space import Space
from nerf.twin import sample as twin
from nerf.twin.sample import Course, Picked
from priors.machine import threads

Key: TypeAlias = tuple[int, int]
_SHIFTS, _UNGUIDED = 1, 2
"""Which stream of random numbers a key opens; stream 0 draws the rays."""


def march(
    rays: Rays, space: Space, occupancy: Occupancy | None = None, *, count: int = 64, key: Key | None = None
) -> Samples:
    """Sample `count` intervals of each ray, evenly in s; those whose middle is in an empty cell are left out."""
    return _pick(_course(rays, space, count, key), occupancy)


def guided(
    rays: Rays,
    space: Space,
    occupancy: Occupancy | None = None,
    *,
    count: int = 32,
    free: int = 64,
    reach: float = 0.12,
    unguided: float = 0.03,
    key: Key | None = None,
) -> Samples:
    """Sample rays near the prior's depth.

    A ray with a depth D gets count / 2 intervals in D (1 - reach) to D (1 + reach), even in depth, and count / 2 in
    front of them, even in s; nothing behind. Rays without, and a random share `unguided` of the others, march `free`
    intervals. What is in empty cells is left out.
    """
    course = _course(rays, space, free, key)
    if rays.depth_m is None:
        return _pick(course, occupancy)
    first, last = space.depth(course.start, course.knee_m), space.depth(course.stop, course.knee_m)
    band0 = torch.clamp(rays.depth_m * (1 - reach), first, last)
    band1 = torch.clamp(rays.depth_m * (1 + reach), first, last)
    led = guidable(rays.depth_m, unguided, key) & (band1 > band0)
    band0, band1 = torch.where(led, band0, 0), torch.where(led, band1, 0)
    front = count // 2
    course = replace(
        course,
        count=torch.where(led, front, free).to(torch.int32),
        stop=torch.where(led, space.spacing(band0, course.knee_m), course.stop),
        band0_m=band0,
        band1_m=band1,
        band_count=count - front,
        slots=max(free + 1, count + 2),
    )
    return _pick(course, occupancy)


def guidable(depth_m: Tensor, unguided: float, key: Key | None) -> Tensor:
    """Tell which rays (r,) their prior depth guides: those that have one, but for a random share."""
    return (depth_m > 0) & ~(_random(len(depth_m), key, _UNGUIDED, depth_m) < unguided)


def resample(
    rays: Rays,
    space: Space,
    samples: Samples,
    weights: Tensor,
    *,
    count: int,
    margin: float = 0.0,
    anneal: float = 1.0,
    occupancy: Occupancy | None = None,
    key: Key | None = None,
) -> Samples:
    """Sample `count` intervals of even mass under the weights (m,) that the rays' samples had in a round before.

    Bins are widened by `margin` (in s) and their masses raised to `anneal` first: see nerf/twin/sample.py, resample.
    """
    course = _course(rays, space, count, key)
    # All but the last end move by the same share of 1 / (count + 1), as in nerfstudio's PDF sampler.
    step = torch.arange(count + 1, device=weights.device, dtype=weights.dtype)
    shift = course.shift if key is not None else torch.full_like(course.shift, 0.5)
    targets = (step[None] + shift[:, None]) / (count + 1)
    used = slice(0, samples.used)
    histogram = samples.offsets, samples.s0[used], samples.s1[used], weights[used]
    if weights.device.type == "cpu":
        from nerf.kernels.resample import invert

        ends = np.empty((2, len(rays), count), np.float32)
        given = (*(x.contiguous().numpy() for x in histogram), targets.numpy(), margin, anneal, ends)
        threads.over(len(rays), lambda first, last: invert(*given, first, last))
        return _pick(replace(course, ends=torch.from_numpy(ends), slots=count), occupancy)
    ends_s = torch.stack(twin.resample(*histogram, targets, margin, anneal))
    return _pick(replace(course, ends=ends_s, slots=count), occupancy)


def _course(rays: Rays, space: Space, count: int, key: Key | None) -> Course:
    """Plan `count` candidates over the whole of each ray."""
    if count < 1:
        raise ValueError(f"expected at least one candidate a ray, found {count}")
    aim = space.aim(rays)
    low, span = space.limits(aim.knee_m)
    none = torch.zeros_like(aim.knee_m)
    shift = torch.ones_like(none) if key is None else 1 - _random(len(rays), key, _SHIFTS, none)
    return Course(
        origins=aim.origins,
        directions=aim.directions,
        norms=rays.norms,
        knee_m=aim.knee_m,
        low=low,
        span=span,
        start=space.spacing(aim.first_m, aim.knee_m),
        stop=space.spacing(aim.last_m, aim.knee_m),
        count=torch.full_like(none, count, dtype=torch.int32),
        band0_m=none,
        band1_m=none,
        shift=shift,
        ends=None,
        band_count=1,
        slots=count + 1,
        near_m=space.near_m,
        far_m=space.far_m,
        kind=space.code,
    )


def _random(count: int, key: Key | None, stream: int, like: Tensor) -> Tensor:
    """Return (count,) random numbers in [0, 1) of a key's stream; 1 without a key."""
    if key is None:
        return torch.ones(count, dtype=like.dtype, device=like.device)
    generator = np.random.Generator(np.random.Philox(key=list(key), counter=[0, 0, 0, stream]))
    return torch.from_numpy(generator.random(count, dtype=np.float32)).to(like)


def _pick(course: Course, occupancy: Occupancy | None) -> Samples:
    """Keep what lies in occupied cells and pad it."""
    kept, resolution = (None, 1) if occupancy is None else (occupancy.kept.reshape(-1), occupancy.resolution)
    if course.start.device.type == "cpu" and course.start.dtype == torch.float32:
        return _pick_compiled(course, kept, resolution)
    return _padded(twin.pick(course, kept, resolution))


def _room(used: int) -> int:
    """Round up to whole blocks, at least one: nothing after this has to think of empty arrays."""
    return max(1, -(-used // BLOCK)) * BLOCK


def _padded(picked: Picked) -> Samples:
    """Append the padding."""
    used = len(picked.t)
    room = _room(used) - used

    def pad(x: Tensor, value: float = 0) -> Tensor:
        return torch.cat([x, x.new_full((room, *x.shape[1:]), value)])

    # Feature-major memory, as the encoders read it.
    u = pad(picked.u).T.contiguous().T
    return Samples(
        picked.offsets,
        pad(picked.ray, -1),
        pad(picked.t),
        pad(picked.dt_m),
        pad(picked.s0),
        pad(picked.s1),
        u,
        pad(picked.table),
        used,
    )


def _pick_compiled(course: Course, kept: Tensor | None, resolution: int) -> Samples:
    """Do what twin.pick does, compiled."""
    from nerf.kernels.march import choose, fill

    count, rows = len(course.start), (
        course.norms, course.knee_m, course.low, course.span, course.start,
        course.stop, course.band0_m, course.band1_m, course.shift,
    )  # fmt: skip
    along = torch.stack(rows).numpy()
    origins, directions, counts = (x.contiguous().numpy() for x in (course.origins, course.directions, course.count))
    ends = np.empty((2, count, 0), np.float32) if course.ends is None else course.ends.numpy()
    grid = np.empty(0, np.uint8) if kept is None else kept.numpy()
    near, far = np.float32(course.near_m), np.float32(course.far_m)
    chosen, found = np.empty((count, course.slots), np.uint8), np.empty(count, np.int64)
    given = (origins, directions, along, counts, course.band_count)
    asked = (*given, course.slots, ends, near, far, course.kind, grid, resolution, chosen, found)
    threads.over(count, lambda first, last: choose(*asked, first, last))
    offsets = np.concatenate([np.zeros(1, np.int64), np.cumsum(found)])
    used = int(offsets[-1])
    m = _room(used)
    ray, table, u = np.empty(m, np.int32), np.empty(m, np.int32), np.empty((3, m), np.float32)
    t, dt_m, s0, s1 = (np.empty(m, np.float32) for _ in range(4))
    packed = (ray, t, dt_m, s0, s1, u, table)
    wanted = (*given, ends, near, far, course.kind, chosen, offsets, *packed)
    threads.over(count, lambda first, last: fill(*wanted, first, last))
    for array in packed:
        array[..., used:] = -1 if array is ray else 0
    tensor = torch.from_numpy
    return Samples(
        tensor(offsets), tensor(ray), tensor(t), tensor(dt_m), tensor(s0), tensor(s1), tensor(u).T, tensor(table), used
    )
