"""The slow obvious versions of priors.geometry."""

import math

import numpy as np


def scatter_nearest(uv_px: np.ndarray, depth_m: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """One point at a time."""
    height, width = size
    out = np.zeros(size, np.float32)
    for (u, v), z in zip(uv_px.tolist(), depth_m.tolist(), strict=True):
        with np.errstate(over="ignore"):
            value = np.float32(z)
        if not (math.isfinite(value) and value > 0 and math.isfinite(u) and math.isfinite(v)):
            continue
        column, row = round(u), round(v)
        inside = -0.5 < u < width - 0.5 and -0.5 < v < height - 0.5
        if inside and (out[row, column] == 0 or value < out[row, column]):
            out[row, column] = value
    return out


def project(K: np.ndarray, point: tuple[float, float, float]) -> tuple[float, float]:
    """One point, by the matrix."""
    x, y, w = K @ np.array(point)
    return x / w, y / w
