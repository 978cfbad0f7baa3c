"""How far a pair's rectification is off, measured against the LiDAR: a few numbers a drive, not a map."""

import numpy as np
import numpy.typing as npt

from priors.geometry import convert_disparity, project, scatter_nearest, transform
from priors.sweep import untwist
from priors.types import FloatMap, Frame

Offset = tuple[float, float, float]
NONE: Offset = (0.0, 0.0, 0.0)
FEWEST = 500  # LiDAR points with a match: fewer say nothing about a curve
LARGEST_PX = 4.0  # differences above are mismatches, not rectification
SCALE_PX = 0.3  # differences well above count little
ROUNDS = 20
PRIOR_PX = 1.0  # the slope and the curve are of that order, unless the points say otherwise
NOISE_PX = 5.0  # of one point, for the prior: neighbouring points share their errors


def measure_offset(frame: Frame, max_disparity_px: int | None = None) -> Offset:
    """Measure a, b, c of the disparity that is missing, a + b X + c X^2 px with X = (column - cx) / fx.

    A pair whose relative yaw is off by w shifts by fx w (1 + X^2); the principal point takes some of the constant.
    Compared are the frame's own sweep and its pair. Returns zeros where either is missing, or too few points match.
    """
    if frame.T_cam_lidar is None or frame.baseline_m is None or not (frame.has("sweep") and frame.has("other")):
        return NONE
    sweep = frame.sweep(0)
    if sweep is None:
        return NONE
    uv_px, depth_m = project(frame.camera, transform(frame.T_cam_lidar, untwist(sweep)))
    lidar_px = convert_disparity(scatter_nearest(uv_px, depth_m, frame.camera.size), frame.camera.fx, frame.baseline_m)
    return fit_offset(frame, lidar_px, _matched(frame, max_disparity_px))


def _matched(frame: Frame, max_disparity_px: int | None) -> FloatMap:
    from priors.matching import match
    from priors.methods.stereo import read_pair, unmirror

    return unmirror(frame, match(*read_pair(frame), max_disparity_px))


def fit_offset(frame: Frame, true_px: FloatMap, matched_px: FloatMap) -> Offset:
    """Fit the curve to two disparity maps (height, width), 0 = none, by reweighted least squares (Cauchy)."""
    both = (true_px > 0) & (matched_px > 0)
    missing_px = (true_px[both] - matched_px[both]).astype(np.float64)
    X = (np.nonzero(both)[1] - frame.camera.K[0, 2]) / frame.camera.fx
    near = np.abs(missing_px) < LARGEST_PX
    missing_px, X = missing_px[near], X[near]
    if missing_px.size < FEWEST:
        return NONE
    A = np.stack([np.ones_like(X), X, X * X], axis=1)
    a, b, c = (round(float(value), 3) for value in _solve_robustly(A, missing_px))
    return a, b, c


def _solve_robustly(A: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    prior = np.diag([0.0, 1.0, 1.0]) * (NOISE_PX / PRIOR_PX) ** 2
    solution = np.array([np.median(y), 0.0, 0.0])
    for _ in range(ROUNDS):
        weight = 1 / (1 + np.square((y - A @ solution) / SCALE_PX))
        weighted = A * weight[:, None]
        solution = np.linalg.solve(A.T @ weighted + prior, weighted.T @ y)
    return solution
