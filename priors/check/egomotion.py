"""Ego motion as two images show it: corners are followed from one to the next, and depth makes metres of them.

With depth it is the pose that puts the corners' points where they are seen (PnP). Without, it is that of the essential
matrix, whose translation has a direction and no length.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from priors.egomotion.corners import track
from priors.egomotion.motion import agree, motion_of
from priors.types import Camera, FloatMap, Image, Matrix

Floats = npt.NDArray[np.float64]

CORNERS, APART_PX, QUALITY = 600, 6, 0.005
BACK_PX = 0.5
"""How near a corner must come back to where it started: motions are told apart here, not measured."""
FEWEST, SHARE = 20, 0.4
"""Corners that must agree on a motion, and their share of those with depth."""
FLAT_FEWEST, FLAT_SHARE, FLAT_FLOW_PX = 50, 0.6, 2.0
"""The same without depth, and the median flow below which the direction is not known."""
LOOSE_PX = 1.0
"""How far a corner may lie from where a motion puts it."""
NEAREST_M, FARTHEST_M = 1.0, 100.0
SHORTEST_M = 0.1
"""A shorter motion has no sure direction."""
AROUND_PX = 5
"""Side of the window in which a sparse map may have a corner's depth."""


@dataclass(frozen=True)
class SeenMotion:
    """The camera's motion from one image to the next."""

    T_next_this: Matrix
    """(4, 4); its translation is metres where `by` is not None, else of length 1."""
    by: str | None
    """What told the depth: stereo, LiDAR, truth or sparse; None: nothing did."""


def see_motion(this: Image, following: Image, camera: Camera, depths: Mapping[str, FloatMap]) -> SeenMotion | None:
    """Measure the motion between two grey images (height, width) of one camera; None where they do not show it.

    Args:
        this: the first image.
        following: the next image.
        camera: of both.
        depths: depth maps (height, width) of the first, metres, 0 = none, by what made them; the first that serves is
            taken.
    """
    start_px, end_px = _follow(this, following)
    for name, depth_m in depths.items():
        T = _by_depth(start_px, end_px, camera, depth_m)
        if T is not None:
            far = float(np.linalg.norm(T[:3, 3])) > SHORTEST_M
            return SeenMotion(T, name) if far else None
    T = _by_directions(start_px, end_px, camera)
    return None if T is None else SeenMotion(T, None)


def _follow(this: Image, following: Image) -> tuple[Floats, Floats]:
    """Follow corners from one image to the next; returns both places (n, 2), px."""
    corners = cv2.goodFeaturesToTrack(this, CORNERS, QUALITY, APART_PX)
    start_px = np.zeros((0, 2)) if corners is None else np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    end_px, sure = track(this, following, start_px, start_px, BACK_PX)
    return start_px[sure], end_px[sure]


def _by_depth(start_px: Floats, end_px: Floats, camera: Camera, depth_m: FloatMap) -> Matrix | None:
    """Return T_next_this by PnP (RANSAC, then least squares) of the corners that have depth; None where few agree."""
    z = _depth_at(start_px, depth_m)
    known = (z > NEAREST_M) & (z < FARTHEST_M)
    rays = np.column_stack([start_px[known], np.ones(np.count_nonzero(known))]) @ np.linalg.inv(camera.K).T
    xyz_m, uv_px = rays * z[known, None], np.ascontiguousarray(end_px[known])
    found = agree(xyz_m, uv_px, camera, (FEWEST, SHARE), cv2.SOLVEPNP_EPNP)
    if found is None:
        return None
    on = found.inside
    turn, shift = cv2.solvePnPRefineLM(xyz_m[on], uv_px[on], camera.K, None, found.turn, found.shift)
    T = motion_of(np.asarray(turn, np.float64), np.asarray(shift, np.float64))
    return T if np.isfinite(T).all() else None


def _depth_at(places_px: Floats, depth_m: FloatMap) -> Floats:
    """Return the depth at places (n, 2), px: the pixel's own, else the nearest in a small window; 0 = none."""
    column, row = np.rint(places_px).astype(np.int64).T
    some_m = np.where(depth_m > 0, depth_m, np.float32(np.inf))
    around_m = cv2.erode(some_m, np.ones((AROUND_PX, AROUND_PX), np.uint8))[row, column]
    own_m = depth_m[row, column]
    z = np.where(own_m > 0, own_m, around_m).astype(np.float64)
    return np.where(np.isfinite(z), z, 0.0)


def _by_directions(start_px: Floats, end_px: Floats, camera: Camera) -> Matrix | None:
    """Return T_next_this, its translation of length 1, by the essential matrix (RANSAC); None where few agree."""
    if len(start_px) < FLAT_FEWEST or np.median(np.linalg.norm(end_px - start_px, axis=1)) < FLAT_FLOW_PX:
        return None
    E, agreeing = cv2.findEssentialMat(start_px, end_px, camera.K, method=cv2.RANSAC, prob=0.999, threshold=LOOSE_PX)
    if E is None or E.shape != (3, 3):
        return None
    count, R, shift, _ = cv2.recoverPose(E, start_px, end_px, camera.K, mask=agreeing)
    if count < max(FLAT_FEWEST, FLAT_SHARE * len(start_px)):
        return None
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, shift.ravel()
    return T
