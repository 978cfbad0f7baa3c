"""KITTI's oxts: the IMU's poses in metres, at the frames' own times.

A KITTI frame keeps the nearest of the IMU's records, which come at 100 Hz: up to 5 ms lie between, 7 cm at 50 km/h,
and poses taken as they are step back and forth by that. The scanner turns at a steady rate, so the frames' own times
lie on a line through the records' time stamps.

Positions by satellite drift: on drive 0009 they travel at -1.01 degrees to the yaw. Where records have velocities, the
path is dead-reckoned from those forward, to the left and up. `vn` and `ve` are not taken: they mirror the velocity to
the left. By `vl` drive 0009 travels at +0.48 degrees to its yaw, as the positions of drive 0001 do; by `vn` and `ve` it
is -0.48 degrees, and images see three times the error (docs/poses.md).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from priors.drives._dead_reckoning import dead_reckon
from priors.drives._files import read_times, stems
from priors.errors import DataError
from priors.frame_ids import by_number
from priors.geometry import invert
from priors.motion import Trajectory
from priors.poses import readable
from priors.text import read_lines
from priors.types import Matrix

Floats = npt.NDArray[np.float64]

EARTH_RADIUS_M = 6378137.0
PLACE, VELOCITY = 6, slice(8, 11)
"""Columns: where the IMU is, how many; vf, vl and vu, which."""
MOVING_M, MOVING_M_S, FEWEST_STEPS = 0.2, 2.0, 10
"""Steps between records that tell a direction, and how many are needed."""
DEAD_RECKONING = "dead-reckoned-1"
"""Part of a fingerprint: the number is raised when dead-reckoned poses change."""

FRAMES_AROUND = 10  # the line is fitted to so many frames before and after: 0.6 ms of the 5 are left
FEWEST_STAMPS = 5
RECORD_S = 0.01  # where a stamp lies farther from the line, nothing is known about the frames' times


@dataclass(frozen=True)
class Record:
    """What one oxts file says."""

    T_mercator_imu: Matrix
    """(4, 4) in Mercator metres: x east, y north, z up."""
    velocity_m_s: Floats
    """(3,) forward and to the left, both level, and up; NaN where the file has no number."""
    yaw: float
    """The heading, from east to north, radians."""


class Track:
    """The poses of a drive's oxts folder, by frame id; the world is the IMU's frame at the first record."""

    def __init__(self, folder: Path, *, by_velocity: bool = True) -> None:
        self.files = stems(folder / "data", [".txt"])
        self._by_number = by_number(self.files)
        self._stamps_file = folder / "timestamps.txt"
        self._records: dict[str, Record] = {}
        self._by_velocity = by_velocity

    @property
    def sources(self) -> list[Path]:
        """What the poses are made from."""
        return [*self.files.values(), *([self._stamps_file] if self._stamps_file.exists() else [])]

    @property
    def dead_reckoned(self) -> bool:
        """Whether the path is that of the velocities."""
        return bool(self._path_m)

    def T_world_imu(self, id_: str) -> Matrix | None:
        """Return the IMU's pose (4, 4) when the frame was taken, metres; None where it has no record."""
        own = id_ if id_ in self.files else self.id_of(int(id_)) if id_.isdecimal() else ""
        return self._T_world_mercator @ self._at_frame(own) if own in self.files else None

    def id_of(self, number: int) -> str:
        """Return the id of a number's record; nothing where it has none."""
        return self._by_number.get(number, "")

    def record(self, id_: str) -> Record:
        """Read what a frame's file says, once."""
        if id_ not in self._records:  # two threads may both read it: they find the same
            self._records[id_] = _read_record(self.files[id_], self._mercator_scale)
        return self._records[id_]

    def pose(self, id_: str) -> Matrix:
        """Return the pose (4, 4) at a record's stamp, in Mercator metres."""
        recorded = self.record(id_).T_mercator_imu
        if id_ not in self._path_m:
            return recorded
        T = recorded.copy()
        T[:3, 3] = self._path_m[id_]
        return T

    def travel_deg(self) -> tuple[float, float] | None:
        """Return at which angle to the heading positions, and velocities, go, medians; positive to the left.

        None where the records have no velocities to the left, or the drive hardly moves.
        """
        records = [self.record(self.id_of(int(name))) for name in self.path.names]
        return _travel_deg(records) if len(records) > FEWEST_STEPS else None

    @cached_property
    def _path_m(self) -> dict[str, Floats]:
        """Positions (3,) by dead reckoning, Mercator metres; none where records lack velocities or stamps.

        Each part of a path that breaks is reckoned by itself.
        """
        found: dict[str, Floats] = {}
        for first, end in self.path.parts if self._by_velocity else []:  # a jump is not spread over a part
            numbers = [int(name) for name in self.path.names[first:end]]
            ids = [self.id_of(number) for number in numbers]
            times_s = np.array([self._stamps.get(number, np.nan) for number in numbers])
            path_m = _sail([self.record(id_) for id_ in ids], times_s)
            if path_m is not None:
                found |= zip(ids, path_m, strict=True)
        return found

    def _at_frame(self, id_: str) -> Matrix:
        """Return the pose between the frame's record and the next, or the one before."""
        T, number = self.pose(id_), int(id_) if id_.isdecimal() else -1
        late = self._late_s.get(number, 0.0)
        for step in (1, -1) if late > 0 else (-1, 1):
            beside = self.id_of(number + step)
            if late == 0 or beside not in self.files or number + step not in self._stamps:
                continue
            if self.path.broken(str(number), str(number + step)):
                continue
            try:
                T_beside = self.pose(beside)
            except DataError:
                continue  # it spoils its own frame only
            return between(T, T_beside, late / (self._stamps[number + step] - self._stamps[number]))
        return T

    @cached_property
    def path(self) -> Trajectory:
        """The trajectory of the recorded positions, by frame number; damaged records are left out."""
        poses = readable(self._by_number, lambda number: self.record(self._by_number[number]).T_mercator_imu)
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
            return float(np.cos(np.radians(_read_numbers(next(iter(self.files.values())))[0])))
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


def _sail(records: Sequence[Record], times_s: Floats) -> Floats | None:
    """Return the positions (n, 3) by the records' velocities, Mercator metres; None where they lack them."""
    if len(records) < 2 or not np.isfinite(times_s).all():
        return None
    forward, left, up = (_unless_empty(column) for column in np.array([record.velocity_m_s for record in records]).T)
    yaw = np.array([record.yaw for record in records])
    east = np.cos(yaw) * forward - np.sin(yaw) * left
    north = np.sin(yaw) * forward + np.cos(yaw) * left
    positions_m = np.array([record.T_mercator_imu[:3, 3] for record in records])
    return dead_reckon(positions_m, np.stack([east, north, up], axis=1), times_s)


def _travel_deg(records: Sequence[Record]) -> tuple[float, float] | None:
    """See Track.travel_deg."""
    steps_m = np.diff([record.T_mercator_imu[:2, 3] for record in records], axis=0)
    forward, left, _ = (_unless_empty(column) for column in np.array([record.velocity_m_s for record in records[1:]]).T)
    moving = (np.linalg.norm(steps_m, axis=1) > MOVING_M) & np.isfinite(left) & (forward > MOVING_M_S)
    if np.count_nonzero(moving) < FEWEST_STEPS:
        return None
    yaw = np.unwrap([record.yaw for record in records])
    aside = np.arctan2(steps_m[:, 1], steps_m[:, 0]) - (yaw[1:] + yaw[:-1]) / 2
    aside = (aside + np.pi) % (2 * np.pi) - np.pi
    by_velocity = np.arctan2(left, forward)
    return float(np.degrees(np.median(aside[moving]))), float(np.degrees(np.median(by_velocity[moving])))


def _unless_empty(column: Floats) -> Floats:
    """Return a column of the records, or NaN where it holds zeros only: it was not recorded."""
    return column if np.nan_to_num(column).any() else np.full_like(column, np.nan)


def _read_numbers(path: Path) -> Floats:
    """Read an oxts file's columns as far as they are numbers.

    Raises:
        DataError: latitude, longitude (degrees), altitude (m), roll, pitch, yaw (rad) are not all there.
    """
    values = []
    for word in (word for line in read_lines(path) for word in line.words):
        try:
            values.append(float(word))
        except ValueError as error:
            if len(values) < PLACE:
                raise DataError(f"{path}: oxts fields are not numbers: download it again") from error
            break
    if len(values) < PLACE or not np.isfinite(values[:PLACE]).all():
        wanted = f"expected 6 finite oxts fields (lat lon alt roll pitch yaw), found {values[:PLACE]}"
        raise DataError(f"{path}: {wanted}: download it again")
    return np.array(values)


def _read_record(path: Path, scale: float) -> Record:
    """Read an oxts file: Mercator metres and Rz(yaw) Ry(pitch) Rx(roll), as KITTI's devkit does."""
    values = _read_numbers(path)
    latitude, longitude, altitude_m, roll, pitch, yaw = values[:PLACE]
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    T[0, 3] = scale * EARTH_RADIUS_M * np.radians(longitude)
    T[1, 3] = scale * EARTH_RADIUS_M * np.log(np.tan(np.pi / 4 + np.radians(latitude) / 2))
    T[2, 3] = altitude_m
    velocity_m_s = values[VELOCITY] if len(values) >= VELOCITY.stop else np.full(3, np.nan)
    return Record(T, np.where(np.isfinite(velocity_m_s), velocity_m_s, np.nan), float(yaw))
