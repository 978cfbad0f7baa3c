"""Maps joined over time: each with those of the frames around it, which are read from the cache."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Self

from priors.build.job import Job
from priors.build.stored import StoredMaps, merged
from priors.cache.learned import DriveSources
from priors.errors import DataError
from priors.fusion import moments
from priors.fusion.moments import Moment, join_moments
from priors.motion import Trajectory, trajectory
from priors.types import Depth, Drive, Frame

MOST = 50
"""Frames before and after: 5 seconds at 10 Hz."""


def record_of(neighbours: int) -> dict[str, Any]:
    """Return what a manifest says of it among the filters: it is part of the cache's key."""
    return {"Temporal": {"neighbours": neighbours, "version": moments.VERSION}}


def expect_poses(drive: Drive, frame: Frame) -> None:
    """Raise DataError where a drive, by one of its frames, has no poses to join maps by."""
    if frame.T_world_cam is None and "pose" not in frame.missing:
        reason = "it has no poses: make some (`priors poses`), or leave out --temporal"
        raise DataError(f"{drive.name}: --temporal joins frames by their poses, and {reason}")


@dataclass(frozen=True)
class Joined:
    """Makes the maps of a prior that are joined over time."""

    maps: StoredMaps
    """Those that are not joined, of the same method."""
    neighbours: int
    """How many frames before and after."""
    path: Trajectory
    places: dict[str, int]
    """Frame id -> index into the drive."""
    on_note: Callable[[str], None]
    _read: dict[str, list[str]] = field(default_factory=dict)
    """Frame id -> frames whose maps were read for it."""

    @classmethod
    def open(cls, alone: Job, neighbours: int, on_note: Callable[[str], None]) -> Self:
        """Make ready to join the maps of a job.

        Args:
            alone: the job whose maps are joined.
            neighbours: how many frames before and after.
            on_note: told of neighbours that have no map, a line each.
        """
        drive = alone.drive
        places = {frame_id: index for index, frame_id in enumerate(drive.ids)}
        return cls(StoredMaps(alone, on_note), neighbours, trajectory(drive), places, on_note)

    def __call__(self, frame: Frame) -> Depth:
        """Make the frame's map; DataError where it has no pose, or no map of its own."""
        frame.pose()
        index = self.places[frame.id]
        own = Moment(self.maps.read(index), frame.camera, frame.pose())
        others = list(self._others(frame, index))
        drive = self.maps.job.drive
        self._read[frame.id] = [drive.ids[index + offset] for offset in (0, *(each.offset for each in others))]
        return join_moments(own, others)

    def read_for(self, frame_id: str) -> DriveSources:
        """Return the files, by frame, that the maps were made of which a frame's map was made of."""
        return merged(*map(self.maps.read_for, self._read.pop(frame_id, [])))

    def _others(self, frame: Frame, index: int) -> Iterator[Moment]:
        """Give the neighbours that have a pose on the same path, and a map; the nearest first."""
        drive = self.maps.job.drive
        for offset in sorted(range(-self.neighbours, self.neighbours + 1), key=abs):
            if offset == 0 or not 0 <= index + offset < len(drive):
                continue
            other_id = drive.ids[index + offset]
            if self.path.broken(frame.id, other_id):
                continue
            try:
                other = drive[index + offset]
                yield Moment(self.maps.read(index + offset), other.camera, other.pose(), offset)
            except DataError as error:
                told = str(error).removeprefix(f"frame {other_id}: ")
                self.on_note(f"frame {frame.id}: joined without its neighbour {other_id}: {told}")
