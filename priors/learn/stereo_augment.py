"""Augmentation of a stereo pair for training; its disparities stay exact.

Geometric: crop, zoom and stretch are done to both views alike and scale the disparity. The right view may sit a
fraction of a pixel too high or be rolled, but is never moved along its rows: what is matched across the rows then still
has its true disparity. A patch may hide a part of the right view. Photometric: adapt/augment.py, by the ranges here.
"""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from priors import geometry
from priors.adapt.augment import Augmentation, Difference, PairAugmentation, augment_pair
from priors.adapt.distributions import Effect, LogNormal, LogUniform, Normal, Uniform
from priors.learn.stereo_pair import Sensors, StereoPair
from priors.types import Image

SURFACE_PX = 1.0
"""Disparities of neighbours that differ by more are not mixed when a map is resized."""
LEVEL = 1 / 255
GAIN, CHANNEL_GAIN, GAMMA, CONTRAST = 0.25, 0.06, 0.12, 0.12
"""Deviations of their logarithms."""
RENDERED_CONTRAST, RENDERED_BLACK = 1.3, -4 * LEVEL
"""Rendered streets have less contrast and paler blacks than KITTI's and CamVid's images: what makes up for it."""


def photometric(contrast: float = 1.0, black: float = 0.0) -> PairAugmentation:
    """Return the photometric ranges, of a median contrast and a mean of what is added to all levels."""

    def differing(share: float) -> Difference:
        shares = (LogNormal(1, share * deviation) for deviation in (GAIN, CHANNEL_GAIN, GAMMA, CONTRAST))
        return Difference(*shares)

    common = Augmentation(
        grey=0.35,
        saturation=LogNormal(np.exp(-0.1), 0.3),
        gain=LogNormal(1, GAIN),
        channel_gain=LogNormal(1, CHANNEL_GAIN),
        extreme=0.07,
        gamma=LogNormal(1, GAMMA),
        contrast=LogNormal(contrast, CONTRAST),
        pivot=0.25,  # the median of street images
        blur_px=Effect(0.25, Uniform(0.4, 1.3)),
        vignette=Effect(0.25, Uniform(0.1, 0.5)),
        noise=Effect(1, LogUniform(0.4 * LEVEL, 6 * LEVEL)),
        colour_noise=True,
        grain_px=Effect(0.3, Uniform(0.4, 0.8)),
        quality=Effect(0.3, Uniform(35, 96)),
    )
    return PairAugmentation(
        common,
        apart=differing(0.1),
        far_apart=differing(0.5),
        differing=0.25,
        own_focus=0.5,
        black=Normal(black, 3 * LEVEL),
    )


@dataclass(frozen=True)
class StereoAugmentation:
    """Ranges of the augmentation of a stereo pair."""

    zoom: float = 0.22
    """Deviation of the zoom's logarithm."""
    stretch: float = 0.1
    """Deviation of the logarithm of width against height."""
    largest_zoom: float = 1.8
    """Beyond it images only get blurred."""
    smallest_zoom: float = 0.6
    misaligned: float = 0.5
    """Probability that the right view is off by a fraction of a row."""
    rows_px: float = 0.35
    """Deviation of how much it is off, rows."""
    roll_rad: float = 0.0012
    """Deviation of its roll."""
    covered: float = 0.25
    """Probability of a patch that hides part of the right view."""
    photometric: PairAugmentation = field(default_factory=photometric)

    def __post_init__(self) -> None:
        if not 0 < self.smallest_zoom <= self.largest_zoom:
            zooms = f"{self.smallest_zoom} and {self.largest_zoom}"
            raise ValueError(f"stereo augmentation: expected 0 < smallest_zoom <= largest_zoom, found {zooms}")
        if not (0 <= self.misaligned <= 1 and 0 <= self.covered <= 1):
            given = f"{self.misaligned} and {self.covered}"
            raise ValueError(f"stereo augmentation: expected probabilities from 0 to 1, found {given}")


REAL = StereoAugmentation()
RENDERED = StereoAugmentation(photometric=photometric(RENDERED_CONTRAST, RENDERED_BLACK))


def augment(
    pair: StereoPair, rng: np.random.Generator, size: tuple[int, int], ranges: StereoAugmentation = REAL
) -> StereoPair:
    """Return the pair as another camera, another day and a worse calibration would have it, cropped to size."""
    pair = cut(pair, rng, size, ranges)
    left, right = augment_pair(pair.left, pair.right, rng, ranges.photometric)
    if rng.random() < ranges.misaligned:
        right = misalign(right, rng.normal(0, ranges.rows_px), rng.normal(0, ranges.roll_rad))
    if rng.random() < ranges.covered:
        right = cover(left, right, rng)
    return replace(pair, left=left, right=right)


def cut(pair: StereoPair, rng: np.random.Generator, size: tuple[int, int], ranges: StereoAugmentation) -> StereoPair:
    """Cut a random window out of both views and resize it to size."""
    available = pair.disparity_px.shape
    zoom = np.exp(rng.normal(0, ranges.zoom))
    stretch = np.exp(rng.normal(0, ranges.stretch))
    zooms = np.clip([zoom, zoom * stretch], ranges.smallest_zoom, ranges.largest_zoom)
    height, width = (min(available[i], max(8, round(size[i] / zooms[i]))) for i in (0, 1))
    top, left = rng.integers(available[0] - height + 1), rng.integers(available[1] - width + 1)
    return resize(pair, int(top), int(left), (height, width), size)


def resize(pair: StereoPair, top: int, left: int, window: tuple[int, int], size: tuple[int, int]) -> StereoPair:
    """Cut a window (height, width) out of both views and resize it; disparities follow the width."""
    from priors.kernels import disparity_warp as kernels

    flags = pair.known.astype(np.uint8) | (pair.sky.astype(np.uint8) << 1)
    at = top, left, window, size
    disparity_px, flags_there = kernels.resize(pair.disparity_px, flags, *at, SURFACE_PX)
    weight, _ = kernels.resize(pair.weight, flags, *at, 0.0)
    disparity_px *= np.float32(size[1] / window[1])
    views = [_resize(image[top : top + window[0], left : left + window[1]], size) for image in (pair.left, pair.right)]
    return replace(
        pair,
        left=views[0],
        right=views[1],
        disparity_px=np.where(weight > 0, disparity_px, np.float32(0)),
        sky=(flags_there & 2).astype(np.bool_),
        weight=weight,
        sensors=pair.sensors and _resize_camera(pair.sensors, (top, left), window, size),
    )


def _resize_camera(sensors: Sensors, at: tuple[int, int], window: tuple[int, int], size: tuple[int, int]) -> Sensors:
    """Let the camera follow; depth = fx * baseline / disparity still holds, as fx and disparity scale alike."""
    return replace(sensors, camera=geometry.resize(geometry.crop(sensors.camera, *at, window), size))


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
