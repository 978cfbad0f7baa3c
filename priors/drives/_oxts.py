"""KITTI's oxts: the IMU's poses in metres, at the frames' own times.

A KITTI frame keeps the nearest of the IMU's records, which come at 100 Hz: up to 5 ms lie between, 7 cm at 50 km/h,
and poses taken as they are step back and forth by that. The scanner turns at a steady rate, so the frames' own times
lie on a line through the records' time stamps.
"""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from priors.drives._files import read_times, stems
from priors.errors import DataError
from priors.frame_ids import by_number
from priors.geometry import invert
from priors.motion import Trajectory
from priors.text import read_lines
from priors.types import Matrix

EARTH_RADIUS_M = 6378137.0

FRAMES_AROUND = 10  # the line is fitted to so many frames before and after: 0.6 ms of the 5 are left
FEWEST_STAMPS = 5
RECORD_S = 0.01  # where a stamp lies farther from the line, nothing is known about the frames' times


class Track:
    """The poses of a drive's oxts folder, by frame id; the world is the IMU's frame at the first record."""

    def __init__(self, folder: Path) -> None:
        self.files = stems(folder / "data", [".txt"])
        self._by_number = by_number(self.files)
        self._stamps_file = folder / "timestamps.txt"
        self._records: dict[str, Matrix] = {}

    @property
    def sources(self) -> list[Path]:
        """What the poses are made from."""
        return [*self.files.values(), *([self._stamps_file] if self._stamps_file.exists() else [])]

    def T_world_imu(self, id_: str) -> Matrix | None:
        """Return the IMU's pose (4, 4) when the frame was taken, metres; None where it has no record."""
        own = id_ if id_ in self.files else self.id_of(int(id_)) if id_.isdecimal() else ""
        return self._T_world_mercator @ self._at_frame(own) if own in self.files else None

    def id_of(self, number: int) -> str:
        """Return the id of a number's record; nothing where it has none."""
        return self._by_number.get(number, "")

    def record(self, id_: str) -> Matrix:
        """Return the pose (4, 4) in a frame's file, in Mercator metres."""
        if id_ not in self._records:  # two threads may both read it: they find the same
            self._records[id_] = _read_pose(self.files[id_], self._mercator_scale)
        return self._records[id_]

    def _at_frame(self, id_: str) -> Matrix:
        """Return the pose between the frame's record and the next, or the one before."""
        T, number = self.record(id_), int(id_) if id_.isdecimal() else -1
        late = self._late_s.get(number, 0.0)
        for step in (1, -1) if late > 0 else (-1, 1):
            beside = self.id_of(number + step)
            if late == 0 or beside not in self.files or number + step not in self._stamps:
                continue
            if self.path.broken(str(number), str(number + step)):
                continue
            try:
                T_beside = self.record(beside)
            except DataError:
                continue  # it spoils its own frame only
            return between(T, T_beside, late / (self._stamps[number + step] - self._stamps[number]))
        return T

    @cached_property
    def path(self) -> Trajectory:
        """The records' trajectory, by frame number; damaged ones are left out."""
        poses = {}
        for number, id_ in self._by_number.items():
            try:
                poses[number] = self.record(id_)
            except DataError:
                continue  # it spoils its own frame only
        return Trajectory.of_numbers(poses, self._stamps)

    @cached_property
    def _stamps(self) -> dict[int, float]:
        """When the records were taken, by frame number."""
        return read_times(self._stamps_file) if self._stamps_file.exists() else {}

    @cached_property
    def _late_s(self) -> dict[int, float]:
        return late_s(self._stamps)

    @cached_property
    def _T_world_mercator(self) -> Matrix:
        return invert(self._at_frame(next(iter(self.files))))

    @cached_property
    def _mercator_scale(self) -> float:
        """Return the Mercator projection's scale at the first record; where that is damaged, no frame has a pose."""
        try:
            return float(np.cos(np.radians(_read_fields(next(iter(self.files.values())))[0])))
        except DataError as error:
            raise DataError(f"{error}: it sets the drive's world, without it no frame has a pose") from error


def late_s(stamps_s: Mapping[int, float]) -> dict[int, float]:
    """Return by frame how much later it was taken than its record was stamped, seconds, within ± RECORD_S.

    A frame is left out where its stamp and those around it do not lie on a line.
    """
    late = {}
    for number in stamps_s:
        around = [other for other in range(number - FRAMES_AROUND, number + FRAMES_AROUND + 1) if other in stamps_s]
        if len(around) < FEWEST_STAMPS:
            continue
        steps = np.array(around, dtype=np.float64) - number
        stamps = np.array([stamps_s[other] for other in around]) - stamps_s[number]
        rate, own = np.polyfit(steps, stamps, 1)
        if rate > 2 * RECORD_S and np.abs(stamps - (rate * steps + own)).max() <= RECORD_S:
            late[number] = float(own)
    return late


def between(T_world_a: Matrix, T_world_b: Matrix, share: float) -> Matrix:
    """Return the pose (4, 4) that lies `share` of the way from a to b: 0 is a, 1 is b, beyond goes on."""
    T = np.eye(4)
    turn = Rotation.from_matrix(T_world_a[:3, :3].T @ T_world_b[:3, :3]).as_rotvec()
    T[:3, :3] = T_world_a[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
    T[:3, 3] = (1 - share) * T_world_a[:3, 3] + share * T_world_b[:3, 3]
    return T


def _read_fields(path: Path) -> npt.NDArray[np.float64]:
    """Read latitude, longitude (degrees), altitude (m), roll, pitch, yaw (rad) from an oxts file."""
    words = [word for line in read_lines(path) for word in line.words]
    try:
        values = np.array([float(word) for word in words[:6]])
    except ValueError as error:
        raise DataError(f"{path}: oxts fields are not numbers: download it again") from error
    if values.size < 6 or not np.isfinite(values).all():
        raise DataError(f"{path}: expected 6 finite oxts fields (lat lon alt roll pitch yaw), found {values.tolist()}")
    return values


def _read_pose(path: Path, scale: float) -> Matrix:
    """Turn an oxts file into (4, 4): Mercator metres and Rz(yaw) Ry(pitch) Rx(roll), as KITTI's devkit does."""
    latitude, longitude, altitude_m, roll, pitch, yaw = _read_fields(path)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    T[0, 3] = scale * EARTH_RADIUS_M * np.radians(longitude)
    T[1, 3] = scale * EARTH_RADIUS_M * np.log(np.tan(np.pi / 4 + np.radians(latitude) / 2))
    T[2, 3] = altitude_m
    return T
