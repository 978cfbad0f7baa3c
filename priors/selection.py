"""Which frames of a drive to work on: a range, a shard, and only those that moved."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from priors.errors import DataError, UsageError, expect
from priors.types import Drive, Frame

Item = TypeVar("Item")

LARGEST_FRAME_NUMBER = 10**7
"""Names with a larger number are times, not frame numbers."""


@dataclass(frozen=True)
class Selection:
    """Which frames of a drive to work on."""

    frames: str | None = None
    """Range a:b of frame numbers as in the file names, b not included (5:17 is 0000000005 to 0000000016); of
    positions where the file names are no frame numbers. Default: all."""
    shard: str | None = None
    """i/n with 1 <= i <= n: every n-th frame from the i-th on, so that n machines share a drive."""
    min_motion: float = 0.0
    """Skip frames in which the camera moved less than this since the last frame that was not skipped, metres; 0 = skip
    none."""

    def __post_init__(self) -> None:
        parse_range(self.frames)
        parse_shard(self.shard)
        expect(0 <= self.min_motion < float("inf"), "--min-motion", self.min_motion, "metres, 0 or more")


def parse_range(frames: str | None, flag: str = "--frames") -> tuple[int, int]:
    """Return the first number of a range a:b and the one after its last; DataError where it is none.

    A missing end is open, a single number is a range of one. The error names the flag.
    """
    if frames is None:
        return 0, LARGEST_FRAME_NUMBER
    first, colon, last = frames.partition(":")
    try:
        low = int(first) if first or not colon else 0
        high = (int(last) if last else LARGEST_FRAME_NUMBER) if colon else low + 1
    except ValueError as error:
        raise UsageError(f"{flag} {frames or repr(frames)}: expected a:b, for example 5:17") from error
    expect(0 <= low < high, flag, frames, "a:b with a below b, both 0 or more: b itself is not taken")
    return low, high


def select(ids: Sequence[str], frames: str | None, flag: str = "--frames") -> list[int]:
    """Return the indices of the frames in a range a:b (see Selection.frames).

    Raises:
        UsageError: the range is none, or no frame is in it. It names the flag.
    """
    if frames is None:
        return list(range(len(ids)))
    low, high = parse_range(frames, flag)
    numbers = _numbers(ids)
    indices = [index for index, number in enumerate(numbers) if low <= number < high]
    if not indices:
        there = f"the drive has {numbers[0]}:{numbers[-1] + 1}" if numbers else "the drive has none"
        raise UsageError(f"{flag} {frames}: no frames there; {there}")
    return indices


def range_of(ids: Sequence[str], first: int, end: int) -> str:
    """Return the range a:b (see Selection.frames) of the frames from position `first` to the one before `end`."""
    numbers = _numbers(ids)
    return f"{numbers[first]}:{numbers[end - 1] + 1}"


def _numbers(ids: Sequence[str]) -> list[int]:
    """Return the frame numbers that ranges count; positions where the ids are none."""
    numeric = all(id_.isdecimal() and int(id_) < LARGEST_FRAME_NUMBER for id_ in ids)
    return [int(id_) for id_ in ids] if numeric else list(range(len(ids)))


def parse_shard(text: str | None, flag: str = "--shard") -> tuple[int, int]:
    """Return i and n of a shard i/n; 1 and 1 for None. DataError where it is none."""
    if text is None:
        return 1, 1
    try:
        part, count = (int(word) for word in text.split("/"))
    except ValueError as error:
        raise UsageError(f"{flag} {text or repr(text)}: expected i/n, for example 1/4") from error
    expect(1 <= part <= count, flag, text, "i/n with i from 1 to n")
    return part, count


def shard(items: Sequence[Item], text: str | None) -> list[Item]:
    """Return every n-th item from the i-th on, for i/n; all for None."""
    part, count = parse_shard(text)
    return list(items[part - 1 :: count])


def pick_middles(items: Sequence[Item], most: int) -> list[Item]:
    """Return at most `most` items, spread evenly: from the middles of as many stretches."""
    step = max(1, len(items) // most)
    return list(items[step // 2 :: step][:most])


def parse_hold_out(text: str) -> slice | int | None:
    """Return what start:stop:step, or a single position, cuts out as Python counts; None for `none`."""
    if text == "none":
        return None
    try:
        parts = [int(part) if part else None for part in text.split(":")]
        if len(parts) == 1:
            return int(text)
        cut = slice(*parts)
        if cut.step == 0:
            raise ValueError("a step of 0")
        return cut
    except (ValueError, TypeError) as error:
        raise UsageError(f"--mono.hold-out {text}: expected start:stop:step, for example 9::10, or none") from error


def held_out(indices: Sequence[int], text: str) -> set[int]:
    """Return those of the indices that start:stop:step cuts out; DataError where a single position is not there."""
    cut = parse_hold_out(text)
    if cut is None:
        return set()
    if isinstance(cut, slice):
        return set(indices[cut])
    expect(-len(indices) <= cut < len(indices), "--mono.hold-out", text, f"a position in {len(indices)} frames")
    return {indices[cut]}


class MotionGate:
    """Tells in which frames the camera stood still; remembers where the last other one was."""

    def __init__(self, min_motion_m: float) -> None:
        self.min_motion_m = min_motion_m
        self.last_m: npt.NDArray[np.float64] | None = None
        """(3,) position, metres."""

    def reason(self, frame: Frame) -> str | None:
        """Return why the frame is to be skipped, or None; DataError where a drive without poses is asked."""
        if self.min_motion_m <= 0:
            return None
        if frame.T_world_cam is None:
            raise DataError(f"frame {frame.id}: --min-motion needs poses: {frame.why_unplaced()}: leave it out")
        position_m = frame.T_world_cam[:3, 3]
        if self.last_m is not None:
            moved_m = float(np.linalg.norm(position_m - self.last_m))
            if moved_m < self.min_motion_m:
                return f"stood still: moved {moved_m:.2f} m"
        self.last_m = position_m
        return None


def first_readable(drive: Drive) -> Frame:
    """Return the first frame that can be opened; the last frame's DataError where none can."""
    reason = DataError(f"{drive.name}: no frames: `priors check` tells what the drive lacks")
    for index in range(len(drive)):
        try:
            return drive[index]
        except DataError as error:
            reason = error
    raise reason
