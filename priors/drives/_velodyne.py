"""KITTI's velodyne scanner: its files, and when it measures each point of a turn."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from priors.drives._points import check_reflectance, only_points
from priors.errors import DataError, unreadable
from priors.geometry import invert
from priors.types import Matrix

SWEEP_S = 0.1
"""Time of one turn."""
SECONDS_PER_RADIAN = -SWEEP_S / (2 * np.pi)
"""The scanner turns clockwise seen from above: azimuth (x forward, y left) falls as time passes. The cameras are
triggered when it faces forward: azimuth 0 is the frame's time."""
FORMATS = {b"\x93NUMPY": "a NumPy file", b"ply\n": "a PLY file", b"ply\r": "a PLY file", b"# .PCD": "a PCD file"}

WANTED = "little-endian float32 x y z reflectance"


def point_times(xyz_m: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return when each point (n, 3) of a turn was measured, (n,) seconds from the frame's time."""
    azimuth = np.arctan2(xyz_m[:, 1], xyz_m[:, 0])
    return np.asarray((SECONDS_PER_RADIAN * azimuth).astype(np.float32))


def velocity_between(T_world_a: Matrix, T_world_b: Matrix, seconds: float) -> Matrix:
    """Return the motion from one pose to another that took so long: (6,) m/s, then rad/s, in the first one's frame."""
    T_a_b = invert(T_world_a) @ T_world_b
    return np.concatenate([T_a_b[:3, 3], Rotation.from_matrix(T_a_b[:3, :3]).as_rotvec()]) / seconds


def read_sweep_file(path: Path) -> npt.NDArray[np.float32]:
    """Read a velodyne .bin (float32 x y z reflectance): (n, 3) metres; values that no scanner measures are left out.

    Raises DataError where the file is cut off, empty, or is no sweep: another byte order, type or format.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise unreadable(path, error) from error
    for start, name in FORMATS.items():
        if data.startswith(start):
            raise DataError(f"{path}: is {name}: expected {WANTED}: convert it")
    if len(data) % 16:
        raise DataError(f"{path}: {len(data)} bytes are not whole points of 16 bytes: truncated, download it again")
    if not data:
        raise DataError(f"{path}: empty sweep: download it again, or leave the frame out with --frames")
    table = np.frombuffer(data, "<f4").reshape(-1, 4)
    xyz_m = np.ascontiguousarray(table[:, :3])
    points = only_points(xyz_m, path, WANTED)
    check_reflectance(table[points, 3], path, WANTED)
    return xyz_m if points.all() else xyz_m[points]
