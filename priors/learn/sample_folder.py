"""The folder of rendered training samples: its file names, and which of them are for validation."""

from pathlib import Path

from priors.errors import DataError

PER_WORLD = 24
"""Samples drawn of one world."""
HELD_OUT_EVERY, HELD_OUT_FIRST = 10, 3
"""Every so many-th world is for validation, from this one on."""


class SampleFolder:
    """Rendered samples, see street_samples.py: every tenth world is for validation."""

    def __init__(self, folder: Path) -> None:
        """List a folder; DataError where it has no samples to train on."""
        paths = sorted(path for path in folder.glob("*.npz") if path.stem.isdigit())
        self.train = [path for path in paths if not is_held_out(path)]
        self.validation = [path for path in paths if is_held_out(path)]
        if not self.train:
            raise DataError(f"{folder}: no samples to train on: render them with priors train samples")


def sample_path(folder: Path, number: int) -> Path:
    """Return where a sample lies."""
    return folder / f"{number:06d}.npz"


def is_held_out(path: Path) -> bool:
    """Tell whether a sample is for validation."""
    return int(path.stem) // PER_WORLD % HELD_OUT_EVERY == HELD_OUT_FIRST
