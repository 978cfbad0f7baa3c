"""Chains: with `--reuse N` a map is carried on to the next frames, and these frames are made one after the other.

A frame whose position in the whole drive is a multiple of N begins a chain, and is made whole; the N - 1 after it are
made of the one before. A chain always begins there, whatever frames are asked for: so maps do not depend on ranges,
shards, workers, or on what is cached already. Without reuse each frame is a chain of its own.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from priors.drive_around import Stretch
from priors.errors import UsageError, expect_between
from priors.selection import parse_shard
from priors.types import Drive, Frame, Method

VERSION = 2
"""Raised when carried maps change: part of the key."""
MOST = 100
"""Longest chain."""


@dataclass(frozen=True)
class Step:
    """A frame of a chain, on the way to those that are asked for."""

    position: int
    """In the whole drive."""
    index: int | None
    """In the drive that is asked for; None where the frame is only needed by later ones."""


@dataclass(frozen=True)
class Chains:
    """The chains of a drive."""

    drive: Drive
    """What is asked for: a drive, or a stretch of one."""
    length: int = 1

    @cached_property
    def whole(self) -> Drive:
        """Return the drive whose positions count: of a stretch the drive that it is of."""
        drive = self.drive
        while self.length > 1 and isinstance(drive, Stretch):
            drive = drive.drive
        return drive

    @cached_property
    def positions(self) -> list[int]:
        """Return the position in the whole drive of each frame that may be asked for."""
        if self.whole is self.drive:
            return list(range(len(self.drive)))
        places = {id_: place for place, id_ in enumerate(self.whole.ids)}
        return [places[id_] for id_ in self.drive.ids]

    def group(self, indices: Sequence[int]) -> list[list[int]]:
        """Return the indices chain by chain, in order."""
        chains: dict[int, list[int]] = {}
        for index in indices:
            chains.setdefault(self.positions[index] // self.length, []).append(index)
        return [sorted(chain) for chain in chains.values()]

    def shard(self, indices: Sequence[int], text: str | None) -> list[int]:
        """Return the indices of every n-th chain from the i-th on, for i/n; all for None."""
        part, count = parse_shard(text)
        return [index for chain in self.group(indices)[part - 1 :: count] for index in chain]

    def head(self, chain: Sequence[int]) -> str:
        """Return the id of a chain's first frame, which stands for the chain."""
        first = self.positions[chain[0]]
        return self.whole.ids[first - first % self.length]

    def steps(self, chain: Sequence[int]) -> Iterator[Step]:
        """Give the frames from a chain's first to the last that is asked for."""
        asked = {self.positions[index]: index for index in chain}
        first, last = min(asked), max(asked)
        for position in range(first - first % self.length, last + 1):
            yield Step(position, asked.get(position))

    def frame(self, step: Step) -> Frame:
        """Open a step's frame."""
        return self.whole[step.position]


def check_reuse(length: int, method: Method, frame: Frame) -> None:
    """Raise UsageError where maps cannot be carried on: a wrong length, another method, a drive without poses."""
    expect_between(1, length, MOST, "--reuse")
    if length == 1:
        return
    if not method.carries:
        raise UsageError(f"--reuse {length}: {method.name} cannot carry a map on, stereo can: leave --reuse out")
    if frame.T_world_cam is None:
        why = frame.why_unplaced()
        raise UsageError(f"--reuse {length}: maps are carried on by the poses: {why}: leave --reuse out")
