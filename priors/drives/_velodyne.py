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

NEAREST_M, FARTHEST_M = 1e-3, 1e4
"""No scanner measures nearer or farther: such values are no points."""
FEWEST = 0.5
"""Share of the values that must be points."""


def read_sweep_file(path: Path) -> npt.NDArray[np.float32]:
    """Read a velodyne .bin (float32 x y z reflectance): (n, 3) metres; values that no scanner measures are left out.

    Raises DataError where the file is damaged, or hardly a value is a distance: another byte order or type.
    """
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
    with np.errstate(invalid="ignore"):
        reach_m = np.abs(xyz_m).max(axis=1)
        point = (reach_m >= NEAREST_M) & (reach_m <= FARTHEST_M)  # not where it is NaN
    if np.count_nonzero(point) < FEWEST * len(point):
        kept = f"only {np.count_nonzero(point)} of {len(point)} points are metres"
        raise DataError(
            f"{path}: {kept}: expected little-endian float32 x y z reflectance: convert or download it again"
        )
    return xyz_m if point.all() else xyz_m[point]
