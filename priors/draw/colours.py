"""Colours of depth, error and confidence: maps on fixed scales, so that rows and frames compare.

All pictures are uint8 RGB (height, width, 3). Black is "no value" everywhere.
"""

from collections.abc import Sequence
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from priors.types import FloatMap, Image, Mask

Colour: TypeAlias = tuple[int, int, int]
ColourTable: TypeAlias = npt.NDArray[np.uint8]

SCALE_NEAREST_M, SCALE_FARTHEST_M = 3.0, 80.0
ERROR_STEPS = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32)
"""Edges of the error map's colours, |p - t| / t: each step doubles the error."""
MISSING: Colour = (74, 72, 76)
"""Error map: there is a truth, but the method has no value."""


def _table(code: int, first: int = 0, last: int = 255) -> ColourTable:
    """Return one of OpenCV's colour maps, its part first..last, as (256, 3) RGB."""
    ramp = np.rint(np.linspace(first, last, 256)).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(ramp[:, None], code)[:, 0, ::-1], dtype=np.uint8)


def _blend(colours: Sequence[Colour], steps: int) -> ColourTable:
    """Interpolate between colours: (steps, 3) RGB."""
    at = np.linspace(0, len(colours) - 1, steps)
    anchors = np.array(colours, dtype=np.float64)
    channels = [np.interp(at, np.arange(len(colours)), anchors[:, i]) for i in range(3)]
    return np.rint(np.stack(channels, axis=1)).astype(np.uint8)


# Turbo without its darkest violet, which would pass for black: far is blue, near is red.
DEPTH_COLOURS = _table(cv2.COLORMAP_TURBO, 18, 245)
CONFIDENCE_COLOURS = _table(cv2.COLORMAP_VIRIDIS, 10, 255)
GOOD_TO_BAD = _blend([(24, 60, 150), (70, 150, 215), (240, 240, 225), (240, 130, 60), (165, 10, 40)], 8)


def colour_depth(depth_m: FloatMap, nearest_m: float = SCALE_NEAREST_M, farthest_m: float = SCALE_FARTHEST_M) -> Image:
    """Colour a depth map (height, width) on a logarithmic scale; what lies outside takes the end's colour."""
    valid = depth_m > 0
    shown_m = np.clip(np.where(valid, depth_m, nearest_m), nearest_m, farthest_m)
    logs = np.log(shown_m / nearest_m) / np.log(farthest_m / nearest_m)
    return _paint(DEPTH_COLOURS, 1 - logs, valid)


def colour_confidence(confidence: FloatMap, valid: Mask) -> Image:
    """Colour a confidence map (height, width) in [0, 1]: dark is low."""
    return _paint(CONFIDENCE_COLOURS, np.nan_to_num(confidence), valid)


def colour_error(prediction_m: FloatMap, truth_m: FloatMap) -> Image:
    """Colour |p - t| / t in steps that double: blue is good, red is bad, grey has a truth but no prediction."""
    true = truth_m > 0
    both = true & (prediction_m > 0) & np.isfinite(truth_m)
    truth = np.where(both, truth_m, 1).astype(np.float64)
    error = np.abs(np.where(both, prediction_m, 1) / truth - 1)
    picture = np.where(both[..., None], GOOD_TO_BAD[np.digitize(error, ERROR_STEPS)], np.uint8(0))
    picture[true & ~(prediction_m > 0)] = MISSING
    return picture


def _paint(table: ColourTable, shares: npt.NDArray[np.floating], valid: Mask) -> Image:
    """Look shares of [0, 1] up in a table of colours."""
    last = len(table) - 1
    picture = table[np.rint(np.clip(shares, 0, 1) * last).astype(np.intp)]
    picture[~valid] = 0
    return picture


def thicken(picture: Image, radius_px: float = 1.5) -> Image:
    """Let the colours of a sparse picture grow into the black around them, so that they are seen."""
    drawn = picture.any(axis=2)
    if not drawn.any():
        return picture
    distance_px, labels = cv2.distanceTransformWithLabels(
        np.where(drawn, np.uint8(0), np.uint8(1)), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    colours = np.zeros((int(labels.max()) + 1, 3), np.uint8)  # a label is one drawn pixel
    colours[labels[drawn]] = picture[drawn]
    return np.where((distance_px <= radius_px)[..., None], colours[labels], picture)
