"""Drives whose sensors run at rates of their own: frames are images by time, and take the nearest sweep."""

from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from priors.drives._by_time import beside, nearest
from priors.drives._camera_drive import CameraDrive, Files, Readers
from priors.drives._files import read_sized
from priors.drives._rectified import RectifiedCamera
from priors.geometry import invert
from priors.motion import Trajectory
from priors.poses import readable
from priors.types import Image, Matrix, Sweep


class TimedDrive(CameraDrive):
    """One camera's view of a log. Frame ids are the images' times, in ticks.

    A subclass sets the fields below in its `__init__`, and says where the vehicle is and how a sweep is read.
    """

    tick_s: float
    """Seconds a tick."""
    near_sweep: int
    """An image takes a sweep that is at most so many ticks away."""
    near_other: int
    """An image takes the other camera's that is at most so many ticks away."""
    rectified: RectifiedCamera
    """This camera on the vehicle."""
    partner_rectified: RectifiedCamera | None
    """The pair's other camera."""
    partner_images: Mapping[int, Path]
    """Its images by time."""
    sweeps: Mapping[int, Path]
    """Sweeps by time."""
    T_ego_lidar: Matrix
    """(4, 4) the LiDAR on the vehicle; the identity where sweeps are in the vehicle's frame."""

    @abstractmethod
    def T_world_ego(self, time: int) -> Matrix | None:
        """Return where the vehicle is at a time (4, 4), metres; None where it is not known."""

    @abstractmethod
    def read_points(self, path: Path) -> npt.NDArray[np.float32]:
        """Read a sweep's points (n, 3), metres."""

    def scans(self) -> dict[str, list[str]]:
        """List the frame ids that have a partner and a sweep near enough in time, and truth, for the audit."""
        kinds = {"other": (self._partner_times, self.near_other), "sweep": (self._sweep_times, self.near_sweep)}
        near = {
            what: [id_ for id_ in self.ids if nearest(times, int(id_), within) is not None]
            for what, (times, within) in kinds.items()
        }
        return super().scans() | near

    def readers(self, id_: str) -> Readers:
        """Return what can be read of a frame; images are rectified, what is near in time belongs to the frame."""
        time = int(id_)
        readers = super().readers(id_) | {"image": partial(_read_rectified, self.images[id_], self.rectified)}
        other = nearest(self._partner_times, time, self.near_other)
        if other is not None and self.partner_rectified is not None:
            readers["other"] = partial(_read_rectified, self.partner_images[other], self.partner_rectified)
        if self.sweeps and self.rectified.T_ego_cam is not None:
            readers["sweep"] = lambda offset=0: self._read_sweep(time, offset)
        return readers

    def files(self, id_: str) -> Files:
        """Return which file each reader reads."""
        time = int(id_)
        other = nearest(self._partner_times, time, self.near_other)
        near: Files = {
            "other": lambda: None if other is None else self.partner_images[other],
            "sweep": lambda offset=0: self._sweep_file(time, offset),
        }
        return super().files(id_) | near

    def T_world_cam(self, id_: str) -> Matrix | None:
        """Return the camera's pose; None where the vehicle's is not known at the image's time."""
        T_world_ego, T_ego_cam = self.T_world_ego(int(id_)), self.rectified.T_ego_cam
        return None if T_world_ego is None or T_ego_cam is None else T_world_ego @ T_ego_cam

    def T_cam_lidar(self, id_: str) -> Matrix | None:
        """Map the nearest sweep, at its own time, into the camera at the image's time."""
        if self.rectified.T_ego_cam is None or not self.sweeps:
            return None
        T_cam_ego, T_world_ego = invert(self.rectified.T_ego_cam), self.T_world_ego(int(id_))
        sweep = nearest(self._sweep_times, int(id_), self.near_sweep)
        T_world_then = None if sweep is None else self.T_world_ego(sweep)
        if T_world_ego is None or T_world_then is None:
            return T_cam_ego @ self.T_ego_lidar
        return T_cam_ego @ invert(T_world_ego) @ T_world_then @ self.T_ego_lidar

    def time_s(self, id_: str) -> float:
        """Return seconds since the log's first image."""
        return (int(id_) - int(self.ids[0])) * self.tick_s

    @cached_property
    def _partner_times(self) -> list[int]:
        return list(self.partner_images)

    @cached_property
    def _sweep_times(self) -> list[int]:
        return list(self.sweeps)

    def _sweep_time(self, time: int, offset: int) -> int | None:
        """Return the time of the sweep that lies `offset` sweeps from the one nearest to an image; None without one."""
        return beside(self._sweep_times, time, self.near_sweep, offset)

    def _sweep_file(self, time: int, offset: int) -> Path | None:
        sweep = self._sweep_time(time, offset)
        return None if sweep is None else self.sweeps[sweep]

    def _read_sweep(self, time: int, offset: int) -> Sweep | None:
        sweep = self._sweep_time(time, offset)
        if sweep is None:
            return None
        T_world_ego = self.T_world_ego(sweep)
        T_world_lidar = None if T_world_ego is None else T_world_ego @ self.T_ego_lidar
        placed = Sweep(self.read_points(self.sweeps[sweep]), T_world_lidar)
        return self._path.without_far_side(placed, str(self._sweep_time(time, 0)), str(sweep))

    @cached_property
    def _path(self) -> Trajectory:
        """The vehicle's trajectory at the sweeps, by their times; damaged poses are left out."""
        poses = readable(self._sweep_times, self.T_world_ego)
        return Trajectory.of_numbers(poses, {time: time * self.tick_s for time in poses})


def _read_rectified(path: Path, camera: RectifiedCamera) -> Image:
    return camera.rectify(read_sized(path, camera.camera))
