"""Varies a training pair each time it is used; its truth stays exact.

What changes where things are - crop, zoom, stretch - is done to both views alike and scales the disparity. The right
view may sit a fraction of a pixel too high or be rolled, but is never moved along its rows: what is matched across the
rows then still has its true disparity. What changes how things look is learn/looks.py.
"""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from priors import geometry
from priors.learn import looks
from priors.learn.pair import Pair
from priors.types import Image

SURFACE_PX = 1.0
"""Disparities of neighbours that differ by more are not mixed when a map is resized."""


@dataclass(frozen=True)
class Variation:
    """How far pairs are varied."""

    zoom: float = 0.22
    """Spread of the zoom's logarithm."""
    stretch: float = 0.1
    """Spread of the logarithm of width against height."""
    largest_zoom: float = 1.8
    """Beyond it images are blurred, only."""
    smallest_zoom: float = 0.6
    misaligned: float = 0.5
    """Probability that the right view is off by a fraction of a row."""
    rows_px: float = 0.35
    """Spread of how much it is off, rows."""
    roll_rad: float = 0.0012
    """Spread of its roll."""
    covered: float = 0.25
    """Probability of a patch that hides part of the right view."""
    look: looks.Range = field(default_factory=looks.Range)


USUAL = Variation()


def vary(pair: Pair, rng: np.random.Generator, size: tuple[int, int], variation: Variation = USUAL) -> Pair:
    """Return the pair as another camera, another day and a worse calibration would have it, cropped to size."""
    pair = cut(pair, rng, size, variation)
    left, right = looks.change(pair.left, pair.right, rng, variation.look)
    if rng.random() < variation.misaligned:
        right = misalign(right, rng.normal(0, variation.rows_px), rng.normal(0, variation.roll_rad))
    if rng.random() < variation.covered:
        right = cover(left, right, rng)
    return replace(pair, left=left, right=right)


def cut(pair: Pair, rng: np.random.Generator, size: tuple[int, int], variation: Variation) -> Pair:
    """Cut a random window out of both views and resize it to size."""
    available = pair.disparity_px.shape
    zoom = np.exp(rng.normal(0, variation.zoom))
    stretch = np.exp(rng.normal(0, variation.stretch))
    zooms = np.clip([zoom, zoom * stretch], variation.smallest_zoom, variation.largest_zoom)
    height, width = (min(available[i], max(8, round(size[i] / zooms[i]))) for i in (0, 1))
    top, left = rng.integers(available[0] - height + 1), rng.integers(available[1] - width + 1)
    return resize(pair, int(top), int(left), (height, width), size)


def resize(pair: Pair, top: int, left: int, window: tuple[int, int], size: tuple[int, int]) -> Pair:
    """Cut a window (height, width) out of both views and resize it; disparities follow the width."""
    from priors.kernels import pairs as kernels

    flags = pair.known.astype(np.uint8) | (pair.sky.astype(np.uint8) << 1)
    at = top, left, window, size
    disparity_px, flags_there = kernels.resize(pair.disparity_px, flags, *at, SURFACE_PX)
    weight, _ = kernels.resize(pair.weight, flags, *at, 0.0)
    disparity_px *= np.float32(size[1] / window[1])
    views = [_resize(image[top : top + window[0], left : left + window[1]], size) for image in (pair.left, pair.right)]
    known = (flags_there & 1).astype(np.bool_)
    return replace(
        pair,
        left=views[0],
        right=views[1],
        disparity_px=np.where(known, disparity_px, np.float32(0)),
        known=known,
        sky=(flags_there & 2).astype(np.bool_),
        weight=weight,
        camera=None if pair.camera is None else geometry.resize(geometry.crop(pair.camera, top, left, window), size),
        # depth = fx * baseline / disparity still holds: fx and disparity scale alike
    )


def _resize(image: Image, size: tuple[int, int]) -> Image:
    smaller = image.shape[0] > size[0] and image.shape[1] > size[1]
    how = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, size[::-1], interpolation=how), np.uint8)


def misalign(right: Image, rows_px: float, roll_rad: float) -> Image:
    """Show the right view as if it sat rows_px too low and were rolled; nothing moves along the rows."""
    width = right.shape[1]
    matrix = np.array([[1, 0, 0], [roll_rad, 1, rows_px - roll_rad * (width - 1) / 2]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    out = cv2.warpAffine(right, matrix, (width, right.shape[0]), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(out, np.uint8)


def cover(left: Image, right: Image, rng: np.random.Generator) -> Image:
    """Hide part of the right view behind its mean colour, or behind a patch from elsewhere in the left view."""
    size = np.array(right.shape[:2])
    height, width = (max(1, int(side * share)) for side, share in zip(size, rng.uniform(0.05, 0.35, 2), strict=True))
    y, x = (int(rng.integers(size[i] - (height, width)[i] + 1)) for i in (0, 1))
    right = right.copy()
    if rng.random() < 0.5:
        right[y : y + height, x : x + width] = right.mean(axis=(0, 1)).astype(np.uint8)
    else:
        y2, x2 = (int(rng.integers(size[i] - (height, width)[i] + 1)) for i in (0, 1))
        right[y : y + height, x : x + width] = left[y2 : y2 + height, x2 : x2 + width]
    return right
