"""The sizes at which our single-image network looks at an image.

It was trained on images of KITTI's size and, mostly, its focal length. On larger ones the same thing covers more pixels
than it has ever seen: at 1600x900 the error is four times that of the same image made as small as KITTI's. On smaller
ones it covers too few. Two looks, at 0.85 and 0.55 of KITTI's size, have as many pixels as one at all of it and take a
fifth longer; their mean is a tenth more right (docs/methods/mono.md).
"""

import math

import cv2
import numpy as np

from priors.types import Camera, FloatMap, Image

FOCAL_PX = 721.5377
"""KITTI's focal length, in which the network thinks (nets/bts.py, which would load PyTorch here)."""
PIXELS = 375 * 1242
"""Of an image that it was trained on."""
LONGEST_PX = 1.5 * FOCAL_PX
"""Focal length up to which it is sure: longer ones are shrunk to it."""
LOOKS = (0.85, 0.55)
"""Sides of what the network looks at, as a share of KITTI's."""
LARGEST = 3.0
"""So many times larger at most: an image of a fifth of KITTI's size is as well seen so as larger still."""
ENOUGH = 0.9
"""Images whose sides would only shrink to this share or more stay as they are."""


def share_of(camera: Camera) -> float:
    """Return the share of its sides, up to 1, at which a network that adapts looks at a camera's images."""
    share = min(1.0, _as_kitti(camera))
    return 1.0 if share >= ENOUGH else share


def looks(camera: Camera) -> tuple[float, ...]:
    """Return the shares of its sides, up to LARGEST, at which our network looks at a camera's images in turn."""
    share = min(_as_kitti(camera), LARGEST / max(LOOKS))
    return tuple(look * share for look in LOOKS)


def _as_kitti(camera: Camera) -> float:
    """Return what an image's sides are multiplied by to have as many pixels as KITTI's, at no long focal length."""
    return min(math.sqrt(PIXELS / (camera.size[0] * camera.size[1])), LONGEST_PX / camera.fx)


def scaled(image: Image, share: float) -> Image:
    """Make an image (h, w) or (h, w, 3) smaller or larger; each side has one pixel at least."""
    height, width = (max(1, round(side * share)) for side in image.shape[:2])
    how = cv2.INTER_AREA if share < 1 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, (width, height), interpolation=how), np.uint8)


def brought(map_: FloatMap, size: tuple[int, int]) -> FloatMap:
    """Bring a map to (height, width); values between pixels are mixed."""
    return np.asarray(cv2.resize(map_, size[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
