"""Which method makes a drive's prior, by the sensors that the drive has and by what a bench measured on it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from priors.bench.candidates import OWN, Candidate, candidates, most_accurate
from priors.bench.results import of_drive
from priors.errors import DataError
from priors.selection import pick_middles
from priors.types import Drive, Frame, Input

LOOKED_AT = 9
"""Frames of a drive that are looked at, spread evenly."""
INPUTS: Mapping[Input, str] = {"other": "a stereo pair", "sweep": "a LiDAR", "sparse": "sparse depth maps"}
"""What decides the method, in words."""


@dataclass(frozen=True)
class MethodAdvice:
    """The method that suits a drive."""

    method: str
    reason: str
    """Why, in a few words: 'it has a stereo pair'."""
    has: tuple[str, ...]
    """What of INPUTS at least half of the frames have, in words."""
    candidate: Candidate | None = None
    """The method with its settings, where the drive's bench chose it."""


def advise_method(drive: Drive, indices: Sequence[int] | None = None, cache: Path | None = None) -> MethodAdvice:
    """Choose a method: the most accurate of the drive's own bench, else by what at least half of its frames have.

    Args:
        drive: what to make depth for.
        indices: of the frames that are asked for; default: all.
        cache: where the drive's bench may lie; None: nobody has measured it.

    Raises:
        DataError: no frame can be opened.
    """
    frames = open_some(drive, range(len(drive)) if indices is None else indices)
    had = [what for what in INPUTS if 2 * sum(frame.has(what) for frame in frames) >= len(frames)]
    has = tuple(INPUTS[what] for what in had)
    best = None if cache is None else _measured_best(drive, frames[0], cache)
    if best is not None:
        return MethodAdvice(best.method.name, "the most accurate of the drive's bench", has, best)
    if "other" in had:
        return MethodAdvice("stereo", "it has a stereo pair", has)
    if "sparse" in had or "sweep" in had:
        source = INPUTS["sweep"] if "sweep" in had else INPUTS["sparse"]
        return MethodAdvice("completion", f"it has {source} and no stereo pair", has)
    return MethodAdvice("mono", "it has neither a stereo pair nor a LiDAR", has)


def _measured_best(drive: Drive, frame: Frame, cache: Path) -> Candidate | None:
    """Return the most accurate dense method of the drive's bench; None where there is none, or nothing was scored."""
    if of_drive(cache / drive.name, drive.fingerprint()) is None:
        return None
    return most_accurate([each for each in candidates(drive, frame, cache) if each.dense and each.source == OWN])


def open_some(drive: Drive, indices: Sequence[int]) -> list[Frame]:
    """Open a few frames that are spread evenly; DataError where none of all can be opened."""
    frames, reason = [], DataError(f"{drive.name}: no frames: `priors check` tells what the drive lacks")
    for index in pick_middles(indices, LOOKED_AT) if indices else []:
        try:
            frames.append(drive[index])
        except DataError as error:
            reason = error
    if not frames:
        raise reason
    return frames
