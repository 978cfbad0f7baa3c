"""How far a pair's disparities are off, measured against the LiDAR: a few numbers a drive, not a map."""

from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np
import numpy.typing as npt

from priors.geometry import convert_disparity, project, scatter_nearest, transform, untwist
from priors.pairs.matching import to_grey
from priors.pairs.smoothing import diffuse
from priors.types import Camera, FloatMap, Image, Matrix, Rig, Sweep

Points = npt.NDArray[np.float64]

FEWEST = 500  # LiDAR points with a match: fewer say nothing about a curve
LARGEST_PX = 4.0  # differences above are mismatches, not rectification
SCALE_PX = 0.3  # differences well above count little
ROUNDS = 20
PRIOR = (np.inf, 1.0, 2.0, 1.0, 0.02, 0.3)
"""What a, b, c, e (px), the scale and the sweep's registration (rows) may differ from the usual, unless points say
so."""
NOISE_PX = 2.0  # of one point, for the prior: neighbouring points share their errors
STEEPEST = 0.6  # px per row: what is steeper is an edge, not a road


@dataclass(frozen=True)
class Offset:
    """What turns matched disparities into those that the calibration promises: scale * d + a + b X + c X^2 + e X Y px.

    X = (column - cx) / fx, Y = (row - cy) / fy. A pair whose relative yaw is off by w shifts by fx w (1 + X^2), one
    whose pitch is, by fx w X Y; principal points and focal lengths make a and b, and a baseline that is longer than its
    calibration says makes disparities too large.
    """

    field_px: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """a, b, c, e."""
    scale: float = 1.0
    """Calibrated over true baseline."""

    def correct(self, disparity_px: FloatMap, camera: Camera) -> FloatMap:
        """Return corrected disparities (height, width), px."""
        height, width = camera.size
        X = (np.arange(width) - camera.K[0, 2]) / camera.fx
        Y = (np.arange(height) - camera.K[1, 2]) / camera.K[1, 1]
        a, b, c, e = self.field_px
        row, column = (a + b * X + c * X * X).astype(np.float32), (e * Y).astype(np.float32)[:, None]
        corrected: FloatMap = np.float32(self.scale) * disparity_px
        corrected += column * X.astype(np.float32)
        corrected += row
        return corrected

    def mirrored(self) -> Self:
        """Return the same for the horizontally mirrored image."""
        a, b, c, e = self.field_px
        return replace(self, field_px=(a, -b, c, -e))


NONE = Offset()


def usual_offset(rig: Rig | None, camera: Camera) -> Offset:
    """Return the usual error of a rig's rectification in a camera's pixels; none where the rig is not known."""
    if rig is None:
        return NONE
    errors_px = rig.shift_px, rig.tilt_px, rig.yaw_px, rig.pitch_px
    a, b, c, e = (round(value * camera.fx / rig.focal_px, 3) for value in errors_px)
    return Offset((a, b, c, e), rig.scale)


def compare(
    matched_px: FloatMap, image: Image, camera: Camera, baseline_m: float, sweep: Sweep, T_cam_lidar: Matrix
) -> Points:
    """Gather where a left camera's match (height, width), px, 0 = none, and a sweep differ; see `gather`."""
    uv_px, depth_m = project(camera, transform(T_cam_lidar, untwist(sweep)))
    lidar_px = convert_disparity(scatter_nearest(uv_px, depth_m, camera.size), camera.fx, baseline_m)
    smooth_px, _ = diffuse(matched_px, to_grey(image))
    return gather(camera, lidar_px, matched_px, slope(smooth_px))


def slope(smooth_px: FloatMap) -> FloatMap:
    """Return a smooth disparity's step from row to row (height, width), px."""
    return np.asarray(cv2.Sobel(smooth_px, cv2.CV_32F, 0, 1, ksize=5, scale=1 / 128), dtype=np.float32)


def gather(camera: Camera, true_px: FloatMap, matched_px: FloatMap, slope_px: FloatMap) -> Points:
    """Return (n, 7) of the pixels where two disparities (height, width), px, 0 = none, both have values.

    The columns: what a, b, c, e, the scale and the rows multiply, and true - matched.

    Where the true map is registered some rows too high or low, the disparity of slanted surfaces seems off by the rows
    times its slope: that is fitted beside and left out.
    """
    both = (true_px > 0) & (matched_px > 0) & (np.abs(true_px - matched_px) < LARGEST_PX)
    row, column = np.nonzero(both)
    X, Y = (column - camera.K[0, 2]) / camera.fx, (row - camera.K[1, 2]) / camera.K[1, 1]
    slanted = np.clip(slope_px[both], -STEEPEST, STEEPEST)
    missing_px = true_px[both] - matched_px[both]
    return np.stack([np.ones_like(X), X, X * X, X * Y, matched_px[both], slanted, missing_px], axis=1)


def fit_points(points: Points, usual: Offset = NONE) -> Offset:
    """Fit the offset to what `gather` returns, by reweighted least squares (Cauchy); the usual one if they are few."""
    if len(points) < FEWEST:
        return usual
    known = np.array([*usual.field_px, usual.scale - 1, 0])
    A, missing_px = points[:, :-1], points[:, -1]
    a, b, c, e, stretch, _ = (known + _solve_robustly(A, missing_px - A @ known)).tolist()
    return Offset((round(a, 3), round(b, 3), round(c, 3), round(e, 3)), round(1 + stretch, 4))


def _solve_robustly(A: Points, y: Points) -> Points:
    prior = np.diag((NOISE_PX / np.array(PRIOR)) ** 2)
    solution = np.array([np.median(y), *[0.0] * (A.shape[1] - 1)])
    for _ in range(ROUNDS):
        weight = 1 / (1 + np.square((y - A @ solution) / SCALE_PX))
        weighted = A * weight[:, None]
        solution = np.linalg.solve(A.T @ weighted + prior, weighted.T @ y)
    return solution
