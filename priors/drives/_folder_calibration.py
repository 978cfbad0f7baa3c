"""Calibration of a folder of images: calib.json, and calib/<id>.json where a frame has its own."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from priors.drives._files import check_baseline
from priors.drives._rigs import RIGS
from priors.errors import DataError
from priors.types import Camera, Matrix, Rig

ORTHONORMAL = 1e-3
"""By how much R R^T of a pose may differ from the identity."""
Values = dict[str, Any]


@dataclass(frozen=True)
class Calibration:
    """What a calibration file says of a frame."""

    camera: Camera
    baseline_m: float | None
    rig: Rig | None
    T_left_lidar: Matrix | None
    """(4, 4) LiDAR to the left camera, metres."""


def calibration(values: Values, path: Path, size: tuple[int, int], paired: bool) -> Calibration:
    """Check a file's values.

    Args:
        values: by key; see priors/drives/folder.py.
        path: the file, for errors.
        size: (height, width) of the image, where the file does not say it.
        paired: whether there is a second image, which needs "baseline_m".

    Raises:
        DataError: a value is missing, is no number or cannot be.
    """
    fx, fy, cx, cy = (_number(values, key, path) for key in ("fx", "fy", "cx", "cy"))
    if fx <= 0 or fy <= 0:
        raise DataError(f"{path}: fx and fy should be > 0 pixels, found {fx:g} and {fy:g}")
    baseline_m = None
    if paired or "baseline_m" in values:
        baseline_m = check_baseline(_number(values, "baseline_m", path), "baseline_m", path)
    if "width" in values or "height" in values:
        size = (int(_number(values, "height", path)), int(_number(values, "width", path)))
    if not (0 < cx < size[1] - 1 and 0 < cy < size[0] - 1):
        outside = f"the centre ({cx:g}, {cy:g}) lies outside the {size[1]}x{size[0]} images"
        raise DataError(f"{path}: {outside}: was one of them resized?")
    camera = Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), size)
    return Calibration(camera, baseline_m, _rig(values.get("rig"), path), _lidar(values.get("T_cam_lidar"), path))


def _rig(name: Any, path: Path) -> Rig | None:
    """Return the rig that a calibration names; DataError where there is none of that name."""
    if name is None:
        return None
    if not isinstance(name, str) or name not in RIGS:
        raise DataError(f"{path}: rig {name!r} is not known: leave it out, or choose one of {', '.join(RIGS)}")
    return RIGS[name]


def _lidar(given: Any, path: Path) -> Matrix | None:
    """Return the LiDAR's place that a calibration tells: 12 or 16 numbers, or 3 or 4 rows of 4."""
    if given is None:
        return None
    wanted = f"{path}: T_cam_lidar should be 12 numbers, row by row, that turn and move the LiDAR's points in metres"
    try:
        rows = np.array(given, dtype=np.float64).reshape(-1, 4)
    except (TypeError, ValueError) as error:
        raise DataError(f"{wanted}: found {given!r}") from error
    whole = len(rows) == 3 or (len(rows) == 4 and rows[3].tolist() == [0, 0, 0, 1])
    if not whole or not np.isfinite(rows).all():
        raise DataError(f"{wanted}: found {given!r}")
    T = np.vstack([rows[:3], [0, 0, 0, 1.0]])
    R = T[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > ORTHONORMAL or np.linalg.det(R) < 0:
        raise DataError(f"{wanted}: its first three columns are no rotation: was a row lost, or a unit mixed in?")
    return T


def _number(values: Values, key: str, path: Path) -> float:
    value = values.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        instead = f"found {value!r}" if key in values else "it is missing"
        raise DataError(f"{path}: {key} should be a number: {instead}: see docs/datasets.md")
    return float(value)
