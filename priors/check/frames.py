"""Frames: gaps in their ids, sensors that lack some of them, and those that cannot be opened."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from priors.check.finding import Finding, some
from priors.errors import DataError
from priors.types import Drive, Frame


@runtime_checkable
class Listed(Protocol):
    """A drive that can say, without reading files, which scans it has."""

    def scans(self) -> Mapping[str, Sequence[str]]:
        """Map sensor (image, other, sweep, pose) to the frame ids it has."""
        ...


def judge_joins(drive: Drive) -> Iterator[Finding]:
    """Find gaps in the frame ids, and sensors that lack some of them."""
    yield Finding("ok", "frames", f"{len(drive)} frames, {drive.ids[0]} to {drive.ids[-1]}")
    gaps = _gaps(drive.ids)
    if gaps:
        yield Finding("note", "frames", f"{len(gaps)} gaps in the ids: {some(gaps)}")
    if not isinstance(drive, Listed):
        return
    for what, ids in drive.scans().items():
        there = set(ids)
        lacking = [id_ for id_ in drive.ids if id_ not in there]
        if ids and lacking:
            yield Finding("warning", "frames", f"{len(lacking)} frames have no {what}: {some(lacking)}")


def _gaps(ids: Sequence[str]) -> list[str]:
    """Return where frame numbers that mostly count by one do not; nothing for other ids (times, names)."""
    if not all(id_.isdecimal() for id_ in ids) or len(ids) < 3:
        return []
    steps = np.diff([int(id_) for id_ in ids])
    if np.median(steps) != 1:
        return []
    return [f"{ids[n]}..{ids[n + 1]}" for n in np.flatnonzero(steps > 1).tolist()]


def open_frames(drive: Drive, step: Callable[..., None]) -> tuple[list[Frame], list[Finding]]:
    """Open every frame, which reads its pose; count those that cannot be."""
    frames, errors = [], []
    for index in range(len(drive)):
        try:
            frames.append(drive[index])
        except DataError as error:
            errors.append(str(error))
        step()
    if not errors:
        return frames, []
    return frames, [Finding("fatal", "frames", f"{len(errors)} frames cannot be opened, the first: {errors[0]}")]
