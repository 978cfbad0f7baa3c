"""Points of a sweep: which of a file's values a scanner can have measured."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from priors.errors import DataError

NEAREST_M, FARTHEST_M = 1e-3, 1e4
"""No scanner measures nearer or farther."""
SMALLEST_M = 1e-30
"""A coordinate that is not 0 and smaller is the bytes of something else."""
FEWEST = 0.8
"""Share of the filled places that must be points; in a sound sweep it is 1, in one of another byte order about 0.2."""
SIGNED = 0.1
"""Share of reflectances below 0 from which on the columns are others."""


def only_points(xyz_m: npt.NDArray[np.float32], path: Path, wanted: str) -> npt.NDArray[np.bool_]:
    """Tell which of the values (n, 3), metres, are points.

    Places without an echo (zeros, NaN, infinity) are none, and do not speak against the file.

    Args:
        xyz_m: as they stand in the file.
        path: the file.
        wanted: what it should hold, for the error.

    Raises:
        DataError: there is no point, or many values are no metres: it is another type or byte order.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        size_m = np.abs(xyz_m)
        filled = np.isfinite(xyz_m).all(axis=1) & (size_m > 0).any(axis=1)
        metres = ((size_m == 0) | (size_m >= SMALLEST_M)).all(axis=1)
        reach_m = size_m.max(axis=1)
        points = filled & metres & (reach_m >= NEAREST_M) & (reach_m <= FARTHEST_M)
    count, places = np.count_nonzero(points), np.count_nonzero(filled)
    if not places:
        raise DataError(f"{path}: no point in the sweep: download it again, or leave the frame out with --frames")
    if count < FEWEST * places:
        raise DataError(f"{path}: only {count} of {places} values are metres: expected {wanted}: convert it again")
    return points


def check_reflectance(values: npt.NDArray[np.float32], path: Path, wanted: str) -> None:
    """Raise DataError where the fourth column (n,) is none of reflectances: the file has other columns or numbers.

    One value for all, which stands for "not known", may be anything.
    """
    if np.count_nonzero(values < 0) > SIGNED * len(values) and np.ptp(values) > 0:
        raise DataError(f"{path}: the fourth column is often below 0: expected {wanted}: convert it again")
