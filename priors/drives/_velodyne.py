"""KITTI's velodyne scanner: its files, and when it measures each point of a turn."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from priors.errors import DataError

SWEEP_S = 0.1
"""Time of one turn."""
SECONDS_PER_RADIAN = -SWEEP_S / (2 * np.pi)
"""The scanner turns clockwise seen from above: azimuth (x forward, y left) falls as time passes. The cameras are
triggered when it faces forward: azimuth 0 is the frame's time."""


def read_sweep_file(path: Path) -> npt.NDArray[np.float32]:
    """Read a velodyne .bin (float32 x y z reflectance): (n, 3) metres, points that are not finite left out."""
    try:
        size = path.stat().st_size
        data = np.fromfile(path, dtype="<f4")
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error
    if size % 16:
        raise DataError(f"{path}: {size} bytes are not whole points of 16 bytes: truncated, download it again")
    if size == 0:
        raise DataError(f"{path}: empty sweep: download it again, or leave the frame out with --frames")
    xyz_m = np.ascontiguousarray(data.reshape(-1, 4)[:, :3])
    finite = np.isfinite(xyz_m).all(axis=1)
    if not finite.any():
        raise DataError(f"{path}: no finite point in the sweep: download it again")
    return xyz_m if finite.all() else xyz_m[finite]
