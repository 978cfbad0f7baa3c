"""Yaw by edges: the outlines of near surfaces in the sweeps lie on upright edges in the images.

Both sides of things count, and how far outlines stand out of them is fitted beside: a laser's spot is wide, so surfaces
look wider to it than to the camera. No pair is needed. Pitch and roll are not told: lines are far apart upwards.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import as_grey
from priors.extrinsics.correction import Correction
from priors.extrinsics.outlines import find_outlines
from priors.extrinsics.points import Points, crop, in_view
from priors.types import Camera, FloatMap, Image, Matrix, Sweep

Floats = npt.NDArray[np.float64]

SMOOTH_PX, HALF_LEVELS = 0.8, 8.0
"""Blur before the gradient; the gradient, grey levels a pixel, that counts half as much as the strongest."""
COARSE_PX, FINE_PX = 4.0, 1.5
"""Blur of the edges, first and last."""
COARSE_DEG, FINE_DEG, FINE_REACH_DEG = 0.04, 0.02, 0.12
"""Steps in which yaw is looked for; how far on either side at last."""
OUT_PX = np.arange(-2.0, 2.1, 0.5)
"""How far outlines may stand out of the things in the image, px."""
FEWEST = 300
"""Outline points in all frames."""
MOST = 8000
"""Of one frame."""
MARGIN_PX = 12.0


@dataclass(frozen=True)
class EdgeView:
    """What one frame shows of outlines."""

    points: Points
    side: Floats
    """(n,) see Outlines."""
    camera: Camera
    grey: Image

    @classmethod
    def of(cls, image: Image, camera: Camera, sweep: Sweep, T_cam_lidar: Matrix) -> "EdgeView":
        """Find the outlines of a sweep that fall into the image (height, width, ...)."""
        seen = crop(sweep, camera, T_cam_lidar)
        found = find_outlines(seen.xyz_m)
        times = None if seen.time_s is None else seen.time_s[found.source]
        points = Points.of_sweep(replace(sweep, xyz_m=found.xyz_m, time_s=times), T_cam_lidar)
        inside = np.flatnonzero(in_view(camera, points.xyz_m + points.origin_m, MARGIN_PX))
        some = inside[:: max(1, -(-len(inside) // MOST))]
        return cls(points.take(some), found.side[some], camera, as_grey(image))

    def strengths(self, by: Correction, yaws_deg: Floats, edges: FloatMap) -> Floats:
        """Return the edges' strength, summed over the outlines, (yaws, len(OUT_PX)), for yaws beside a correction's."""
        pitch, yaw, roll = by.turn_deg
        columns, rows = [], []
        for yaw_deg in yaws_deg.tolist():
            xyz_m = self.points.placed(replace(by, turn_deg=(pitch, yaw + yaw_deg, roll)))
            columns.append(self.camera.K[0, 0] * xyz_m[:, 0] / xyz_m[:, 2] + self.camera.K[0, 2])
            rows.append(self.camera.K[1, 1] * xyz_m[:, 1] / xyz_m[:, 2] + self.camera.K[1, 2])
        u = np.array(columns)[:, None] - OUT_PX[:, None] * self.side
        v = np.broadcast_to(np.array(rows)[:, None], u.shape)
        flat = (len(yaws_deg) * len(OUT_PX), len(self.points))
        at = [np.ascontiguousarray(x.reshape(flat), dtype=np.float32) for x in (u, v)]
        found = cv2.remap(edges, at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(found.sum(axis=1, dtype=np.float64)).reshape(len(yaws_deg), len(OUT_PX))


class Yaw(NamedTuple):
    """What edges say."""

    deg: float
    """The correction's yaw, degrees."""
    error_deg: float
    """Standard error, degrees."""


def upright_edges(grey: Image) -> FloatMap:
    """Return how strong upright edges are (height, width), in [0, 1]."""
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), SMOOTH_PX)
    levels = np.abs(cv2.Scharr(smooth, cv2.CV_32F, 1, 0)) / np.float32(32)
    return np.asarray(levels / (levels + np.float32(HALF_LEVELS)), dtype=np.float32)


def yaw_by_edges(views: Sequence[EdgeView], start: Correction, reach_deg: float) -> Yaw | None:
    """Find the yaw at which outlines lie on the strongest edges; None where too few outlines, or no peak, are seen.

    Args:
        views: of several frames.
        start: the correction in which yaw is looked for.
        reach_deg: how far on either side of its yaw.
    """
    views = [view for view in views if len(view.points)]
    if sum(len(view.points) for view in views) < FEWEST:
        return None
    strong = [upright_edges(view.grey) for view in views]
    best = 0.0
    looks = (COARSE_PX, reach_deg, COARSE_DEG), (FINE_PX, FINE_REACH_DEG, FINE_DEG)
    for blur_px, reach, step_deg in looks:
        count = round(reach / step_deg)
        yaws_deg = best + step_deg * np.linspace(-count, count, 2 * count + 1)
        blurred = [np.asarray(cv2.GaussianBlur(edges, (0, 0), blur_px), np.float32) for edges in strong]
        scores = np.array([view.strengths(start, yaws_deg, edges) for view, edges in zip(views, blurred, strict=True)])
        within = scores.sum(axis=0)[:, 1:-1]
        row, column = np.unravel_index(int(np.argmax(within)), within.shape)
        if not 0 < row < len(yaws_deg) - 1:
            return None
        column += 1
        best = float(yaws_deg[row])
    return _peak(scores[:, row - 1 : row + 2, column - 1 : column + 2], start.turn_deg[1] + best, FINE_DEG)


def _peak(scores: Floats, middle_deg: float, step_deg: float) -> Yaw | None:
    """Return the top of the paraboloid through the frames' scores (frames, 3 yaws, 3 distances out) around the best.

    The standard error is that of an M-estimator (Huber 1967): the frames' gradients there, through the curvature.
    """
    gradients = np.stack([scores[:, 2, 1] - scores[:, 0, 1], scores[:, 1, 2] - scores[:, 1, 0]], axis=1) / 2
    total = scores.sum(axis=0)
    both = (total[2, 2] - total[2, 0] - total[0, 2] + total[0, 0]) / 4
    yaw, out = total[2, 1] - 2 * total[1, 1] + total[0, 1], total[1, 2] - 2 * total[1, 1] + total[1, 0]
    H = np.array([[yaw, both], [both, out]])
    if not (np.linalg.eigvalsh(H) < 0).all():
        return None
    step = np.clip(-np.linalg.solve(H, gradients.sum(axis=0)), -1, 1)
    spread = gradients - gradients.mean(axis=0)
    count = len(scores)
    covariance = np.linalg.solve(H, spread.T @ spread * count / max(1, count - 1)) @ np.linalg.inv(H)
    return Yaw(middle_deg + step_deg * float(step[0]), step_deg * float(np.sqrt(max(0.0, covariance[0, 0]))))
