"""The size at which our single-image network looks at an image.

It was trained on images of KITTI's size and, mostly, its focal length. On larger ones the same thing covers more pixels
than it has ever seen: at 1600x900 the error is four times that of the same image made as small as KITTI's.
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
ENOUGH = 0.9
"""Images whose sides would only shrink to this share or more stay as they are."""


def share_of(camera: Camera) -> float:
    """Return the share of its sides, up to 1, at which our network looks at a camera's images."""
    share = min(math.sqrt(PIXELS / (camera.size[0] * camera.size[1])), LONGEST_PX / camera.fx)
    return 1.0 if share >= ENOUGH else share


def shrink(image: Image, share: float) -> Image:
    """Make an image (h, w) or (h, w, 3) smaller; each side has one pixel at least."""
    height, width = (max(1, round(side * share)) for side in image.shape[:2])
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def enlarge(map_: FloatMap, size: tuple[int, int]) -> FloatMap:
    """Bring a map to (height, width); values between pixels are mixed."""
    return np.asarray(cv2.resize(map_, size[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
