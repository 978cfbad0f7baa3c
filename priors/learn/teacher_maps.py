"""A teacher's disparity maps of real pairs: found, read, and freed of the calibration that the teacher has learned."""

from glob import escape
from pathlib import Path

import numpy as np

from priors.errors import DataError
from priors.geometry import mirror_columns
from priors.learn.eye_views import RIGHT
from priors.types import FloatMap, Mask

INLIER_PX = 1.0
"""The offset is fitted again to what the first fit leaves less than this of."""
OFFSET_PX = 3.0
"""Largest difference of teacher and match that says something about the offset between them."""
EVERY, FEWEST = 11, 500
"""Every so many-th pixel takes part; fewer pixels than this say nothing."""


def find_map(teacher: Path | None, name: str) -> Path | None:
    """Find a teacher's map of a view, whatever precedes its name."""
    return None if teacher is None else min(teacher.glob(f"*{escape(name)}.npy"), default=None)


def is_fresh(path: Path, map_: Path | None) -> bool:
    """Tell whether what was made of a view, with a teacher's map or without, is there and not outdated."""
    return path.exists() and (map_ is None or map_.stat().st_mtime < path.stat().st_mtime)


def read_map(path: Path, size: tuple[int, ...]) -> FloatMap:
    """Read a teacher's map (h, w), px, of a view; that of a right eye is stored unmirrored, and turned here."""
    map_ = np.load(path, allow_pickle=False).astype(np.float32)
    if map_.shape != size:
        raise DataError(f"{path}: a disparity map {map_.shape}, the image is {size}: teach again")
    return mirror_columns(map_) if path.stem.endswith(RIGHT) else map_


def offset(teacher_px: FloatMap, matched_px: FloatMap, calm: Mask) -> FloatMap:
    """Return how far the teacher is off (h, w), px: a smooth function of place and disparity; 0 without evidence."""
    height, width = teacher_px.shape
    difference = teacher_px - matched_px
    y, x = np.nonzero(calm & (np.abs(difference) < OFFSET_PX))
    y, x = y[::EVERY], x[::EVERY]
    if len(y) < FEWEST:
        return np.zeros_like(teacher_px)

    def terms(y: np.ndarray, x: np.ndarray, px: FloatMap) -> list[np.ndarray]:
        X, Y, D = 2 * x / width - 1, 2 * y / height - 1, px / 50
        return [np.ones_like(X), X, X * X, Y, D, X * D]

    A, b = np.stack(terms(y, x, teacher_px[y, x]), axis=1), difference[y, x]
    fit = np.linalg.lstsq(A, b, rcond=None)[0]
    near = np.abs(b - A @ fit) < INLIER_PX
    fit = np.linalg.lstsq(A[near], b[near], rcond=None)[0]
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    off = sum(factor * term for factor, term in zip(fit, terms(rows, columns, teacher_px), strict=True))
    return np.asarray(off, np.float32)
