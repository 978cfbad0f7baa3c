"""Correction: what turns a drive's calibration of LiDAR and camera into the one that was measured."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from priors.geometry import invert
from priors.types import Frame, Matrix, Sweep

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Correction:
    """A small turn of the LiDAR about its own place, how far that is off, and how late it measures."""

    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Rotation vector along the camera's axes, degrees: pitch (about x, right), yaw (y, down), roll (z, forward)."""
    delay_s: float = 0.0
    """To be added to the time of each point, seconds."""
    moved_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """To be added to the LiDAR's place, along the camera's axes, metres: right, down, forward."""

    @property
    def R(self) -> Matrix:
        """The turn (3, 3)."""
        from scipy.spatial.transform import Rotation  # not for --help

        return np.asarray(Rotation.from_rotvec(self.turn_deg, degrees=True).as_matrix())

    @property
    def size_deg(self) -> float:
        """The turn's angle, degrees."""
        return float(np.linalg.norm(self.turn_deg))

    def place(self, T_cam_lidar: Matrix) -> Matrix:
        """Return where the LiDAR is (4, 4), metres, for where the calibration puts it."""
        placed = T_cam_lidar.copy()
        placed[:3, :3] = self.R @ T_cam_lidar[:3, :3]
        placed[:3, 3] += self.moved_m
        return placed

    def frame(self, frame: Frame) -> Frame:
        """Return a frame whose LiDAR is placed, and whose sweeps are timed, as measured; one without is the same.

        The sensor whose poses the drive has keeps them; the other one moves.
        """
        if frame.T_cam_lidar is None or not frame.has("sweep"):
            return frame
        placed = self.place(frame.T_cam_lidar)
        T_old_new, T_world_cam = invert(frame.T_cam_lidar) @ placed, frame.T_world_cam
        if frame.posed == "lidar":
            T_old_new = np.eye(4)
            T_world_cam = None if T_world_cam is None else T_world_cam @ frame.T_cam_lidar @ invert(placed)
        read: Callable[..., Any] = partial(self._sweep, frame.readers["sweep"], T_old_new)
        readers = {**frame.readers, "sweep": read}
        return replace(frame, T_cam_lidar=placed, T_world_cam=T_world_cam, readers=readers)

    def _sweep(self, read: Callable[[int], Sweep | None], T_old_new: Matrix, offset: int = 0) -> Sweep | None:
        """Read a sweep, move the LiDAR where it stood, and shift its times."""
        sweep = read(offset)
        if sweep is None:
            return None
        T_world_lidar = None if sweep.T_world_lidar is None else sweep.T_world_lidar @ T_old_new
        return replace(sweep, T_world_lidar=T_world_lidar, time_s=self._times(sweep))

    def _times(self, sweep: Sweep) -> npt.NDArray[np.float32] | None:
        """Return when each point was measured (n,), seconds; as it was where the drive does not know its motion."""
        if self.delay_s == 0 or sweep.velocity is None:
            return sweep.time_s
        before = np.zeros(len(sweep.xyz_m), np.float32) if sweep.time_s is None else sweep.time_s
        return before + np.float32(self.delay_s)


NONE = Correction()
