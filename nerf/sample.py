"""Samplers: rays to packed samples, near to far, only where the occupancy grid has something.

    march     evenly in the space's spacing; without a grid, the uniform baseline
    guided    rays with a prior depth: half in a band around it, half in front, none behind
    resample  where a histogram of weights says so: the proposal rounds of MipNeRF-360

A `key` (seed, step) shifts each ray's candidates by a random share of an interval, the same for the same key; without
a key (rendering) they stand still.
"""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from nerf.kernels import kernels_for
from nerf.occupancy import Occupancy
from nerf.space import Space
from nerf.types import Course, Key, Rays, Samples

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
    ends = kernels_for(weights.device).sample.resample(samples, weights, targets, margin, anneal)
    return _pick(replace(course, ends=ends, slots=count), occupancy)


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
    return kernels_for(course.start.device).sample.pick(course, kept, resolution)
