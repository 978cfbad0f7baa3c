"""The size at which our single-image network looks at an image.

It was trained on images of KITTI's size. On larger ones the same thing covers more pixels than it has ever seen: at
1600x900 the error is four times that of the same image made as small as KITTI's.
"""

import math

import cv2
import numpy as np

from priors.types import FloatMap, Image

PIXELS = 375 * 1242
"""Of an image that it was trained on."""
ENOUGH = 0.9
"""Images whose sides would only shrink to this share or more stay as they are."""


def share_of(size: tuple[int, int]) -> float:
    """Return the share of its sides, up to 1, at which an image of (height, width) has as many pixels as KITTI's."""
    share = math.sqrt(PIXELS / (size[0] * size[1]))
    return 1.0 if share >= ENOUGH else share


def shrink(image: Image, share: float) -> Image:
    """Make an image (h, w) or (h, w, 3) smaller; each side has one pixel at least."""
    height, width = (max(1, round(side * share)) for side in image.shape[:2])
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def enlarge(map_: FloatMap, size: tuple[int, int]) -> FloatMap:
    """Bring a map to (height, width); values between pixels are mixed."""
    return np.asarray(cv2.resize(map_, size[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
