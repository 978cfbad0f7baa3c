"""The text files of a KITTI raw drive: calibration, oxts, timestamps."""

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from eval.files import write_bytes
from priors.drives._oxts import EARTH_RADIUS_M
from priors.street import rig
from priors.types import Camera, Matrix

START_DEGREES = (49.0, 8.43)
START_TIME = datetime(2011, 9, 26, 13, 2, 25)


def write_calibration(folder: Path, camera: Camera) -> None:
    """Write a date's three calibration files; camera 0 is LEFT_OFFSET_M to the right of camera 2."""
    lines = ["calib_time: 26-Sep-2011 12:00:00", f"R_rect_00: {_row(np.eye(3))}"]
    for number, offset_m in ((2, rig.LEFT_OFFSET_M), (3, rig.LEFT_OFFSET_M - rig.BASELINE_M)):
        P = np.column_stack([camera.K, camera.K @ [offset_m, 0, 0]])
        height, width = camera.size
        lines += [f"S_rect_{number:02d}: {width} {height}", f"R_rect_{number:02d}: {_row(np.eye(3))}"]
        lines.append(f"P_rect_{number:02d}: {_row(P)}")
    _write(folder / "calib_cam_to_cam.txt", lines)
    for name, T in (("velo_to_cam", rig.T_cam0_velo()), ("imu_to_velo", rig.T_velo_imu())):
        rigid = [f"R: {_row(T[:3, :3])}", f"T: {_row(T[:3, 3])}"]
        _write(folder / f"calib_{name}.txt", ["calib_time: 26-Sep-2011 12:00:00", *rigid])


def _row(values: Matrix) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def _write(path: Path, lines: list[str]) -> None:
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def oxts_lines(T_world_imu: Matrix, speed_mps: float) -> list[str]:
    """Turn poses (n, 4, 4) into oxts records: the inverse of KITTI's Mercator projection, to the last digit."""
    latitude_0, longitude_0 = np.radians(START_DEGREES)
    radius = np.cos(latitude_0) * EARTH_RADIUS_M
    x = T_world_imu[:, 0, 3] + radius * longitude_0
    y = T_world_imu[:, 1, 3] - T_world_imu[0, 1, 3] + radius * np.log(np.tan(np.pi / 4 + latitude_0 / 2))
    latitude = np.degrees(2 * np.arctan(np.exp(y / radius)) - np.pi / 2)
    longitude = np.degrees(x / radius)
    yaw, pitch, roll = Rotation.from_matrix(T_world_imu[:, :3, :3]).as_euler("ZYX").T
    altitude = 110.0 + T_world_imu[:, 2, 3]
    rest = " ".join(["0"] * 21)
    columns = np.stack([latitude, longitude, altitude, roll, pitch, yaw, 0 * yaw, 0 * yaw, 0 * yaw + speed_mps], axis=1)
    return [f"{_row(line)} {rest}\n" for line in columns]


def timestamps(times_s: npt.NDArray[np.floating]) -> str:
    """Turn seconds (n,) into KITTI's time stamps."""
    stamps = [START_TIME + timedelta(seconds=float(time)) for time in times_s]
    return "".join(f"{stamp:%Y-%m-%d %H:%M:%S}.{stamp.microsecond * 1000:09d}\n" for stamp in stamps)
