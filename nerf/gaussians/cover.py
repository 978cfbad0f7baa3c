"""Cover: where a view is covered by what was taken so far: each surface is taken once, where it is seen best."""

import numpy as np
import numpy.typing as npt

from nerf.gaussians.look import FARTHEST_M, Look
from priors.geometry import invert, project, transform
from priors.machine import threads
from priors.types import Camera, Matrix

Floats = npt.NDArray[np.float32]
Flags = npt.NDArray[np.bool_]

SAME = 0.08
"""Depths that differ by less than this share are of one surface."""
THROUGH = np.float32(0.9)
"""A view looks through a place that is nearer than this share of its own depth there."""
THROUGH_VOTES = 2
"""A place that so many of its neighbours look through is no surface."""


class Cover:
    """Points in blocks, one a frame: blocks that a view cannot see cost nothing."""

    def __init__(self) -> None:
        self._blocks: list[Floats] = []
        """Points (n, 3)."""
        self._balls: list[npt.NDArray[np.float64]] = []
        """(4,) middle and radius of each block, metres."""

    def add(self, means_m: Floats) -> None:
        """Take points (n, 3) of the scene's frame, metres."""
        if len(means_m):
            middle = means_m.mean(axis=0)
            self._blocks.append(means_m)
            self._balls.append(np.append(middle, np.linalg.norm(means_m - middle, axis=1).max()).astype(np.float64))

    def cells(self, look: Look, step: int) -> tuple[Flags, Flags]:
        """Tell of the cells of step x step pixels of a frame which show a point at all, and which are covered.

        A cell is covered where a point lies at about the depth of the surface at its middle.
        """
        from nerf.kernels.cpu.splat_cover import Cells, cover

        depth_m = np.ascontiguousarray(look.depth_m[step // 2 :: step, step // 2 :: step])
        found = Cells(depth_m, *(np.zeros(depth_m.shape, np.uint8) for _ in range(2)))
        T_cam_world = invert(look.T_world_cam)
        projection = np.ascontiguousarray(look.camera.K @ T_cam_world[:3])
        if self._balls:
            may = np.flatnonzero(_may_see(look.camera, T_cam_world, np.stack(self._balls)))
            # threads may write to one cell at once, and they write the same
            threads.run(len(may), lambda task: cover(self._blocks[may[task]], projection, found, step, SAME))
        return found.filled > 0, found.covered > 0


def looked_through(means_m: Floats, others: list[Look]) -> Flags:
    """Tell which points (n, 3) are no surface: other frames see what is behind them."""
    votes = np.zeros(len(means_m), np.int32)
    for other in others:
        uv, z = project(other.camera, transform(invert(other.T_world_cam), means_m))
        height, width = other.camera.size
        with np.errstate(invalid="ignore"):
            seen = (z > 0) & (uv > -0.5).all(axis=1) & (uv[:, 0] < width - 0.5) & (uv[:, 1] < height - 0.5)
        column, row = np.rint(uv[seen]).astype(np.intp).T
        votes[seen] += (other.trust[row, column] > 0) & (z[seen] < THROUGH * other.depth_m[row, column])
    return np.asarray(votes >= THROUGH_VOTES)


def _may_see(camera: Camera, T_cam_world: Matrix, balls: npt.NDArray[np.float64]) -> Flags:
    """Tell which balls (b, 4), middle and radius, reach into a view's pyramid."""
    x, y, z = transform(T_cam_world, balls[:, :3]).T
    radius, (height, width), K = balls[:, 3], camera.size, camera.K
    may = (z + radius > 0) & (z - radius <= FARTHEST_M)
    for place, focal, centre, side in ((x, K[0, 0], K[0, 2], width), (y, K[1, 1], K[1, 2], height)):
        low, high = (-0.5 - centre) / focal, (side - 0.5 - centre) / focal
        may &= (low * z - place <= radius * np.hypot(1, low)) & (place - high * z <= radius * np.hypot(1, high))
    return np.asarray(may)
