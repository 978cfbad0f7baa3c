"""Rectification error of a stereo pair: how far its disparities are off. A few numbers a drive, not a map.

They are fitted to the residuals of a match against the LiDAR: true disparity minus matched disparity, pixel by pixel.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import as_grey
from priors.geometry import convert_disparity, project, scatter_nearest, transform, untwist
from priors.pairs.smoothing import diffuse
from priors.types import Camera, FloatMap, Image, Matrix, Rig, Sweep

Floats = npt.NDArray[np.float64]

FEWEST_POINTS = 500  # LiDAR points with a match: fewer say nothing about a curve
MISMATCH_PX = 4.0  # residuals above are mismatches, not rectification
RESIDUAL_PX = 0.3  # scale of Cauchy's weights: residuals well above count little
FIT_ROUNDS = 20
NOISE_PX = 2.0  # of one residual beside the expected spread: neighbouring points share their errors
STEEPEST = 0.6  # px per row: what is steeper is an edge, not a road


@dataclass(frozen=True)
class RectificationError:
    """What turns matched disparities into those that the calibration promises.

    corrected = scale * matched + shift + tilt X + yaw X^2 + pitch X Y px, X = (column - cx) / fx, Y = (row - cy) / fy.

    A pair whose relative yaw is off by w shifts by fx w (1 + X^2), one whose pitch is, by fx w X Y. Errors of principal
    points and focal lengths make shift and tilt. A baseline that is longer than its calibration says makes disparities
    too large.
    """

    shift_px: float = 0.0
    tilt_px: float = 0.0
    yaw_px: float = 0.0
    pitch_px: float = 0.0
    scale: float = 1.0
    """Calibrated over true baseline."""

    @property
    def offset_px(self) -> tuple[float, float, float, float]:
        """Return shift, tilt, yaw and pitch, px: what Stereo.offset_px holds."""
        return self.shift_px, self.tilt_px, self.yaw_px, self.pitch_px

    def correct(self, disparity_px: FloatMap, camera: Camera) -> FloatMap:
        """Return corrected disparities (height, width), px."""
        height, width = camera.size
        X = (np.arange(width) - camera.K[0, 2]) / camera.fx
        Y = (np.arange(height) - camera.K[1, 2]) / camera.K[1, 1]
        row_px = (self.shift_px + self.tilt_px * X + self.yaw_px * X * X).astype(np.float32)
        column_px = (self.pitch_px * Y).astype(np.float32)[:, None]
        corrected: FloatMap = np.float32(self.scale) * disparity_px
        corrected += column_px * X.astype(np.float32)
        corrected += row_px
        return corrected

    def mirrored(self) -> Self:
        """Return the same for the horizontally mirrored image."""
        return replace(self, tilt_px=-self.tilt_px, pitch_px=-self.pitch_px)


NONE = RectificationError()


class Terms(NamedTuple):
    """The unknowns of the fit, in the order of its columns."""

    shift_px: float
    tilt_px: float
    yaw_px: float
    pitch_px: float
    stretch: float
    """The scale, less 1."""
    rows: float
    """How far the true map is registered too high or low. It is fitted beside the error and left out."""


EXPECTED_SPREAD = Terms(shift_px=np.inf, tilt_px=1.0, yaw_px=2.0, pitch_px=1.0, stretch=0.02, rows=0.3)
"""How far each term is expected to lie from the usual one (standard deviation), unless many residuals say otherwise."""


class Residuals(NamedTuple):
    """Where a true and a matched disparity differ, at n pixels."""

    factors: Floats
    """(n, 6): what each of Terms multiplies."""
    residual_px: Floats
    """(n,): true - matched."""


def usual_error(rig: Rig | None, camera: Camera) -> RectificationError:
    """Return the usual error of a rig's rectification in a camera's pixels; none where the rig is not known."""
    if rig is None:
        return NONE
    errors_px = rig.shift_px, rig.tilt_px, rig.yaw_px, rig.pitch_px
    shift, tilt, yaw, pitch = (round(value * camera.fx / rig.focal_px, 3) for value in errors_px)
    return RectificationError(shift, tilt, yaw, pitch, rig.scale)


def compare_with_sweep(
    matched_px: FloatMap, image: Image, camera: Camera, baseline_m: float, sweep: Sweep, T_cam_lidar: Matrix
) -> Residuals:
    """Return the residuals of a left camera's match (height, width), px, 0 = none, against a LiDAR sweep."""
    uv_px, depth_m = project(camera, transform(T_cam_lidar, untwist(sweep)))
    lidar_px = convert_disparity(scatter_nearest(uv_px, depth_m, camera.size), camera.fx, baseline_m)
    smooth_px, _ = diffuse(matched_px, as_grey(image))
    return compare(camera, lidar_px, matched_px, row_slope(smooth_px))


def row_slope(smooth_px: FloatMap) -> FloatMap:
    """Return a smooth disparity's step from row to row (height, width), px."""
    return np.asarray(cv2.Sobel(smooth_px, cv2.CV_32F, 0, 1, ksize=5, scale=1 / 128), dtype=np.float32)


def compare(camera: Camera, true_px: FloatMap, matched_px: FloatMap, slope_px: FloatMap) -> Residuals:
    """Return the residuals of the pixels where two disparities (height, width), px, 0 = none, both have values.

    Where the true map is registered some rows too high or low, the disparity of slanted surfaces seems off by the rows
    times its slope (height, width), px a row.
    """
    both = (true_px > 0) & (matched_px > 0) & (np.abs(true_px - matched_px) < MISMATCH_PX)
    row, column = np.nonzero(both)
    X, Y = (column - camera.K[0, 2]) / camera.fx, (row - camera.K[1, 2]) / camera.K[1, 1]
    slope = np.clip(slope_px[both], -STEEPEST, STEEPEST)
    factors = np.stack([np.ones_like(X), X, X * X, X * Y, matched_px[both], slope], axis=1)
    return Residuals(factors, (true_px[both] - matched_px[both]).astype(np.float64))


def join(parts: list[Residuals]) -> Residuals:
    """Put the residuals of frames together."""
    return Residuals(np.concatenate([part.factors for part in parts]), np.concatenate([p.residual_px for p in parts]))


def fit(residuals: Residuals, usual: RectificationError = NONE) -> RectificationError:
    """Fit the error by reweighted least squares (Cauchy's weights); returns the usual one where residuals are few."""
    if len(residuals.residual_px) < FEWEST_POINTS:
        return usual
    start = np.array([*usual.offset_px, usual.scale - 1, 0])
    change = _solve_robustly(residuals.factors, residuals.residual_px - residuals.factors @ start)
    terms = Terms(*(start + change).tolist())
    shift, tilt, yaw, pitch = (round(value, 3) for value in terms[:4])
    return RectificationError(shift, tilt, yaw, pitch, round(1 + terms.stretch, 4))


def _solve_robustly(factors: Floats, residual_px: Floats) -> Floats:
    """Return the terms (6,) of the least weighted squares; the expected spread holds what few residuals tell."""
    ridge = np.diag((NOISE_PX / np.array(EXPECTED_SPREAD)) ** 2)
    terms = np.array([np.median(residual_px), *[0.0] * (factors.shape[1] - 1)])
    for _ in range(FIT_ROUNDS):
        weight = 1 / (1 + np.square((residual_px - factors @ terms) / RESIDUAL_PX))
        weighted = factors * weight[:, None]
        terms = np.linalg.solve(factors.T @ weighted + ridge, weighted.T @ residual_px)
    return terms
