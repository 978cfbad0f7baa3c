"""Edges: the outlines of near surfaces in the sweeps lie on upright edges in the images.

Both sides of things count, and how far outlines stand out of them is fitted beside: a laser's spot is wide, so surfaces
look wider to it than to the camera. A turn moves outlines at all distances alike, a LiDAR that stands aside the near
ones more. One that stands ahead, or is late, moves them away from where the car goes. No pair is needed. Pitch and roll
are not told: lines are far apart upwards.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import as_grey
from priors.extrinsics.belief import UNKNOWNS, Told
from priors.extrinsics.correction import Correction
from priors.extrinsics.outlines import find_outlines
from priors.extrinsics.points import Points, crop, in_view
from priors.extrinsics.samples import weigh
from priors.types import Camera, FloatMap, Image, Matrix, Sweep

Floats = npt.NDArray[np.float64]

SMOOTH_PX, HALF_LEVELS = 0.8, 8.0
"""Blur before the gradient; the gradient, grey levels a pixel, that counts half as much as the strongest."""
COARSE_PX, FINE_PX = 4.0, 1.5
"""Blur of the edges, first and last."""
COARSE_DEG, FINE_DEG, FINE_REACH_DEG = 0.04, 0.02, 0.12
"""Steps in which yaw is looked for; how far on either side at last."""
COARSE_M, FINE_M, FINE_REACH_M = 0.1, 0.03, 0.09
"""The same of how far ahead the LiDAR is, or how far the car goes in its delay."""
OUT_PX = np.arange(-2.0, 2.1, 0.5)
"""How far outlines may stand out of the things in the image, px."""
SPREAD = np.array([0.06, 0.015, 0.05, 0.4])
"""Around the peak, where yaw (degrees), aside, ahead (metres) and out (px) are weighed at first."""
WIDEST_M = np.array([0.03, 0.3])
"""How far aside and ahead a LiDAR may be (standard deviations): so wide that edges alone tell."""
LEAST_UNIT, MOST_UNIT = 1.0, 20.0
"""Strength of how many outlines is one nat: those of a laser's neighbouring lines lie on one edge."""
YAW_PX, ASIDE_M, AHEAD_M = 0.25, 0.008, 0.015
"""Errors that more frames do not lower (standard deviations): of yaw, in pixels; of the place, metres. Half a pixel at
ten metres, by which the edges of near things look wider or narrower than those of far ones."""
SLOWEST_M_S = 1.0
"""A car that is slower shows no delay."""
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

    def pixels(self, by: Correction) -> Floats:
        """Return where outlines are seen (2, n): columns and rows."""
        x, y, z = self.points.placed(by).T
        K = self.camera.K
        return np.stack([K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]])

    def strengths(self, start: Correction, more: Floats, speed_m_s: float, edges: FloatMap) -> Floats:
        """Return the edges' strength (height, width), summed over the outlines, for each of several places.

        Args:
            start: from where on.
            more: (places, 4) yaw, degrees, aside and ahead, metres, beside the start's; out, px.
            speed_m_s: see Search.
            edges: how strong they are, blurred (height, width).
        """
        at = self.pixels(start)
        steps = [(self.pixels(by) - at) / size for by, size in _steps(start, speed_m_s)]
        u, v = (at[axis] + more[:, :3] @ np.stack([step[axis] for step in steps]) for axis in (0, 1))
        u -= more[:, 3:] * self.side
        found = cv2.remap(
            edges, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(found.sum(axis=1, dtype=np.float64))


def _steps(start: Correction, speed_m_s: float) -> list[tuple[Correction, float]]:
    """Return small steps in yaw, aside and ahead, and their sizes, degrees and metres."""
    (pitch, yaw, roll), (right, down, forward) = start.turn_deg, start.moved_m
    ahead = replace(start, moved_m=(right, down, forward + 0.01))
    if speed_m_s > 0:
        ahead = replace(start, delay_s=start.delay_s + 0.01 / speed_m_s)
    aside = replace(start, moved_m=(right + 0.01, down, forward))
    return [(replace(start, turn_deg=(pitch, yaw + 0.01, roll)), 0.01), (aside, 0.01), (ahead, 0.01)]


def upright_edges(grey: Image) -> FloatMap:
    """Return how strong upright edges are (height, width), in [0, 1]."""
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), SMOOTH_PX)
    levels = np.abs(cv2.Scharr(smooth, cv2.CV_32F, 1, 0)) / np.float32(32)
    return np.asarray(levels / (levels + np.float32(HALF_LEVELS)), dtype=np.float32)


def told_by_edges(views: Sequence[EdgeView], start: Correction, reach_deg: float, reach_m: float = 0.0) -> Told | None:
    """Find yaw, how far aside the LiDAR is, and how far ahead or late, at which outlines lie on the strongest edges.

    Args:
        views: of several frames.
        start: the correction around which they are looked for.
        reach_deg: how far on either side of its yaw.
        reach_m: how far the car may go in its delay.

    Returns:
        what edges tell; None where too few outlines, or no peak, are seen.
    """
    views = [view for view in views if len(view.points)]
    if sum(len(view.points) for view in views) < FEWEST:
        return None
    strong = [upright_edges(view.grey) for view in views]
    speed = float(np.mean([view.points.rate_m_s[:, 2].mean() for view in views]))
    speed = speed if speed > SLOWEST_M_S else 0.0
    yaw_deg = ahead_m = 0.0
    for blur_px, reach, step_deg, far_m, step_m in (
        (COARSE_PX, reach_deg, COARSE_DEG, reach_m, COARSE_M),
        (FINE_PX, FINE_REACH_DEG, FINE_DEG, FINE_REACH_M, FINE_M),
    ):
        edges = [np.asarray(cv2.GaussianBlur(x, (0, 0), blur_px), np.float32) for x in strong]
        search = Search(views, edges, start, speed)
        found = search.best(yaw_deg + _around(reach, step_deg), ahead_m + _around(far_m, step_m))
        if found is None:
            return None
        yaw_deg, ahead_m, out_px = found
    return search.weigh(yaw_deg, ahead_m, out_px)


def _around(reach: float, step: float) -> Floats:
    """Return 0 and steps on either side, as far as a reach."""
    count = round(reach / step)
    return step * np.linspace(-count, count, 2 * count + 1)


@dataclass(frozen=True)
class Search:
    """How well outlines lie on edges."""

    views: Sequence[EdgeView]
    edges: Sequence[FloatMap]
    """Of each view, blurred (height, width)."""
    start: Correction
    speed_m_s: float
    """How fast the car goes: "ahead" is how far it goes in the LiDAR's delay; 0: how far ahead the LiDAR stands."""

    def scores(self, more: Floats) -> Floats:
        """Return the scores (frames, places); see EdgeView.strengths."""
        seen = zip(self.views, self.edges, strict=True)
        return np.array([view.strengths(self.start, more, self.speed_m_s, edges) for view, edges in seen])

    def best(self, yaws_deg: Floats, aheads_m: Floats) -> tuple[float, float, float] | None:
        """Return yaw, ahead and out of the highest score; None where yaw is at the border."""
        grid = np.stack(np.meshgrid(yaws_deg, [0.0], aheads_m, OUT_PX[1:-1], indexing="ij"), axis=-1).reshape(-1, 4)
        yaw, _, ahead, out = grid[int(np.argmax(self.scores(grid).sum(axis=0)))].tolist()
        return (yaw, ahead, out) if yaws_deg[0] < yaw < yaws_deg[-1] else None

    def weigh(self, yaw_deg: float, ahead_m: float, out_px: float) -> Told:
        """Return what is told of yaw, aside and ahead, weighed around a peak by how likely it is."""
        peak = np.array([yaw_deg, 0.0, ahead_m, out_px])
        unit = _unit(self.scores(peak + np.outer([-FINE_DEG, 0, FINE_DEG], np.eye(4)[0])))

        def nats(more: Floats) -> Floats:
            found = self.scores(more).sum(axis=0) / unit
            return np.asarray(found - np.square(more[:, 1:3] / WIDEST_M).sum(axis=1) / 2)

        mean, covariance = weigh(nats, peak, SPREAD)
        return self.told(mean[:3], covariance[:3, :3])

    def told(self, more: Floats, covariance: Floats) -> Told:
        """Return what values (3,) beside the start's tell of the unknowns, with the errors that more frames leave."""
        factors = np.zeros((3, len(UNKNOWNS)))
        for row, name in enumerate(("yaw", "aside", "ahead")):
            factors[row, UNKNOWNS.index(name)] = 1
        factors[2, UNKNOWNS.index("delay")] = self.speed_m_s
        start = self.start
        first = np.array([start.turn_deg[1], start.moved_m[0], start.moved_m[2] + self.speed_m_s * start.delay_s])
        yaw_deg = float(np.degrees(YAW_PX / self.views[0].camera.fx))
        along = np.array([covariance[0, 1] / covariance[1, 1], 1.0, 0.0])  # yaw goes with the place
        floor = np.diag(np.square([yaw_deg, 0, AHEAD_M])) + ASIDE_M**2 * np.outer(along, along)
        return Told(factors, first + more, covariance + floor)


def _unit(scores: Floats) -> float:
    """Return how much of a score is one nat, by those of the frames (frames, 3) at a peak and a step on either side.

    Strengths are no likelihood. They count as one whose spread from frame to frame is what its curvature says (a
    quasi-likelihood, Wedderburn 1974).
    """
    slopes = (scores[:, 2] - scores[:, 0]) / 2
    bend = float((2 * scores[:, 1] - scores[:, 0] - scores[:, 2]).sum())
    spread = float(np.var(slopes, ddof=1)) * len(slopes) if len(slopes) > 1 else 0.0
    return float(np.clip(spread / max(bend, 1e-9), LEAST_UNIT, MOST_UNIT))
