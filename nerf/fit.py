"""Fit a model to a scene: one loop."""

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from nerf import fields
from nerf.checkpoint import Progress, resume, save
from nerf.losses import LossConfig
from nerf.model import Model, ModelConfig
from nerf.occupancy import Occupancy
from nerf.optimise import Optimiser, OptimiserConfig
from nerf.scene import Scene
from nerf.space import Space

SAVE_EVERY_S = 30.0
OCCUPANCY_EVERY = 16
LOG_EVERY = 20


@dataclass(frozen=True)
class FitConfig:
    """Everything that decides a run's outcome; config.json holds it."""

    model: ModelConfig = field(default_factory=ModelConfig)
    losses: LossConfig = field(default_factory=LossConfig)
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    rays: int = 1024
    """Rays in a step."""
    steps: int | None = None
    """Stop after so many steps: the same seed gives the same bits on a CPU, however often the run was resumed."""
    seconds: float | None = 60.0
    """Or stop after this time; how far it gets depends on the machine."""
    seed: int = 0
    """Decides weights, rays and sample positions."""


@dataclass(frozen=True)
class Status:
    """Where a fit is."""

    step: int
    elapsed_s: float
    progress: float
    """Share of the budget, [0, 1]."""
    terms: dict[str, float]
    """The last batch's losses."""
    loss: float
    """Their weighted sum."""
    rays: int
    """Rays of the last batch."""
    samples: int
    """Samples of the last batch."""
    step_s: float
    """How long the last step took."""

    @property
