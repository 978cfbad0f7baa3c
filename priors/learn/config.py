"""How a network is trained: flags of the command line, and the record of a run."""

from dataclasses import dataclass


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
    """CPU threads of torch; default: torch's choice."""
