"""Which frames a page pictures, how large, and how large the page may become."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from priors.errors import expect, expect_between
from priors.selection import LARGEST_FRAME_NUMBER, pick_middles

Item = TypeVar("Item")


@dataclass(frozen=True)
class Sample:
    """What a page pictures; as flags of the commands that write one."""

    every: int = 1
    """Picture only every n-th frame."""
    most: int = 8
    """Picture at most so many frames, spread evenly."""
    picture_width: int = 960
    """Width of the pictures, pixels; smaller ones are not enlarged."""
    megabytes: float = 24.0
    """Size that the page may have: where the pictures take more, frames are left out, which is told."""

    def __post_init__(self) -> None:
        expect_between(1, self.every, LARGEST_FRAME_NUMBER, "--every")
        expect_between(1, self.most, 10_000, "--most")
        expect(64 <= self.picture_width <= 4096, "--picture-width", self.picture_width, "64 to 4096 pixels")
        expect(0 < self.megabytes <= 500, "--megabytes", self.megabytes, "more than 0, 500 at most")

    def pick(self, items: Sequence[Item]) -> list[Item]:
        """Return those of a drive's frames that are pictured."""
        return pick_middles(items[:: self.every], self.most)

    @property
    def room(self) -> int:
        """Return how many bytes the pictures and videos may take."""
        return round(self.megabytes * 1e6)
