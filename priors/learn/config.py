"""How a network is trained: flags of the command line, and the record of a run."""

import math
from dataclasses import dataclass

from priors.errors import LARGEST_SEED, expect, expect_between
from priors.machine.threads import MOST_THREADS

MOST_STEPS = 10**9


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
    workers: int = 1
    """Threads that make batches; the batches do not depend on it. A GPU wants as many as there are cores."""
    threads: int | None = None
    """CPU threads; default: as many as PyTorch is set to."""

    def __post_init__(self) -> None:
        for name in ("minutes", "lr", "clip"):
            expect(0 < getattr(self, name) < math.inf, _flag(name), getattr(self, name), "a finite number above 0")
        for name in ("weight_decay", "save_s"):
            expect(0 <= getattr(self, name) < math.inf, _flag(name), getattr(self, name), "a finite number, 0 or more")
        for name in ("validate_every", "steps"):
            expect_between(1, getattr(self, name), MOST_STEPS, _flag(name))
        expect_between(0, self.warm_up, MOST_STEPS, "--warm-up")
        expect_between(0, self.seed, LARGEST_SEED, "--seed")
        expect_between(1, self.workers, MOST_THREADS, "--workers")
        expect_between(1, self.threads, MOST_THREADS, "--threads")
        expect(0 <= self.ema < 1, "--ema", self.ema, "0 or more, and less than 1")


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"
