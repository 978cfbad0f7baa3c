"""Patches: how alike two posed images are where a pixel's depth, times one factor after another, puts it.

Likeness is zero-mean normalised cross-correlation of square patches, whose pixels are all taken to be at the depth of
the one in the middle (plane sweep: Collins, CVPR 1996). It does not change with exposure.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from priors.geometry import invert
from priors.types import Camera, Matrix

Floats = npt.NDArray[np.floating[Any]]

HALF = 2
"""A patch has 2 HALF + 1 pixels a side."""
PLAIN = 4.0
"""Standard deviation of a patch's grey values, of 255, below which it shows nothing that could be found again."""
FLAT = 2.0
"""Added to the standard deviations that the correlation divides by."""
IN_FRONT_M = 0.5


@dataclass(frozen=True)
class Shot:
    """A posed image."""

    grey: npt.NDArray[np.float32]
    """(height, width), of 255."""
    camera: Camera
    T_world_cam: Matrix


@dataclass(frozen=True)
class Pixels:
    """Pixels (n,) of a shot and their depth."""

    row: npt.NDArray[np.int64]
    column: npt.NDArray[np.int64]
    depth_m: Floats


def textured(grey: npt.NDArray[np.float32]) -> npt.NDArray[np.bool_]:
    """Tell around which pixels of an image (h, w) a patch shows something; none whose patch leaves the image."""
    side = (2 * HALF + 1, 2 * HALF + 1)
    mean, square = cv2.blur(grey, side), cv2.blur(grey * grey, side)
    out = square - mean * mean > PLAIN * PLAIN
    inner = np.zeros(grey.shape, dtype=bool)
    inner[HALF:-HALF, HALF:-HALF] = True
    return np.asarray(out & inner)


def likeness(this: Shot, pixels: Pixels, other: Shot, factors: Floats) -> npt.NDArray[np.float32]:
    """Compare patches of this shot with where the other one shows them.

    Args:
        this: the shot that the pixels are of.
        pixels: n of them, their patches inside of the image.
        other: of the same scene.
        factors: (f,) what the depths are multiplied by.

    Returns:
        (n, f) in [-1, 1]; NaN where the patch's middle leaves the other image or lies behind it.
    """
    across = np.arange(-HALF, HALF + 1)
    rows, columns = (grid.ravel() for grid in np.meshgrid(across, across, indexing="ij"))
    x, y = pixels.column[:, None] + columns, pixels.row[:, None] + rows
    own = this.grey[y, x]
    homogeneous = np.stack([x, y, np.ones_like(x)], axis=-1).astype(np.float64)
    T_other_this = invert(other.T_world_cam) @ this.T_world_cam
    turn = other.camera.K @ T_other_this[:3, :3] @ np.linalg.inv(this.camera.K)
    turned, shift = homogeneous @ turn.T, other.camera.K @ T_other_this[:3, 3]
    out = np.full((len(pixels.row), len(factors)), np.nan, np.float32)
    for index, factor in enumerate(factors):
        place = turned * (factor * pixels.depth_m)[:, None, None] + shift
        inside, seen = _look(other, place)
        out[inside, index] = _correlation(own[inside], seen)
    return out


def _look(shot: Shot, place: Floats) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.float32]]:
    """Return which patches (n, p, 3), homogeneous pixels times depth, a shot shows, and their grey values (m, p)."""
    height, width = shot.grey.shape
    middle = place[:, place.shape[1] // 2]
    depth_m = np.maximum(middle[:, 2], 1e-6)
    u, v = middle[:, 0] / depth_m, middle[:, 1] / depth_m
    inside = (middle[:, 2] > IN_FRONT_M) & (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
    px = place[inside, :, :2] / np.maximum(place[inside, :, 2:], 1e-6)
    if not len(px):
        return inside, np.zeros(px.shape[:2], np.float32)
    x, y = (np.ascontiguousarray(px[..., axis], dtype=np.float32) for axis in (0, 1))
    seen = cv2.remap(shot.grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return inside, np.asarray(seen, np.float32)


def _correlation(a: npt.NDArray[np.float32], b: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Correlate patches (n, p) one by one, (n,)."""
    a, b = a - a.mean(axis=1, keepdims=True), b - b.mean(axis=1, keepdims=True)
    spread = (np.sqrt((a * a).mean(axis=1)) + FLAT) * (np.sqrt((b * b).mean(axis=1)) + FLAT)
    return np.asarray((a * b).mean(axis=1) / spread)
