"""LiDAR odometry: where a scanner stood, from its sweeps alone, by point-to-plane ICP from one to the next.

For real drives without poses, so that what they saw accumulates into truth for training.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from priors.geometry import transform
from priors.types import Matrix

Points = npt.NDArray[np.floating]
NEIGHBOURS = 12
FLAT = 0.02
"""A point has a normal where its neighbourhood's smallest spread is below this share of the whole."""
STEPS = 30
FIRST_M, LAST_M = 1.5, 0.12
"""Largest distance to a plane's point that still pairs, at the first and at the last step."""
NEAR_M = 45.0
"""Points farther away than this are left out: too sparse for normals."""


def poses(sweeps: Sequence[Points]) -> list[Matrix]:
    """Return every scanner's pose (4, 4) in the first one's axes, from sweeps (n, 3), metres."""
    T_first_others, step = [np.eye(4)], np.eye(4)
    for before, now in pairwise(sweeps):
        step = align(now, before, step)  # it goes on as it went
        T_first_others.append(T_first_others[-1] @ step)
    return T_first_others


def align(moving: Points, fixed: Points, T_fixed_moving: Matrix) -> Matrix:
    """Return T_fixed_moving (4, 4) by point-to-plane ICP (Chen and Medioni, 1992) from a guess."""
    fixed, moving = (points[np.linalg.norm(points, axis=1) < NEAR_M].astype(np.float64) for points in (fixed, moving))
    tree = cKDTree(fixed)
    normals, flat = _normals(fixed, tree)
    for step in range(STEPS):
        limit_m = FIRST_M * (LAST_M / FIRST_M) ** (step / (STEPS - 1))
        placed = transform(T_fixed_moving, moving)
        distance_m, index = tree.query(placed, distance_upper_bound=limit_m)
        paired = np.isfinite(distance_m)
        paired[paired] = flat[index[paired]]
        at, normal = placed[paired], normals[index[paired]]
        off_m = np.einsum("ij,ij->i", fixed[index[paired]] - at, normal)
        rows = np.concatenate([np.cross(at, normal), normal], axis=1)
        weight = 1 / (1 + (off_m / (0.5 * limit_m)) ** 2) ** 2
        left = (rows * weight[:, None]).T @ rows + 1e-6 * np.eye(6)
        change = np.linalg.solve(left, (rows * weight[:, None]).T @ off_m)
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(change[:3]).as_matrix()
        T[:3, 3] = change[3:]
        T_fixed_moving = T @ T_fixed_moving
    return T_fixed_moving


def _normals(points: Points, tree: cKDTree) -> tuple[Points, npt.NDArray[np.bool_]]:
    """Return unit normals (n, 3) and where the surface is flat enough for one."""
    _, index = tree.query(points, NEIGHBOURS)
    around = points[index] - points[index].mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    return axes[:, :, 0], spread[:, 0] < FLAT * spread.sum(axis=1)
