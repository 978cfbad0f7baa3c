"""Fine-tuning of the single-image network on the scene that it is asked about, for a bounded time.

The scene's own training views supervise it: by depth that they know (depth_supervision.py), or because they show the
same scene from posed places (video_supervision.py). Batch normalisation keeps the statistics that it was trained with.
The result is the running average of the weights.
"""

import copy
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor, nn

from priors.adapt.training_step import Batch, WeightAverage, descend, to_device
from priors.errors import DataError
from priors.nets.bts import MonoOut

RISE = 10
"""Fewest steps to the largest learning rate: AdamW's first ones are long, and a slow machine makes few."""
LARGEST_NORM = 1.0
"""Of the gradient; larger ones are scaled down."""
AVERAGE_DELAY = 10
"""Of the running average: see training_step.WeightAverage."""


@dataclass(frozen=True)
class AdaptConfig:
    """How long and how fast to fine-tune."""

    seconds: float = 75.0
    """Time to fine-tune for, reading the views not included."""
    steps: int | None = None
    """Steps instead of seconds."""
    lr: float = 3e-4
    """Largest learning rate; it rises for a tenth of the time and falls to a twentieth."""
    batch: int = 2
    """Crops in a step."""
    ema: float = 0.98
    """Share of the running average that a step keeps."""
    seed: int = 0
    """Decides the crops."""

    def __post_init__(self) -> None:
        if not 0 < self.seconds < math.inf or (self.steps is not None and self.steps < 1):
            raise DataError(f"fine-tuning: expected seconds > 0 and steps >= 1, found {self.seconds} and {self.steps}")
        if not (0 < self.lr < math.inf and self.batch >= 1 and 0 <= self.ema < 1):
            given = f"{self.lr}, {self.batch} and {self.ema}"
            raise DataError(f"fine-tuning: expected lr > 0, batch >= 1 and ema in [0, 1), found {given}")


class Supervision(Protocol):
    """What a scene teaches."""

    @property
    def measures(self) -> str:
        """What the error in the progress is."""
        ...

    def batch(self, rng: np.random.Generator, count: int) -> Batch:
        """Make `count` crops, with image (count, 3, h, w) and K (count, 3, 3) among what they hold."""
        ...

    def loss(self, out: MonoOut, batch: Batch) -> tuple[Tensor, Tensor]:
        """Return the loss of what the network says about a batch, and the error for the progress."""
        ...


def fine_tune(
    net: nn.Module,
    supervision: Supervision,
    config: AdaptConfig,
    on_progress: Callable[[float, float], None] = lambda done, error: None,
    *,
    bf16: bool = True,
) -> nn.Module:
    """Fine-tune a network; returns the new one in eval mode, the given one is not touched.

    Args:
        net: a Bts in float32.
        supervision: what the scene teaches.
        config: how long.
        on_progress: told now and then the share of the time that is used up, and the supervision's error.
        bf16: whether to compute in bf16.
    """
    trained = copy.deepcopy(net).eval().requires_grad_(True)  # eval: batch normalisation keeps its statistics
    average = WeightAverage(net, config.ema, AVERAGE_DELAY)
    optimiser = torch.optim.AdamW(trained.parameters(), lr=config.lr, weight_decay=0.0)
    device = next(trained.parameters()).device
    rng = np.random.default_rng(config.seed)
    started, step, told, error = time.monotonic(), 0, 0.0, float("nan")
    while (done := _progress(config, step, started)) < 1:
        for group in optimiser.param_groups:
            group["lr"] = config.lr * min(1.0, 10 * done + 0.05, (step + 1) / RISE) * (1 - 0.95 * done)
        batch = to_device(supervision.batch(rng, config.batch), device)
        with torch.autocast(device.type, torch.bfloat16, enabled=bf16):
            out = trained(batch["image"], batch["K"])
        total, wrong = supervision.loss(out, batch)
        descend(total, optimiser, trained.parameters(), LARGEST_NORM)
        step += 1
        average.update(trained, step)
        now = float(wrong)
        error = now if np.isnan(error) else 0.9 * error + 0.1 * now
        if done - told >= 0.1:
            told = done
            on_progress(done, error)
    on_progress(1.0, error)
    return average.net


def _progress(config: AdaptConfig, step: int, started: float) -> float:
    if config.steps is not None:
        return step / config.steps
    return (time.monotonic() - started) / config.seconds
