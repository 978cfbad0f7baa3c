"""Rate of a drive's frames, and so which of them are sparse views: the study's 2.5 Hz, whatever the drive's rate."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Self

import numpy as np

from nerf.split import SPARSE_STEP
from priors.errors import DataError
from priors.types import Drive

SPARSE_HZ = 2.5
"""Of the study's sparse views: every 4th frame of KITTI at 10 Hz, every 2nd of Argoverse's pair at 5 Hz."""
USUAL_HZ = SPARSE_STEP * SPARSE_HZ
LOOKED_AT = 101
"""Frames whose times are compared, at most."""


@dataclass(frozen=True)
class Rate:
    """How often a drive takes a frame."""

    hz: float
    is_told: bool
    """Whether the drive's times say so; False: it has none, and the usual rate is taken."""

    @classmethod
    def of(cls, drive: Drive, positions: Sequence[int]) -> Self:
        """Return the rate of some frames of a drive: the median of the steps from each to the next counts."""
        times_s: list[float | None] = []
        for position in positions[:LOOKED_AT]:
            with suppress(DataError):  # a frame that cannot be opened is told where it is used
                times_s.append(drive[position].time_s)
        known_s = np.array([np.nan if time is None else time for time in times_s], dtype=np.float64)
        gaps_s = np.diff(known_s)
        gaps_s = gaps_s[gaps_s > 0]  # neither NaN nor a clock that stands
        return cls(1 / float(np.median(gaps_s)), True) if len(gaps_s) else cls(USUAL_HZ, False)

    @property
    def sparse_step(self) -> int:
        """Every so many-th training frame is a sparse view."""
        return max(1, round(self.hz / SPARSE_HZ))

    def __str__(self) -> str:
        return f"{self.hz:.3g} Hz" + ("" if self.is_told else ", for the drive has no times")
