"""Warped pairs: stereo pairs made of single real images by a plausible disparity map.

The idea of Watson et al., "Learning Stereo from Single Images" (ECCV 2020): the real image is the left view, its pixels
move by the disparities into the right one, nearer ones hide farther ones, and what no pixel moves to is filled from
another image. The disparities need not be right for the image: they are the truth of the pair that they make.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from priors.learn.stereo_pair import StereoPair, flip, mirror
from priors.types import FloatMap, Image, Mask

STEP_PX = 0.8
"""Neighbours whose disparities differ by more are of different surfaces."""
ROOM = 1.15, 96
"""The part of an image that is warped: so many times the crop's size, and so much wider for what moves out of it."""
SCALES = 0.5, 1.7
"""Disparities are multiplied by something between these."""
LARGEST_PX = 170.0
BUMPS = 0.05
"""Spread of the smooth relative change of the disparities."""
FLYING_PX = 3.0
"""Steeper disparities are smeared edges."""


@dataclass(frozen=True, slots=True)
class DisparityImage:
    """A real image and disparities that it might have."""

    image: Image
    """(h, w, 3) RGB or (h, w) grey."""
    disparity_px: FloatMap
    """(h, w), everywhere; 0 in the sky."""
    sky: Mask


def draw_pair(scene: DisparityImage, filler: Image, rng: np.random.Generator, crop: tuple[int, int]) -> StereoPair:
    """Make a pair of part of a scene: larger than the crop that will be cut out of it."""
    scene = _window(scene, rng, crop)
    if rng.random() < 0.5:
        scene = DisparityImage(flip(scene.image), flip(scene.disparity_px), flip(scene.sky))
    return warp(replace(scene, disparity_px=bend(scene.disparity_px, rng)), filler, swap=rng.random() < 0.5)


def warp(scene: DisparityImage, filler: Image, *, swap: bool = False) -> StereoPair:
    """Make the pair of which the scene is the left view (h, w); every disparity is known.

    Args:
        scene: image and disparities.
        filler: any image; fills what the left view does not see, in the scene's brightness and colours.
        swap: exchange the views in the mirror, so that the real image becomes the right one; what it does not see has
            no known disparity then.
    """
    from priors.kernels import disparity_warp as kernels

    column, seen_px = kernels.see_right(scene.disparity_px, STEP_PX)
    image = scene.image if scene.image.ndim == 3 else scene.image[..., None]
    right = _match_colours(filler, scene.image).reshape(image.shape)
    kernels.paint(np.ascontiguousarray(image), column, seen_px, STEP_PX, right)
    everywhere = np.ones(scene.sky.shape, np.float32)
    right = right.reshape(scene.image.shape)
    pair = StereoPair(scene.image, right, scene.disparity_px, scene.sky, everywhere, "warped")
    if not swap:
        return pair
    visible = seen_px >= 0
    from_column = np.clip(np.rint(column), 0, column.shape[1] - 1).astype(np.intp)
    right_sky = np.take_along_axis(scene.sky, from_column, axis=1) & visible
    return mirror(pair, seen_px, visible, right_sky)


def bend(disparity_px: FloatMap, rng: np.random.Generator) -> FloatMap:
    """Scale and bend the disparities (h, w); those of 0 stay."""
    largest = max(float(disparity_px[::8, ::8].max()), 1.0)
    scale = min(float(np.exp(rng.uniform(*np.log(SCALES)))), LARGEST_PX / largest)
    bumps = cv2.resize(rng.normal(0, BUMPS, (4, 7)).astype(np.float32), disparity_px.shape[::-1])
    return np.asarray(disparity_px * (np.float32(1) + bumps) * np.float32(scale), np.float32)


def sharpen(disparity_px: FloatMap) -> FloatMap:
    """Replace what is smeared between two surfaces by the nearest pixel that is not."""
    flying = np.abs(cv2.Sobel(disparity_px, cv2.CV_32F, 1, 0, scale=0.25)) > FLYING_PX / 2
    flying |= np.abs(cv2.Sobel(disparity_px, cv2.CV_32F, 0, 1, scale=0.25)) > FLYING_PX / 2
    return fill_nearest(disparity_px, ~flying)


def fill_nearest(values: FloatMap, valid: Mask) -> FloatMap:
    """Give every pixel that is not valid the value of the nearest that is; nothing changes where none is."""
    if not valid.any():
        return values
    _, labels = cv2.distanceTransformWithLabels(
        (~valid).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.zeros(int(labels.max()) + 1, np.float32)
    table[labels[valid]] = values[valid]
    return table[labels]


def _window(scene: DisparityImage, rng: np.random.Generator, crop: tuple[int, int]) -> DisparityImage:
    height, width = scene.sky.shape
    wanted = min(height, int(ROOM[0] * crop[0])), min(width, int(ROOM[0] * crop[1]) + ROOM[1])
    top, left = int(rng.integers(height - wanted[0] + 1)), int(rng.integers(width - wanted[1] + 1))
    window = slice(top, top + wanted[0]), slice(left, left + wanted[1])
    return DisparityImage(scene.image[window], scene.disparity_px[window], scene.sky[window])


def _match_colours(filler: Image, image: Image) -> Image:
    """Return the filler in the image's size, number of colours, mean and contrast."""
    if filler.ndim == 3 and image.ndim == 2:
        filler = np.asarray(cv2.cvtColor(filler, cv2.COLOR_RGB2GRAY), np.uint8)
    if filler.ndim == 2 and image.ndim == 3:
        filler = np.asarray(cv2.cvtColor(filler, cv2.COLOR_GRAY2RGB), np.uint8)
    (mean, spread), (wanted, wanted_spread) = (cv2.meanStdDev(a[::4, ::4]) for a in (filler, image))
    gain = wanted_spread / np.maximum(spread, 1)
    level = np.arange(256, dtype=np.float32)[:, None]
    table = np.clip((level - mean.T) * gain.T + wanted.T, 0, 255).astype(np.uint8)
    filler = np.asarray(cv2.resize(filler, image.shape[1::-1]), np.uint8)
    return np.asarray(cv2.LUT(filler, table[:, None] if image.ndim == 3 else table[:, 0]), np.uint8)
