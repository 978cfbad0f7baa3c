"""Drives whose images and sweeps bear the same numbers: KITTI raw, KITTI odometry, KITTI-360."""

from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, ClassVar

from priors.drives._camera_drive import CameraDrive, Files, Readers
from priors.drives._velodyne import SWEEP_S, point_times, read_sweep_file, velocity_between
from priors.errors import DataError
from priors.frame_ids import by_number
from priors.motion import Trajectory
from priors.types import Matrix, Sweep

SWEEPS_KEPT = 24
"""Frames built in order share sweeps: 11 accumulated, and some workers ahead. 2 MB each."""


class NumberedDrive(CameraDrive):
    """One camera's view of a drive. Frame ids are numbers; number 5's sweep was taken with number 5's image.

    A subclass sets `sweeps` in its `__init__`, and says where the LiDAR stands and how it moved.
    """

    compensated: ClassVar[bool] = False
    """Whether sweeps are of one moment; else each is a turn of the scanner, and its points carry times."""
    sweeps: Mapping[str, Path]
    """Frame id -> sweep; also those of numbers that have no image."""

    @property
    @abstractmethod
    def T_cam_velo(self) -> Matrix | None:
        """The LiDAR's place at this camera (4, 4), metres; None without its calibration."""

    @abstractmethod
    def T_world_velo(self, number: int) -> Matrix | None:
        """Return the LiDAR's pose at a frame number (4, 4), metres; None without one; DataError for a damaged one."""

    @property
    @abstractmethod
    def path(self) -> Trajectory:
        """The drive's trajectory by frame number, without damaged poses."""

    @property
    def times_file(self) -> Path | None:
        """The file, there or not, of the times that tell where the path breaks; None where nothing but poses does."""
        return None

    def readers(self, id_: str) -> Readers:
        """Return what can be read of a frame: also sweeps, its own and its neighbours'."""
        readers = super().readers(id_)
        if self.sweeps and self._has_place:
            readers["sweep"] = lambda offset=0: self._sweep_beside(int(id_), offset)
        return readers

    def files(self, id_: str) -> Files:
        """Return which file each reader reads: also sweeps, and the times that tell where their path breaks."""
        files: Files = {"sweep": lambda offset=0: self._sweep_file(int(id_) + offset)}
        times = self.times_file
        if times is not None:
            files["sweep.times"] = lambda: times if times.is_file() else None
        return super().files(id_) | files

    def T_cam_lidar(self, id_: str) -> Matrix | None:
        """Return the LiDAR's place, the same at every frame."""
        return self.T_cam_velo

    @cached_property
    def numbered(self) -> dict[int, str]:
        """Frame id by number, of images and sweeps."""
        return by_number({**self.sweeps, **self.images})

    @cached_property
    def _has_place(self) -> bool:
        """Tell whether the calibration says where the LiDAR is; a damaged one is told by `T_cam_lidar`."""
        try:
            return self.T_cam_velo is not None
        except DataError:
            return True

    def _sweep_file(self, number: int) -> Path | None:
        return self.sweeps.get(self.numbered.get(number, ""))

    def _sweep_beside(self, number: int, offset: int) -> Sweep | None:
        """Read the sweep `offset` frames from a frame; None where the path breaks between the two."""
        return self.path.without_far_side(self._read_sweep(number + offset), str(number), str(number + offset))

    @cached_property
    def _read_sweep(self) -> Any:
        return lru_cache(maxsize=SWEEPS_KEPT)(self._load_sweep)

    def _load_sweep(self, number: int) -> Sweep | None:
        path = self._sweep_file(number)
        if path is None:
            return None
        xyz_m = read_sweep_file(path)
        velocity = None if self.compensated else self._velocity(number)
        time_s = None if velocity is None else point_times(xyz_m)
        for shared in (xyz_m, time_s):
            if shared is not None:
                shared.flags.writeable = False
        return Sweep(xyz_m, self.T_world_velo(number), time_s, velocity)

    def _velocity(self, number: int) -> Matrix | None:
        """Return the ego motion (6,), m/s and rad/s, in the LiDAR's frame, by the poses around a frame.

        Where the path breaks on both sides of the frame, it is that of the nearest step that does not break.
        """
        poses = self._unbroken(number, (-1, 0, 1))
        if len(poses) < 2 and self.path.broken(str(number - 1), str(number)):
            poses = self._unbroken(number - 1, (0, -1)) or self._unbroken(number + 1, (0, 1))
        if len(poses) < 2:
            return None
        (first, T_world_a), (last, T_world_b) = poses[0], poses[-1]
        return velocity_between(T_world_a, T_world_b, (last - first) * SWEEP_S)

    def _unbroken(self, number: int, offsets: tuple[int, ...]) -> list[tuple[int, Matrix]]:
        """Return the poses at offsets from a frame, each with its offset, on the frame's own side of a break."""
        around = [(k, self._pose_or_none(number + k)) for k in offsets]
        return [(k, T) for k, T in around if T is not None and not self.path.broken(str(number), str(number + k))]

    def _pose_or_none(self, number: int) -> Matrix | None:
        """Return a neighbour's pose; a damaged one is as good as none here, and an error at its own frame."""
        try:
            return self.T_world_velo(number)
        except DataError:
            return None
