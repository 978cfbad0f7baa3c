"""Yaw by edges: the outlines of near surfaces in the sweeps lie on upright edges in the images.

Both sides of things count, and how far outlines stand out of them is fitted beside: a laser's spot is wide, so surfaces
look wider to it than to the camera. A turn moves outlines at all distances alike, a LiDAR that stands aside the near
ones more. No pair is needed. Pitch and roll are not told: lines are far apart upwards.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import as_grey
from priors.extrinsics.correction import Correction
from priors.extrinsics.fit import PLACE_M
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
AROUND_DEG, ASIDES_M, ASIDES_STEP_M = 0.3, np.arange(-0.036, 0.037, 0.009), 0.009
"""Where yaw and the LiDAR's place, metres to the right, are weighed at last: more than three times PLACE_M."""
LEAST_UNIT, MOST_UNIT = 1.0, 20.0
"""Strength of how many outlines is one nat: those of a laser's neighbouring lines lie on one edge."""
ASIDE_M = 0.008
"""How far aside a LiDAR seems to be, however many frames there are (standard deviation), metres: half a pixel at
ten metres, by which the edges of near things look wider or narrower than those of far ones."""
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

    def strengths(self, placed: Sequence[Correction], out_px: Floats, edges: FloatMap) -> Floats:
        """Return the edges' strength (height, width), summed over the outlines, (len(placed), len(out_px))."""
        columns, rows = [], []
        for by in placed:
            xyz_m = self.points.placed(by)
            columns.append(self.camera.K[0, 0] * xyz_m[:, 0] / xyz_m[:, 2] + self.camera.K[0, 2])
            rows.append(self.camera.K[1, 1] * xyz_m[:, 1] / xyz_m[:, 2] + self.camera.K[1, 2])
        u = np.array(columns)[:, None] - out_px[:, None] * self.side
        v = np.broadcast_to(np.array(rows)[:, None], u.shape)
        flat = (len(placed) * len(out_px), len(self.points))
        at = [np.ascontiguousarray(x.reshape(flat), dtype=np.float32) for x in (u, v)]
        found = cv2.remap(edges, at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(found.sum(axis=1, dtype=np.float64)).reshape(len(placed), len(out_px))


class Yaw(NamedTuple):
    """What edges say."""

    deg: float
    """The correction's yaw, degrees."""
    aside_m: float
    """How far the LiDAR stands to the right of where the calibration puts it, metres: near 0, as far as edges allow."""
    covariance: Floats
    """(2, 2) of both, degrees and metres."""


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
    yaw_deg = 0.0
    looks = (COARSE_PX, reach_deg, COARSE_DEG), (FINE_PX, FINE_REACH_DEG, FINE_DEG)
    for blur_px, reach, step_deg in looks:
        count = round(reach / step_deg)
        yaws_deg = yaw_deg + step_deg * np.linspace(-count, count, 2 * count + 1)
        scores = Scores(views, [np.asarray(cv2.GaussianBlur(x, (0, 0), blur_px), np.float32) for x in strong], start)
        found = scores(yaws_deg, np.zeros(1), OUT_PX)[:, :, 0]
        within = found.sum(axis=0)[:, 1:-1]
        row, column = np.unravel_index(int(np.argmax(within)), within.shape)
        if not 0 < row < len(yaws_deg) - 1:
            return None
        yaw_deg = float(yaws_deg[row])
    unit = _unit(found[:, row - 1 : row + 2, column + 1])
    count = round(AROUND_DEG / FINE_DEG)
    return _weigh(
        scores, yaw_deg + FINE_DEG * np.linspace(-count, count, 2 * count + 1), OUT_PX[column : column + 3], unit
    )


@dataclass(frozen=True)
class Scores:
    """How well outlines lie on edges."""

    views: Sequence[EdgeView]
    edges: Sequence[FloatMap]
    """Of each view, blurred (height, width)."""
    start: Correction

    def __call__(self, yaws_deg: Floats, asides_m: Floats, out_px: Floats) -> Floats:
        """Return the scores (frames, yaws, asides, distances out); yaws and asides are beside the start's."""
        (pitch, yaw, roll), (right, down, forward) = self.start.turn_deg, self.start.moved_m
        placed = [
            replace(self.start, turn_deg=(pitch, yaw + more, roll), moved_m=(right + aside, down, forward))
            for more in yaws_deg.tolist()
            for aside in asides_m.tolist()
        ]
        found = [view.strengths(placed, out_px, edges) for view, edges in zip(self.views, self.edges, strict=True)]
        return np.array(found).reshape(len(found), len(yaws_deg), len(asides_m), len(out_px))


def _unit(scores: Floats) -> float:
    """Return how much of a score is one nat, by those of the frames (frames, 3) at a peak and a step on either side.

    Strengths are no likelihood. They count as one whose spread from frame to frame is what its curvature says (a
    quasi-likelihood, Wedderburn 1974).
    """
    slopes = (scores[:, 2] - scores[:, 0]) / 2
    bend = float((2 * scores[:, 1] - scores[:, 0] - scores[:, 2]).sum())
    spread = float(np.var(slopes, ddof=1)) * len(slopes) if len(slopes) > 1 else 0.0
    return float(np.clip(spread / max(bend, 1e-9), LEAST_UNIT, MOST_UNIT))


def _weigh(scores: Scores, yaws_deg: Floats, out_px: Floats, unit: float) -> Yaw:
    """Return the mean and the covariance of yaw and place, weighed by how likely they are beside the prior (PLACE_M).

    Args:
        scores: of any.
        yaws_deg: beside the start's.
        out_px: distances out, which are weighed too.
        unit: see _unit.
    """
    nats = scores(yaws_deg, ASIDES_M, out_px).sum(axis=0) / unit - ((ASIDES_M / PLACE_M) ** 2 / 2)[:, None]
    weights = np.exp(nats - nats.max()).sum(axis=2)
    weights /= weights.sum()
    places = np.stack(np.meshgrid(yaws_deg, ASIDES_M, indexing="ij"), axis=-1)
    mean = np.einsum("ya,yan->n", weights, places)
    apart = places - mean
    covariance = np.einsum("ya,yan,yam->nm", weights, apart, apart) + np.diag([FINE_DEG**2, ASIDES_STEP_M**2]) / 12
    along = np.array([covariance[0, 1] / covariance[1, 1], 1.0])  # yaw goes with the place
    covariance += ASIDE_M**2 * np.outer(along, along)
    start = scores.start
    return Yaw(start.turn_deg[1] + float(mean[0]), start.moved_m[0] + float(mean[1]), covariance)
