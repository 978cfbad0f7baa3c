"""Stereo by hand-made rules: semi-global matching, edge-aware smoothing and filling, and the error to expect.

Where that error is large, a small fitted rule chooses among the surfaces around (nets/surface_choice.py).
"""

import json
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from priors.codecs import as_grey
from priors.nets.surface_choice import Maps, SurfaceChoice
from priors.pairs.matching import match
from priors.pairs.smoothing import diffuse
from priors.types import FloatMap, Image, Mask

TOLERANCE_M = 1.0
ERROR_PX, ERROR_UNMATCHED_PX, ERROR_PER_ROUGHNESS, ERROR_PER_SLOPE = 0.37, 2.5, 0.3, 0.8
ROUGHNESS_WINDOW_PX = 7
STEEP = 3.0  # px per px: what is steeper is an edge
SURE_PX = 1.5  # the choice among surfaces goes by the probability of an error within that
CHOICE = Path(__file__).parents[1] / "weights" / "classical.json"


def estimate(left: Image, right: Image, max_disparity_px: int, sky: Mask | None = None) -> tuple[FloatMap, FloatMap]:
    """Return the left view's disparity (height, width), 0 = none, and the mean error to expect of it, px.

    Args:
        left: (height, width) or (height, width, 3) uint8.
        right: the same.
        max_disparity_px: how far to search.
        sky: (height, width), True where no other surface is chosen; None: nowhere.
    """
    maps = smooth(left, right, max_disparity_px)
    if not maps[0].any():  # nothing was matched: there is nothing to choose from
        return maps[:2]
    return load_choice()(maps, left, sky), maps[1]


def smooth(left: Image, right: Image, max_disparity_px: int | None = None) -> Maps:
    """Match, smooth and fill: disparity, the error to expect, px, the evidence, and the chance of 1.5 px."""
    matched_px = match(left, right, max_disparity_px)
    disparity_px, evidence = diffuse(matched_px, as_grey(left))
    error_px = expected_error(matched_px, disparity_px, evidence)
    return disparity_px, error_px, evidence, np.asarray(-np.expm1(-np.float32(SURE_PX) / error_px), np.float32)


@cache
def load_choice() -> SurfaceChoice:
    """Load the rule that chooses among surfaces."""
    choice = SurfaceChoice.read(json.loads(CHOICE.read_text(encoding="utf-8")))
    if choice is None:
        raise ValueError(f"{CHOICE}: no rule: python -m priors.learn.fit_classical")
    return choice


def expected_error(matched_px: FloatMap, disparity_px: FloatMap, evidence: FloatMap) -> FloatMap:
    """Return the mean absolute error to expect of a disparity (height, width), px.

    It grows where little was matched, where matches scatter about the smoothed surface, and at steps: a linear fit to
    errors on grey KITTI odometry pairs and the procedural street, see docs/methods/stereo.md.
    """
    window = (ROUGHNESS_WINDOW_PX, ROUGHNESS_WINDOW_PX)
    matched = (matched_px > 0).astype(np.float32)
    scatter = cv2.blur(np.abs(matched_px - disparity_px) * matched, window)
    roughness = scatter / np.maximum(cv2.blur(matched, window), np.float32(0.02))
    slope = np.abs(cv2.Sobel(disparity_px, cv2.CV_32F, 1, 0, scale=1 / 8))
    error_px = np.float32(ERROR_PX + ERROR_UNMATCHED_PX) - np.float32(ERROR_UNMATCHED_PX) * evidence
    error_px += np.float32(ERROR_PER_ROUGHNESS) * np.minimum(roughness, np.float32(STEEP))
    error_px += np.float32(ERROR_PER_SLOPE) * np.minimum(slope, np.float32(STEEP))
    return error_px


def probability(disparity_px: FloatMap, error_px: FloatMap, fx_baseline: float) -> FloatMap:
    """Return the probability in [0, 1] that the depth is within 1 m, for Laplace-distributed errors of this mean."""
    allowed_px = np.square(disparity_px) * np.float32(TOLERANCE_M / fx_baseline)
    return np.asarray(-np.expm1(-allowed_px / error_px), dtype=np.float32)
