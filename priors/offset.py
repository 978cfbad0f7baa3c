"""How far a pair's rectification is off, measured against the LiDAR: a few numbers a drive, not a map."""

import cv2
import numpy as np
import numpy.typing as npt

from priors.diffusion import diffuse
from priors.geometry import convert_disparity, project, scatter_nearest, transform
from priors.matching import match, to_grey
from priors.sweep import untwist
from priors.types import Camera, FloatMap, Image, Matrix, Sweep

Offset = tuple[float, float, float]
NONE: Offset = (0.0, 0.0, 0.0)
FEWEST = 500  # LiDAR points with a match: fewer say nothing about a curve
LARGEST_PX = 4.0  # differences above are mismatches, not rectification
SCALE_PX = 0.3  # differences well above count little
ROUNDS = 20
PRIOR_PX = 1.0  # slope, curve and misregistration are of that order, unless the points say otherwise
NOISE_PX = 5.0  # of one point, for the prior: neighbouring points share their errors
STEEPEST = 0.6  # px per row: what is steeper is an edge, not a road


def measure_offset(
    image: Image,
    other: Image,
    camera: Camera,
    baseline_m: float,
    sweep: Sweep,
    T_cam_lidar: Matrix,
    max_disparity_px: int | None = None,
) -> Offset:
    """Measure the disparity that a left camera's pair lacks: a + b X + c X^2 px with X = (column - cx) / fx.

    A pair whose relative yaw is off by w shifts by fx w (1 + X^2); the principal point takes some of the constant.
    Where the sweep is registered some rows too high or low, the disparity of slanted surfaces seems off by the rows
    times its slope: that is fitted beside and left out. Returns zeros where too few points meet a match.
    """
    uv_px, depth_m = project(camera, transform(T_cam_lidar, untwist(sweep)))
    lidar_px = convert_disparity(scatter_nearest(uv_px, depth_m, camera.size), camera.fx, baseline_m)
    matched_px = match(image, other, max_disparity_px)
    smooth_px, _ = diffuse(matched_px, to_grey(image))
    slope = np.asarray(cv2.Sobel(smooth_px, cv2.CV_32F, 0, 1, ksize=5, scale=1 / 128), dtype=np.float32)
    return fit_offset(camera, lidar_px, matched_px, slope)


def fit_offset(camera: Camera, true_px: FloatMap, matched_px: FloatMap, slope: FloatMap) -> Offset:
    """Fit the curve to two disparity maps (height, width), 0 = none, by reweighted least squares (Cauchy).

    slope: (height, width) px per row of the disparity, for the misregistration of the true one.
    """
    both = (true_px > 0) & (matched_px > 0) & (np.abs(true_px - matched_px) < LARGEST_PX)
    if np.count_nonzero(both) < FEWEST:
        return NONE
    X = (np.nonzero(both)[1] - camera.K[0, 2]) / camera.fx
    A = np.stack([np.ones_like(X), X, X * X, np.clip(slope[both], -STEEPEST, STEEPEST)], axis=1)
    solution = _solve_robustly(A, (true_px[both] - matched_px[both]).astype(np.float64))
    a, b, c = (round(float(value), 3) for value in solution[:3])
    return a, b, c


def _solve_robustly(A: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    prior = np.diag([0.0, 1.0, 1.0, 1.0]) * (NOISE_PX / PRIOR_PX) ** 2
    solution = np.array([np.median(y), 0.0, 0.0, 0.0])
    for _ in range(ROUNDS):
        weight = 1 / (1 + np.square((y - A @ solution) / SCALE_PX))
        weighted = A * weight[:, None]
        solution = np.linalg.solve(A.T @ weighted + prior, weighted.T @ y)
    return solution
