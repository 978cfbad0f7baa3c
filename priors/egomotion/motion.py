"""Motion of a camera between two frames, as corners with depth show it, and how sure it is.

Perspective-n-point with RANSAC (Fischler and Bolles, CACM 1981; cv2.solvePnPRansac), then least squares with Cauchy's
weights of the distances in the image.
"""

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from priors.egomotion.corners import Corners
from priors.geometry import invert
from priors.types import Camera, Matrix

Floats = npt.NDArray[np.float64]

TRIALS, LOOSE_PX = 300, 1.0
FEWEST, SHARE = 30, 0.3
"""Corners that must agree on a motion, and their share of all."""
ROUNDS = 10
TRACK_PX, MATCH_PX, RANGE = 0.15, 0.3, 0.01
"""How far off corners are: the tracker, the disparity of a pair, and a LiDAR's depth as a share."""
LENGTH, SHARED_M, SHARED_RAD = 0.02, 1e-3, 1e-4
"""What all corners of two frames are off together, which does not average out: a share of the way, along it (wrong
disparities make all ways longer or shorter), a shift and a turn."""


class SeenMotion(NamedTuple):
    """A camera's motion between two frames."""

    T_this_other: Matrix
    """(4, 4) from the other frame's camera to this one's, metres."""
    covariance: Matrix
    """(6, 6) of what is multiplied to it from the right: shift, metres, then turn, radians."""


class Agreed(NamedTuple):
    """A motion on which points agree, as OpenCV gives it."""

    turn: Floats
    """By Rodrigues."""
    shift: Floats
    """Metres."""
    inside: npt.NDArray[np.int64]
    """The positions of the points that agree."""


def see(corners: Corners) -> SeenMotion | None:
    """Return the motion that corners of this frame, followed into the other, show; None where too few agree on one."""
    T_other_this = _first_guess(corners, corners.camera)
    if T_other_this is None:
        return None
    sigma_px = _spread_px(corners)
    for _ in range(ROUNDS):
        xyz_m = corners.xyz_m @ T_other_this[:3, :3].T + T_other_this[:3, 3]
        residual_px, J = _reproject(xyz_m, corners.end_px, corners.camera)
        weight = 1 / (sigma_px**2 + np.square(residual_px).sum(axis=1))  # Cauchy's, of residual over sigma
        normal = np.einsum("nki,n,nkj->ij", J, weight, J)
        step = np.linalg.solve(normal, np.einsum("nki,n,nk->i", J, weight, residual_px))
        T_other_this = exp(step) @ T_other_this
    if not np.isfinite(T_other_this).all():
        return None
    way_m = np.append(T_other_this[:3, 3], np.zeros(3))
    shared = np.diag(np.square([SHARED_M] * 3 + [SHARED_RAD] * 3)) + LENGTH**2 * np.outer(way_m, way_m)
    return SeenMotion(invert(T_other_this), np.linalg.inv(normal) + shared)


def exp(step: Floats) -> Matrix:
    """Return the motion (4, 4) of a small step (6,): shift, then turn."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(step[3:]).as_matrix(), step[:3]
    return T


def _first_guess(corners: Corners, camera: Camera) -> Matrix | None:
    """Return T_other_this on which most corners agree; None where few do."""
    found = agree(corners.xyz_m, corners.end_px, camera, (FEWEST, SHARE), cv2.SOLVEPNP_ITERATIVE)
    return None if found is None else motion_of(found.turn, found.shift)


def agree(xyz_m: Floats, uv_px: Floats, camera: Camera, least: tuple[int, float], solver: int) -> Agreed | None:
    """Return the motion on which most points agree; None where they are too few.

    Args:
        xyz_m: points (n, 3).
        uv_px: where they are seen (n, 2).
        camera: that sees them.
        least: points that must agree, and their share of all.
        solver: of the points that agree, one of OpenCV's SOLVEPNP.
    """
    if len(xyz_m) < least[0]:
        return None
    uv_px = np.ascontiguousarray(uv_px)
    try:
        done, turn, shift, agreeing = cv2.solvePnPRansac(
            xyz_m, uv_px, camera.K, None, iterationsCount=TRIALS, reprojectionError=LOOSE_PX, flags=solver
        )
    except cv2.error:  # points that lie in one line, or all at one place
        return None
    if not done or agreeing is None or len(agreeing) < max(least[0], least[1] * len(uv_px)):
        return None
    return Agreed(np.asarray(turn, np.float64), np.asarray(shift, np.float64), agreeing.ravel().astype(np.int64))


def motion_of(turn: Floats, shift: Floats) -> Matrix:
    """Return the motion (4, 4) of a turn by Rodrigues and a shift, metres, as OpenCV gives them."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
    return T


def _spread_px(corners: Corners) -> Floats:
    """Return how far off each corner's place is expected to be (n,), px: by the tracker, and by its depth's error.

    A depth that is wrong by a share moves the place by that share of the way across the image.
    """
    z = corners.xyz_m[:, 2]
    share = np.full_like(z, RANGE) if corners.fx_baseline is None else MATCH_PX * z / corners.fx_baseline
    return np.hypot(TRACK_PX, share * np.linalg.norm(corners.end_px - corners.start_px, axis=1))


def _reproject(xyz_m: Floats, end_px: Floats, camera: Camera) -> tuple[Floats, Floats]:
    """Return how far corners (n, 2), px, lie from where a motion puts them, and its derivative (n, 2, 6)."""
    x, y, z = xyz_m.T
    z = np.maximum(z, 0.1)
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    uv_px = np.stack([fx * x / z + camera.K[0, 2], fy * y / z + camera.K[1, 2]], axis=1)
    zero = np.zeros_like(z)
    by_point = np.stack([fx / z, zero, -fx * x / z**2, zero, fy / z, -fy * y / z**2], axis=1).reshape(-1, 2, 3)
    turned = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=1).reshape(-1, 3, 3)  # d(turn x point) / d turn
    return end_px - uv_px, np.concatenate([by_point, by_point @ turned], axis=2)
