"""Ray sampling: rays to packed samples, near to far, only where the occupancy grid has something.

    march     evenly in the space's spacing; without a grid, the uniform baseline
    guided    rays with a prior depth: half in a band around it, half in front, none behind
    resample  where a histogram of weights says so: the proposal rounds of MipNeRF-360

A `key` (seed, step) shifts each ray's candidates by a random share of an interval, the same for the same key; without
a key (rendering) they stand still.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from nerf.kernels import SampleKernels, kernels_for
from nerf.occupancy import Occupancy
from nerf.space import Space
from nerf.twin import space as twin
from nerf.types import Course, Histogram, Key, Rays, Samples
from nerf.world import here
from priors.errors import expect, expect_between

_SHIFTS, _UNGUIDED = 1, 2
"""Which stream of random numbers a key opens; stream 0 draws the rays."""
MOST_SAMPLES = 1 << 14
"""Of a ray."""
GROWN = 0.5
"""Share of a fit after which no more rays are freed of the prior's guidance."""


@dataclass(frozen=True)
class SamplerConfig:
    """How many samples rays get, and what they skip."""

    count: int = 16
    """Samples of a ray that the prior guides."""
    proposed: int | None = 32
    """Samples of a ray after its proposals, where no prior guides it; none: as many as `count`. With 16, a fit by
    colours alone does not learn depth."""
    free: int = 48
    """Candidates of a ray without a prior; those in empty cells are dropped."""
    render: int = 256
    """Candidates of a ray when views are rendered."""
    render_proposed: int | None = 16
    """Samples of a rendered ray after its proposals; none: as many as `proposed`. Few are enough: by then the
    proposals know where surfaces are."""
    guide: bool = True
    """Put a ray's samples around its prior depth."""
    carve: bool = True
    """Empty the space in front of the prior's surfaces before the first step."""
    carve_sky: bool = True
    """Empty what the views see the sky through, too."""
    reach: float = 0.12
    """Half width of the band of samples around the prior, as a share of its depth."""
    unguided: float = 0.03
    """Share of the rays that do not use their prior's depth when a fit begins. They find gross errors of the prior."""
    unguided_later: float = 0.5
    """The same share in the middle of a fit and after; before, it grows. Once depth is learned, samples around the
    prior cost colour. Families with proposals (mip360) keep the first share."""
    trust: float = 0.2
    """Least confidence of a prior's value that may empty space or guide samples. The losses use all values."""

    terminate: float = 1e-3
    """Transmittance below which a ray ends, in training and rendering; 0: at its last sample."""
    roulette_samples: float = 0.1
    """Least probability with which a training sample takes part in the backward pass. Samples that matter little to
    the gradient take part rarely, and count for more when they do. 1: all take part."""
    roulette_proposals: float = 0.1
    """The same for the samples of the proposals. 1: all take part."""
    proposals_every: int = 1
    """The proposals learn at every so many steps, once a fifth of the fit is done. 2 saves a twentieth of the time, and
    costs about as much. 1: at every step."""
    roulette_rays: float = 1.0
    """Least probability with which a drawn ray is trained on, for example 0.25. Rays of image parts that are learned
    already take part rarely, and count for more when they do. 1: all take part."""

    BEFORE: ClassVar[Mapping[str, Any]] = {
        "count": 32,
        "proposed": None,
        "render_proposed": None,
        "free": 64,
        "unguided_later": 0.0,
        "terminate": 0.0,
        "roulette_samples": 1.0,
        "roulette_proposals": 1.0,
        "carve_sky": False,
    }

    def __post_init__(self) -> None:
        expect_between(2, self.count, MOST_SAMPLES, "--count")
        expect_between(2, self.proposed, MOST_SAMPLES, "--proposed")
        expect_between(1, self.free, MOST_SAMPLES, "--free")
        expect_between(1, self.render, MOST_SAMPLES, "--render")
        expect_between(2, self.render_proposed, MOST_SAMPLES, "--render-proposed")
        expect(0 < self.reach < np.inf, "--reach", self.reach, "more than 0, a share of the depth")
        for name in ("unguided", "unguided_later"):
            share = getattr(self, name)
            expect(0 <= share <= 1, f"--{name.replace('_', '-')}", share, "a share from 0 to 1")
        expect(0 <= self.terminate < 0.1, "--terminate", self.terminate, "a transmittance from 0 to less than 0.1")
        expect_between(1, self.proposals_every, MOST_SAMPLES, "--proposals-every")
        for name in ("roulette_samples", "roulette_proposals", "roulette_rays"):
            least = getattr(self, name)
            expect(0 < least <= 1, f"--{name.replace('_', '-')}", least, "a probability above 0, up to 1")
        expect(0 <= self.trust <= 1, "--trust", self.trust, "a confidence from 0 to 1")

    def at(self, progress: float) -> "SamplerConfig":
        """Return the settings at a moment of a fit, progress [0, 1]: `unguided` grows until GROWN."""
        more = max(0.0, self.unguided_later - self.unguided)
        return replace(self, unguided=self.unguided + more * min(1.0, progress / GROWN))


@dataclass(frozen=True)
class Sampler:
    """Samples rays in one space."""

    space: Space
    occupancy: Occupancy | None = None
    """What is skipped; None: nothing is."""
    kernels: SampleKernels | None = None
    """Other functions than the rays' device's own fastest."""

    def march(self, rays: Rays, count: int, key: Key | None = None) -> Samples:
        """Sample `count` intervals of each ray, evenly in s; those whose middle is in an empty cell are left out."""
        return self._pick(self._course(rays, count, key))

    def guided(self, rays: Rays, config: SamplerConfig, key: Key | None = None) -> Samples:
        """Sample rays near the prior's depth.

        A ray with a depth D gets count / 2 intervals in D (1 - reach) to D (1 + reach), even in depth, and count / 2 in
        front of them, even in s; nothing behind. Rays without, and a random share `unguided` of the others, march
        `free` intervals. What is in empty cells is left out.
        """
        course = self._course(rays, config.free, key)
        if rays.depth_m is None:
            return self._pick(course)
        first, last = twin.depth(course.start, course.spacing), twin.depth(course.stop, course.spacing)
        band0 = torch.clamp(rays.depth_m * (1 - config.reach), first, last)
        band1 = torch.clamp(rays.depth_m * (1 + config.reach), first, last)
        is_guided = guidable(rays.depth_m, config.unguided, key) & (band1 > band0)
        band0, band1 = torch.where(is_guided, band0, 0), torch.where(is_guided, band1, 0)
        front = config.count // 2
        course = replace(
            course,
            count=torch.where(is_guided, front, config.free).to(torch.int32),
            stop=torch.where(is_guided, twin.spacing(band0, course.spacing), course.stop),
            band0_m=band0,
            band1_m=band1,
            band_count=config.count - front,
            slots=max(config.free + 1, config.count + 2),
        )
        return self._pick(course)

    def resample(
        self, rays: Rays, histogram: Histogram, count: int, key: Key | None = None, each: Tensor | None = None
    ) -> Samples:
        """Sample `count` intervals of even mass under the weights that a round before gave the rays' samples.

        Bins are widened and their masses raised to a power first: see nerf/twin/sample.py, resample. `each` (r,): how
        many intervals each ray gets, at most `count`; None: `count`.
        """
        course = self._course(rays, count, key)
        # All but the last end move by the same share of 1 / (count + 1), as in nerfstudio's PDF sampler.
        weights = histogram.weights
        step = torch.arange(count + 1, device=weights.device, dtype=weights.dtype)[None]
        shift = course.shift if key is not None else torch.full_like(course.shift, 0.5)
        last = weights.new_tensor([[count]]) if each is None else each.to(weights.dtype)[:, None]
        targets = (torch.minimum(step, last) + shift[:, None]) / (last + 1)  # intervals beyond a ray's last are empty
        ends = self._kernels(weights.device).resample(histogram, targets)
        return self._pick(replace(course, ends=ends, slots=count))

    def _course(self, rays: Rays, count: int, key: Key | None) -> Course:
        """Plan `count` candidates over the whole of each ray."""
        if count < 1:
            raise ValueError(f"expected at least one candidate a ray, found {count}")
        aim = self.space.aim(rays)
        none = torch.zeros_like(aim.first_m)
        return Course(
            origins=aim.origins,
            directions=aim.directions,
            norms=rays.norms,
            spacing=aim.spacing,
            start=twin.spacing(aim.first_m, aim.spacing),
            stop=twin.spacing(aim.last_m, aim.spacing),
            count=torch.full_like(none, count, dtype=torch.int32),
            band0_m=none,
            band1_m=none,
            shift=torch.ones_like(none) if key is None else 1 - _random(len(rays), key, _SHIFTS, none),
            ends=None,
            band_count=1,
            slots=count + 1,
            kind=self.space.code,
        )

    def _pick(self, course: Course) -> Samples:
        """Keep what lies in occupied cells and pad it."""
        grid = self.occupancy
        kept, resolution = (None, 1) if grid is None else (grid.kept.reshape(-1), grid.resolution)
        return self._kernels(course.start.device).pick(course, kept, resolution)

    def _kernels(self, device: torch.device) -> SampleKernels:
        return self.kernels or kernels_for(device).sample


def guidable(depth_m: Tensor, unguided: float, key: Key | None) -> Tensor:
    """Tell which rays (r,) their prior depth guides: those that have one, but for a random share."""
    return (depth_m > 0) & ~(_random(len(depth_m), key, _UNGUIDED, depth_m) < unguided)


def _random(count: int, key: Key | None, stream: int, like: Tensor) -> Tensor:
    """Return this process's (count,) random numbers in [0, 1) of a key's stream; 1 without a key."""
    if key is None:
        return torch.ones(count, dtype=like.dtype, device=like.device)
    generator = np.random.Generator(np.random.Philox(key=list(key), counter=[0, 0, 0, stream]))
    world = here()
    drawn = generator.random(count * world.size, dtype=np.float32)[world.part(count)]
    return torch.from_numpy(drawn).to(like)
