"""Motion of a rig along its poses: how fast it goes, where its path breaks, and which part is the longest.

A path breaks at a step that no car makes: the poses on its two sides do not belong together. What joins frames by their
poses (accumulated sweeps, fields, video) stays on one side of a break. This file is the one place of that rule.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Self

import numpy as np
import numpy.typing as npt

from priors.errors import DataError
from priors.selection import LARGEST_FRAME_NUMBER
from priors.types import Drive, Frame, Mask, Matrix, Sweep

Floats = npt.NDArray[np.float64]

TIMES_FASTER, FARTHER_M = 3.0, 0.5
"""A step breaks the path where it is so many times as fast as the steps around it, and goes so much farther."""
CHANGE_M_S2 = 20.0
"""A car that starts or brakes differs from the steps around it by half of this times the time squared, or less."""
FASTEST_M_S = 70.0
FASTEST_TURN_RAD_S = float(np.radians(150.0))
"""No car goes, or turns, faster."""
AROUND = 5
"""Steps before and after that a step is compared with."""
USUAL_STEP_S = 0.1
"""Time between frames where a drive does not tell it."""


@dataclass(frozen=True)
class Trajectory:
    """Poses in the order of time."""

    T_world_rig: Floats
    """(n, 4, 4) metres."""
    gaps_s: Floats
    """(n - 1,) seconds between neighbours, > 0: where frames are left out, a gap is longer and its step no break."""
    names: Sequence[str] = field(default_factory=list)
    """(n,) frame ids."""

    @classmethod
    def of_frames(cls, frames: Sequence[Frame]) -> Self:
        """Return the trajectory of those frames that have a pose."""
        posed = [(frame, frame.T_world_cam) for frame in frames if frame.T_world_cam is not None]
        T_world_rig = np.array([T for _, T in posed], dtype=np.float64).reshape(-1, 4, 4)
        return cls(T_world_rig, gaps_s([frame for frame, _ in posed]), [frame.id for frame, _ in posed])

    @classmethod
    def of_numbers(cls, poses: Mapping[int, Matrix], times_s: Mapping[int, float]) -> Self:
        """Return the trajectory of poses by frame number; where not all have a time, numbers are USUAL_STEP_S apart."""
        numbers = sorted(poses)
        T_world_rig = np.array([poses[number] for number in numbers], dtype=np.float64).reshape(-1, 4, 4)
        timed = all(number in times_s for number in numbers)
        seconds = [times_s[number] if timed else USUAL_STEP_S * number for number in numbers]
        return cls(T_world_rig, _above_zero(np.diff(np.array(seconds, dtype=np.float64))), [str(n) for n in numbers])

    @cached_property
    def steps_m(self) -> Floats:
        """How far the rig moves from each pose to the next (n - 1,), metres."""
        return np.asarray(np.linalg.norm(np.diff(self.T_world_rig[:, :3, 3], axis=0), axis=1))

    @property
    def speeds_m_s(self) -> Floats:
        """How fast (n - 1,)."""
        return self.steps_m / self.gaps_s

    @cached_property
    def turns_rad(self) -> Floats:
        """By which angle the rig turns from each pose to the next (n - 1,), radians."""
        R = self.T_world_rig[:, :3, :3]
        trace = np.einsum("nij,nij->n", R[:-1], R[1:])
        return np.arccos(np.clip((trace - 1) / 2, -1, 1))

    @cached_property
    def breaks(self) -> Mask:
        """Tell which steps (n - 1,) no car makes.

        A step that is faster than FASTEST_M_S counts where the path as a whole is slower: else its unit, or its times,
        are other ones, and no step stands out.
        """
        speeds = self.speeds_m_s
        if not len(speeds):
            return np.zeros(0, dtype=bool)
        around = np.array([np.median(speeds[max(0, n - AROUND) : n + AROUND + 1]) for n in range(len(speeds))])
        farther_m = np.maximum(FARTHER_M, 0.5 * CHANGE_M_S2 * self.gaps_s**2)
        jumps = (speeds > TIMES_FASTER * around) & (self.steps_m - around * self.gaps_s > farther_m)
        jumps |= (speeds > FASTEST_M_S) & (np.median(speeds) <= FASTEST_M_S)
        rates = self.turns_rad / self.gaps_s
        turns = (rates > FASTEST_TURN_RAD_S) & (np.median(rates) <= FASTEST_TURN_RAD_S)
        return np.asarray(jumps | turns)

    @cached_property
    def parts(self) -> list[tuple[int, int]]:
        """The stretches between breaks: the first pose of each, and the one after its last."""
        cuts = [0, *(np.flatnonzero(self.breaks) + 1).tolist(), len(self.T_world_rig)]
        return [(first, end) for first, end in pairwise(cuts) if end > first]

    @cached_property
    def _part_of(self) -> dict[str, int]:
        """Which part each name lies in."""
        return {name: n for n, (first, end) in enumerate(self.parts) for name in self.names[first:end]}

    def broken(self, one: str, other: str) -> bool:
        """Tell whether the path breaks between two of the names; False where one of them is none of it."""
        parts = self._part_of
        return one in parts and other in parts and parts[one] != parts[other]

    def longest(self, names: Sequence[str]) -> tuple[int, int]:
        """Return the longest stretch of the names without a break: the position of its first and that after its last.

        Of equal ones it is the first.
        """
        cuts = [n for n in range(1, len(names)) if self.broken(names[n - 1], names[n])]
        return max(pairwise([0, *cuts, len(names)]), key=lambda part: part[1] - part[0])

    def without_far_side(self, sweep: Sweep | None, own: str, sweeps: str) -> Sweep | None:
        """Return a sweep, without its place where the path breaks between a frame and it.

        Args:
            sweep: a neighbour's, or the frame's own.
            own: the frame's name.
            sweeps: the sweep's.
        """
        return replace(sweep, T_world_lidar=None) if sweep is not None and self.broken(own, sweeps) else sweep


def trajectory(drive: Drive) -> Trajectory:
    """Return the trajectory of a drive's frames; frames that cannot be opened, or have no pose, are left out."""
    frames = []
    for index in range(len(drive)):
        try:
            frames.append(drive[index])
        except DataError:
            continue  # it is told where the frame is used
    return Trajectory.of_frames(frames)


def gaps_s(frames: Sequence[Frame]) -> Floats:
    """Return the seconds between frames (n - 1,): by their times, else by their numbers at 10 Hz."""
    times = [frame.time_s for frame in frames]
    if all(time is not None for time in times):
        gaps = np.diff(np.array(times, dtype=np.float64))
    elif all(frame.id.isdecimal() and int(frame.id) < LARGEST_FRAME_NUMBER for frame in frames):
        gaps = USUAL_STEP_S * np.diff(np.array([int(frame.id) for frame in frames], dtype=np.float64))
    else:
        gaps = np.full(max(0, len(frames) - 1), USUAL_STEP_S)
    return _above_zero(gaps)


def _above_zero(gaps: Floats) -> Floats:
    """Return gaps with those that no clock makes replaced: an error of its own."""
    return np.where(gaps > 0, gaps, USUAL_STEP_S)
