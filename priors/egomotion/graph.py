"""Pose graph: poses that agree best with measured motions between them, and stay near where they were recorded.

It is least squares over poses T_i (Grisetti et al., "A Tutorial on Graph-Based SLAM", 2010), by Gauss-Newton: each pose
is multiplied from the right by a small motion, and Cauchy's weights hold off what is measured wrongly.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

from priors.egomotion.motion import exp
from priors.geometry import invert
from priors.types import Matrix

Floats = npt.NDArray[np.float64]
SIZE = 6
ROUNDS, STILL = 30, 1e-7
DOUBT = 3.0
"""A measurement that is so many deviations off counts half."""


class Edge(NamedTuple):
    """A measured motion between two poses, or from the world to one."""

    this: int | None
    """Position of the pose that is the frame of reference; None: the world."""
    other: int
    T_this_other: Matrix
    """(4, 4) metres."""
    information: Matrix
    """(6, 6), the inverse of the covariance of what is multiplied from the right: shift, metres, then turn, radians."""


def solve(poses: Sequence[Matrix], edges: Sequence[Edge]) -> list[Matrix]:
    """Return the poses (4, 4) that fit the edges best.

    Args:
        poses: to start from.
        edges: each pose must be held by some, directly or over others, down to the world.
    """
    poses = list(poses)
    for _ in range(ROUNDS):
        step = _step(poses, edges)
        poses = [_rigid(T @ exp(own)) for T, own in zip(poses, step, strict=True)]
        if np.abs(step).max(initial=0) < STILL:
            break
    return poses


def misfit(poses: Sequence[Matrix], edge: Edge) -> Floats:
    """Return how far poses are from a measurement (6,): shift, metres, then turn, radians."""
    T_this_other = poses[edge.other] if edge.this is None else invert(poses[edge.this]) @ poses[edge.other]
    E = invert(edge.T_this_other) @ T_this_other
    return np.concatenate([E[:3, 3], Rotation.from_matrix(E[:3, :3]).as_rotvec()])


def _step(poses: Sequence[Matrix], edges: Sequence[Edge]) -> Floats:
    """Return one Gauss-Newton step (n, 6)."""
    rows, columns, values = [], [], []
    gradient = np.zeros((len(poses), SIZE))
    block_rows, block_columns = np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij")
    for edge in edges:
        off = misfit(poses, edge)
        information = edge.information / (1 + off @ edge.information @ off / DOUBT**2)
        for a, J_a in _jacobians(poses, edge):
            gradient[a] -= J_a.T @ information @ off
            for b, J_b in _jacobians(poses, edge):
                rows.append(SIZE * a + block_rows.ravel())
                columns.append(SIZE * b + block_columns.ravel())
                values.append((J_a.T @ information @ J_b).ravel())
    places = (np.concatenate(rows), np.concatenate(columns))
    normal = coo_array((np.concatenate(values), places), shape=(gradient.size, gradient.size)).tocsc()
    return np.asarray(spsolve(normal, gradient.ravel())).reshape(-1, SIZE)


def _jacobians(poses: Sequence[Matrix], edge: Edge) -> list[tuple[int, Matrix]]:
    """Return the derivative (6, 6) of an edge's misfit by the motion of each of its poses, for small misfits."""
    if edge.this is None:
        return [(edge.other, np.eye(SIZE))]
    T_other_this = invert(poses[edge.other]) @ poses[edge.this]
    return [(edge.other, np.eye(SIZE)), (edge.this, -_adjoint(T_other_this))]


def _adjoint(T: Matrix) -> Matrix:
    """Return what turns a small motion (shift, turn) before T into the same motion after it (6, 6)."""
    x, y, z = T[:3, 3]
    A = np.zeros((SIZE, SIZE))
    A[:3, :3] = A[3:, 3:] = T[:3, :3]
    A[:3, 3:] = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ T[:3, :3]
    return A


def _rigid(T: Matrix) -> Matrix:
    """Return the pose with rounding taken out of its rotation."""
    U, _, V = np.linalg.svd(T[:3, :3])
    T = T.copy()
    T[:3, :3] = U @ V
    return T
