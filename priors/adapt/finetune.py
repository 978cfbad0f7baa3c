"""Fine-tune the single-image network on the scene that it is asked about, for a bounded time.

Supervised by what the scene's own training views have: depth that they know (measured.py), or that they show the same
scene from posed places (video.py). Batch normalisation keeps the statistics it was trained with; the result is the
running average of the weights.
"""

import copy
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from priors.adapt.batch import Batch
from priors.errors import DataError
from priors.nets.bts import MonoOut
from priors.types import Drive

Read = TypeVar("Read")
RISE = 10
"""Fewest steps to the largest learning rate: AdamW's first ones are long, and a slow machine makes few."""
MOST_VIEWS = 40
"""Frames that take part at most, spread evenly."""


@dataclass(frozen=True)
class AdaptConfig:
    """How long and how fast to adapt."""

    seconds: float = 75.0
    """Time to adapt for, reading the views not included."""
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


def training_views(count: int, chosen: Sequence[int], hold_out: str, most: int | None = None) -> list[int]:
    """Return which of the chosen frames may take part: those not held out, thinned evenly to `most`.

    Args:
        count: frames of the drive, for the message.
        chosen: positions in the drive, in order.
        hold_out: start:stop:step as Python counts, over `chosen` (9::10: every 10th from the 10th on, as `nerf fit`
            holds out), or none.
        most: how many to return at most; None: all.
    """
    try:
        parts = [int(part) if part else None for part in hold_out.split(":")] if hold_out != "none" else [0, 0]
        out = set(chosen[slice(*parts)] if len(parts) > 1 else [chosen[parts[0] or 0]])
    except (ValueError, TypeError, IndexError) as error:
        raise DataError(f"--mono.hold-out {hold_out}: expected start:stop:step, for example 9::10, or none") from error
    kept = [index for index in chosen if index not in out]
    if not kept:
        raise DataError(f"--mono.hold-out {hold_out} leaves no frame of {count} to adapt on: hold out fewer")
    return kept if most is None else thin(kept, most)


def thin(indices: Sequence[int], most: int) -> list[int]:
    """Pick at most `most` of them, evenly."""
    picked = np.unique(np.linspace(0, len(indices) - 1, min(most, len(indices))).round().astype(int))
    return [indices[index] for index in picked]


def gather(drive: Drive, indices: Sequence[int], read: Callable[[int], Read], what: str) -> list[Read]:
    """Read what frames teach; those for which that is a DataError are left out, DataError where none is left."""
    found, reason = [], ""
    for index in indices:
        try:
            found.append(read(index))
        except DataError as error:
            reason = reason or str(error)
    if not found:
        raise DataError(f"{drive.name}: no {what} to adapt to in any training frame{': ' if reason else ''}{reason}")
    return found


def adapt(
    net: nn.Module,
    supervision: Supervision,
    config: AdaptConfig,
    on_progress: Callable[[float, float], None] = lambda done, error: None,
    bf16: bool = True,
) -> nn.Module:
    """Fine-tune a network; returns the adapted one in eval mode, the given one is not touched.

    Args:
        net: a Bts in float32.
        supervision: what the scene teaches.
        config: how long.
        on_progress: told now and then the share of the time that is used up, and the supervision's error.
        bf16: whether to compute in bf16.
    """
    trained = copy.deepcopy(net).eval().requires_grad_(True)  # eval: batch normalisation keeps its statistics
    average = copy.deepcopy(net).eval().requires_grad_(False)
    optimiser = torch.optim.AdamW(trained.parameters(), lr=config.lr, weight_decay=0.0)
    device = next(trained.parameters()).device
    rng = np.random.default_rng(config.seed)
    started, step, told, error = time.monotonic(), 0, 0.0, float("nan")
    while (done := _progress(config, step, started)) < 1:
        for group in optimiser.param_groups:
            group["lr"] = config.lr * min(1.0, 10 * done + 0.05, (step + 1) / RISE) * (1 - 0.95 * done)
        batch = {name: value.to(device) for name, value in supervision.batch(rng, config.batch).items()}
        with torch.autocast(device.type, torch.bfloat16, enabled=bf16):
            out = trained(batch["image"], batch["K"])
        total, wrong = supervision.loss(out, batch)
        optimiser.zero_grad(set_to_none=True)
        total.backward()
        if torch.isfinite(torch.nn.utils.clip_grad_norm_(trained.parameters(), 1.0)):
            optimiser.step()
        step += 1
        keep = min(config.ema, step / (step + 10))
        with torch.no_grad():
            for ours, theirs in zip(average.parameters(), trained.parameters(), strict=True):
                ours.lerp_(theirs, 1 - keep)
        now = float(wrong)
        error = now if np.isnan(error) else 0.9 * error + 0.1 * now
        if done - told >= 0.1:
            told = done
            on_progress(done, error)
    on_progress(1.0, error)
    return average


def _progress(config: AdaptConfig, step: int, started: float) -> float:
    if config.steps is not None:
        return step / max(1, config.steps)
    return (time.monotonic() - started) / max(config.seconds, 1e-6)
