"""Fit settings: what is trained, by which losses, for how long. A run's config.json holds them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, TypeAlias

from nerf.gaussians.config import GaussianConfig
from nerf.losses import LossConfig
from nerf.optimise import OptimiserConfig
from nerf.quality import BEST
from nerf.sample import SamplerConfig
from priors.errors import LARGEST_SEED, expect, expect_between, expect_choices

MOST_RAYS, MOST_STEPS, MOST_CELLS = 1 << 20, 10**9, 1 << 20
MOST_GROWTH = 64
Align: TypeAlias = Literal["auto", "learn", "none"]
"""What is done to a prior before a fit."""


@dataclass(frozen=True)
class ModelConfig:
    """What is trained."""

    family: str = BEST
    """Which family of fields: ngp, mip360, nerfpp, splat, warp, or one of yours."""
    log2_size: int = 17
    """Rows of the hash grid's levels, as a power of two."""
    finest: int = 2048
    """Cells along an axis of the finest level; more along a path so long that its cells would be wider than 0.1 m."""
    width: int = 64
    """Neurons of the hidden layers."""
    sampler: SamplerConfig = field(default_factory=SamplerConfig)
    gaussians: GaussianConfig = field(default_factory=GaussianConfig)

    def __post_init__(self) -> None:
        expect(4 <= self.log2_size <= 24, "log2_size", self.log2_size, "4 to 24")
        expect(16 <= self.finest <= MOST_CELLS, "finest", self.finest, "16 to 2^20 cells")
        expect(self.width in range(16, 129, 16), "--width", self.width, "16, 32, 48, ..., 128 neurons")


@dataclass(frozen=True)
class FitConfig:
    """Everything that decides a run's outcome; config.json holds it."""

    model: ModelConfig = field(default_factory=ModelConfig)
    losses: LossConfig = field(default_factory=LossConfig)
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    rays: int = 1024
    """Rays in a step when the fit begins."""
    rays_growth: float | None = None
    """How many times as many there are when it ends; they grow evenly in the logarithm. 1: always as many; None: as the
    family has it where there is a prior (ngp and nerfpp 4, others 1), else 1."""
    steps: int | None = None
    """Stop after so many steps: the same seed gives the same bits on a CPU, however often the run was resumed."""
    seconds: float | None = 60.0
    """Or stop after this time; how far it gets depends on the machine."""
    seed: int = 0
    """Decides weights, rays and sample positions."""
    align: Align = "auto"
    """auto: check the prior against the posed images, bring it to their scale, and leave out what they contradict;
    learn: the same, and a scale and a shift a frame are learned with the field; none: take it as it is."""
    blocks_m: float | None = None
    """Cut the path into blocks of about this length, metres, a field each, with this budget each; None: one field."""

    BEFORE: ClassVar[Mapping[str, Any]] = {"align": "none", "rays_growth": 1.0}

    def __post_init__(self) -> None:
        expect_choices(self, "")
        expect_between(1, self.rays, MOST_RAYS, "--rays")
        if self.rays_growth is not None:
            expect(1 <= self.rays_growth <= MOST_GROWTH, "--rays-growth", self.rays_growth, f"1 to {MOST_GROWTH}")
        expect_between(1, self.steps, MOST_STEPS, "--steps")
        single = self.losses.loss in ("kl", "urf") and self.model.gaussians.rasteriser == "gsplat"
        expect(not single, "--loss", self.losses.loss, "mse, l1 or none with --rasteriser gsplat")
        timed = self.seconds is not None and 0 < self.seconds < math.inf
        expect(timed or (self.seconds is None and self.steps is not None), "--time", self.seconds, "more than 0")
        expect_between(0, self.seed, LARGEST_SEED, "--seed")
        expect(self.blocks_m is None or 1 <= self.blocks_m < math.inf, "--blocks", self.blocks_m, "metres, 1 or more")

    def progress(self, step: int, elapsed_s: float) -> float:
        """Return the spent share of the budget, [0, 1]: of the steps where they are given, else of the time."""
        if self.steps is not None:
            return min(1.0, step / self.steps)
        return min(1.0, elapsed_s / self.seconds) if self.seconds else 1.0

    def rays_at(self, progress: float, usual_growth: float) -> int:
        """Return the rays in a step at a moment of the fit, progress [0, 1]; `usual_growth`: the family's.

        The growth goes in sixteenths: N processes of r rays have together what one of N r has.
        """
        growth = usual_growth if self.rays_growth is None else self.rays_growth
        return min(MOST_RAYS, self.rays * round(16 * growth**progress) // 16)
