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
            if not 0 < getattr(self, name) < math.inf:
                raise self._wrong(name, "a finite number above 0")
        for name in ("weight_decay", "save_s", "warm_up", "seed"):
            if not getattr(self, name) >= 0:
                raise self._wrong(name, "0 or more")
        for name in ("validate_every", "steps", "threads"):
            if getattr(self, name) is not None and getattr(self, name) < 1:
                raise self._wrong(name, "1 or more")
        if not 0 <= self.ema < 1:
            raise self._wrong("ema", "0 or more, and less than 1")

    def _wrong(self, name: str, expected: str) -> DataError:
        return DataError(f"training: --{name.replace('_', '-')} is {getattr(self, name)}, expected {expected}")
