"""How a network is trained: flags of the command line, and the record of a run."""

import math
from dataclasses import dataclass

from priors.errors import DataError


@dataclass(frozen=True)
class TrainConfig:
    """How long and how fast to learn."""

    minutes: float = 60.0
    """Time to train for, validation included; a run that is gone on with counts what it had."""
    steps: int | None = None
    """Steps to train for instead of minutes."""
    lr: float = 1e-3
    """Largest learning rate, reached after the warm-up; it falls as a cosine to a hundredth."""
    warm_up: int = 200
    """Steps in which the learning rate rises."""
    weight_decay: float = 1e-2
    """Decay of AdamW, on convolution weights only."""
    clip: float = 1.0
    """Largest norm of the gradient; larger ones are scaled down."""
    ema: float = 0.998
    """Share of the running average of the weights that a step keeps."""
    validate_every: int = 1000
    """Steps between validations."""
    save_s: float = 60.0
    """Seconds between checkpoints."""
    seed: int = 0
    """Decides the batches."""
    threads: int | None = None
    """CPU threads; default: as many as PyTorch is set to."""

    def __post_init__(self) -> None:
        for name in ("minutes", "lr", "clip"):
            _check(name, getattr(self, name), "above 0", 0 < getattr(self, name) < math.inf)
        for name in ("weight_decay", "save_s"):
            _check(name, getattr(self, name), "0 or more", getattr(self, name) >= 0)
        for name in ("warm_up", "seed"):
            _check(name, getattr(self, name), "0 or more", getattr(self, name) >= 0)
        _check("validate_every", self.validate_every, "1 or more", self.validate_every >= 1)
        _check("ema", self.ema, "from 0 to below 1", 0 <= self.ema < 1)
        _check("steps", self.steps, "1 or more", self.steps is None or self.steps >= 1)
        _check("threads", self.threads, "1 or more", self.threads is None or self.threads >= 1)


def _check(name: str, value: object, expected: str, holds: bool) -> None:
    if not holds:
        raise DataError(f"training: --{name.replace('_', '-')} is {value}, expected {expected}")
