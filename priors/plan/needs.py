"""Needs: what each method must read, and how many of a drive's frames have it."""

from collections.abc import Sequence
from dataclasses import dataclass

from priors import methods
from priors.errors import DataError
from priors.plan.way import open_some
from priors.types import Drive, Input, Method

WORDS: dict[Input, str] = {
    "image": "images",
    "other": "a second camera",
    "sweep": "a LiDAR",
    "sparse": "sparse depth maps",
    "truth": "true depth",
    "sky": "sky masks",
}
"""What a frame may have, in words."""


@dataclass(frozen=True)
class Need:
    """A method, what it needs, and what the drive has of that."""

    method: str
    reads: tuple[str, ...]
    """In words."""
    frames: int
    """Of those that were looked at, how many have all of it."""
    looked_at: int
    lacks: str = ""
    """Why a frame lacks it, and what to do; empty where none does."""

    @property
    def can(self) -> bool:
        """Whether it can work on at least one of the frames."""
        return self.frames > 0


@dataclass(frozen=True)
class Has:
    """What a drive has, of the frames that were looked at."""

    shares: dict[str, float]
    """Share of the frames that have each of WORDS."""
    posed: float
    """Share of the frames whose pose is known."""
    size: tuple[int, int]
    """(height, width) of the images, pixels."""


def needs(drive: Drive, indices: Sequence[int]) -> list[Need]:
    """Tell of each method whether it can work on the drive; DataError where no frame can be opened."""
    frames = open_some(drive, indices)
    found = []
    for name in methods.names():
        method = _resolved(name, drive, indices)
        lacking = [[what for what in method.reads if not frame.has(what)] for frame in frames]
        reasons = [
            frame.missing.get(what[0], f"the drive has no {what[0]}")
            for frame, what in zip(frames, lacking, strict=True)
            if what
        ]
        words = tuple(WORDS[what] for what in method.reads)
        can = sum(not what for what in lacking)
        found.append(Need(name, words, can, len(frames), next(iter(reasons), "")))
    return found


def has(drive: Drive, indices: Sequence[int]) -> Has:
    """Tell what the frames of a drive have; DataError where none can be opened."""
    frames = open_some(drive, indices)
    shares = {word: sum(frame.has(what) for frame in frames) / len(frames) for what, word in WORDS.items()}
    posed = sum(frame.T_world_cam is not None for frame in frames) / len(frames)
    return Has(shares, posed, frames[0].camera.size)


def _resolved(name: str, drive: Drive, indices: Sequence[int]) -> Method:
    """Return a method with its source decided where it says so itself (completion); else its usual settings."""
    method = methods.config_type(name)()
    if name != "completion":
        return method
    try:
        return method.resolve(open_some(drive, indices)[0])
    except DataError:
        return method
