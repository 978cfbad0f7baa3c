"""Corners: followed from one image to another by the Lucas-Kanade tracker, there and back.

Bouguet, "Pyramidal Implementation of the Lucas Kanade Feature Tracker", 2001; corners by Shi and Tomasi, CVPR 1994.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from priors.egomotion.sight import Sight
from priors.geometry import project, transform
from priors.types import Camera, Image, Mask, Matrix

Floats = npt.NDArray[np.float64]

CORNERS, QUALITY, APART_PX = 1500, 0.003, 6
WINDOW_PX, LEVELS, ROUNDS, STEP_PX = 21, 4, 30, 0.01
BACK_PX = 0.3
"""How near a corner must come back to where it started."""
NEAREST_M, FARTHEST_M = 1.0, 80.0


class Corners(NamedTuple):
    """Corners with depth, followed into another image."""

    xyz_m: Floats
    """(n, 3) in the first camera."""
    start_px: Floats
    """(n, 2) in the first image."""
    end_px: Floats
    """(n, 2) in the other image."""
    camera: Camera
    """Of both."""
    fx_baseline: float | None
    """See Sight."""


def follow(this: Sight, other: Sight, T_other_this: Matrix | None = None) -> Corners:
    """Follow the corners of one sight that have depth into another's image.

    Args:
        this: where corners are found.
        other: where they are looked for.
        T_other_this: (4, 4) the motion to expect, metres: what is near is then found although it moves far.
    """
    known = (this.depth_m > NEAREST_M) & (this.depth_m < FARTHEST_M)
    corners = cv2.goodFeaturesToTrack(this.grey, CORNERS, QUALITY, APART_PX, mask=known.astype(np.uint8))
    start_px = np.zeros((0, 2)) if corners is None else np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    column, row = np.rint(start_px).astype(np.int64).T
    rays = np.column_stack([start_px, np.ones(len(start_px))]) @ np.linalg.inv(this.camera.K).T
    xyz_m = rays * this.depth_m[row, column].astype(np.float64)[:, None]
    expected_px = start_px if T_other_this is None else _expect(xyz_m, start_px, other.camera, T_other_this)
    end_px, sure = track(this.grey, other.grey, start_px, expected_px)
    return Corners(xyz_m[sure], start_px[sure], end_px[sure], this.camera, this.fx_baseline)


def _expect(xyz_m: Floats, start_px: Floats, camera: Camera, T_other_this: Matrix) -> Floats:
    """Return where points (n, 3) are expected in the other image (n, 2), px; where they started if that is outside."""
    uv_px, z = project(camera, transform(T_other_this, xyz_m))
    height, width = camera.size
    inside = (z > NEAREST_M) & ((uv_px >= 0) & (uv_px <= [width - 1, height - 1])).all(axis=1)
    return np.where(inside[:, None], uv_px, start_px)


def track(
    this: Image, other: Image, start_px: Floats, expected_px: Floats, back_px: float = BACK_PX
) -> tuple[Floats, Mask]:
    """Find places (n, 2), px, of one grey image in another, near where they are expected (n, 2).

    Args:
        this: the image that the places are of.
        other: where they are looked for.
        start_px: the places.
        expected_px: where the search begins.
        back_px: how near a place must come back to where it started.

    Returns:
        the places in the other image (n, 2), px, and which of them are sure (n,): found there and back again.
    """
    if not len(start_px):
        return np.zeros((0, 2)), np.zeros(0, dtype=bool)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, ROUNDS, STEP_PX)
    options: dict[str, Any] = {
        "winSize": (WINDOW_PX, WINDOW_PX),
        "maxLevel": LEVELS,
        "criteria": criteria,
        "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
    }
    start, expected = (np.ascontiguousarray(places, dtype=np.float32)[:, None] for places in (start_px, expected_px))
    found_px, found, _ = cv2.calcOpticalFlowPyrLK(this, other, start, expected.copy(), **options)
    towards = np.asarray(found_px) + start - expected
    returned_px, again, _ = cv2.calcOpticalFlowPyrLK(other, this, np.asarray(found_px), towards, **options)
    end_px = np.asarray(found_px, dtype=np.float64).reshape(-1, 2)
    sure = (found.ravel() == 1) & (again.ravel() == 1)
    sure &= np.linalg.norm(start_px - np.asarray(returned_px, dtype=np.float64).reshape(-1, 2), axis=1) < back_px
    height, width = other.shape
    return end_px, sure & ((end_px >= 0) & (end_px <= [width - 1, height - 1])).all(axis=1)
