"""The size at which a stereo network sees a pair.

The networks learned from pairs of KITTI's size. Of a smaller pair they see too little: fine structure is below their
half-size search, and distant disparities are fractions of a pixel. So a narrow pair is enlarged once. A pair with too
many pixels or disparities is halved. Where time counts more, a pair of KITTI's size is seen a little smaller: a
network's time goes with the pixels (docs/methods/stereo.md has the figures).
"""

from typing import Literal

import cv2
import numpy as np

from priors.types import FloatMap, Image, Mask

Resize = Literal["auto", "fast", "none"]
MOST_PIXELS, MOST_DISPARITY_PX = 1_500_000, 320
"""Larger pairs are halved first, as often as needed: KITTI has 0.47 million pixels, Argoverse's pair 5 million."""
WIDTH_PX = 1000
"""Eight tenths of KITTI's width: narrower pairs are enlarged to it. All of its width takes half as long again, for a
little more."""
FAST = 0.85
"""Share of its sides at which a pair that is wider is seen where time counts more."""
LARGEST, LEAST = 3.0, 1.1
"""So many times larger at most; and what would be enlarged by less stays as it is."""


def factor_of(width: int, resize: Resize) -> float:
    """Return how many times larger a network sees a pair of this width; 1: as it is."""
    if resize == "fast":
        return FAST if width * FAST >= WIDTH_PX else 1.0
    times = min(WIDTH_PX / max(width, 1), LARGEST)
    return times if times >= LEAST and resize == "auto" else 1.0


def seen_size(size: tuple[int, int], factor: float, max_disparity_px: int) -> tuple[int, int]:
    """Return the size (height, width) at which a network sees a pair; enlarged no further than its search reaches."""
    factor = min(factor, max(1.0, MOST_DISPARITY_PX / max(max_disparity_px, 1)))
    height, width = (max(1, round(side * factor)) for side in size)
    return height, width


def count_halvings(size: tuple[int, int], max_disparity_px: int) -> int:
    """Tell how often a pair (height, width) is halved before the network sees it."""
    halvings = 0
    while size[0] * size[1] > MOST_PIXELS * 4**halvings or max_disparity_px > MOST_DISPARITY_PX * 2**halvings:
        halvings += 1
    return halvings


def bring_image(image: Image, size: tuple[int, int]) -> Image:
    """Bring an image to (height, width); of a smaller one each pixel is the mean of those that it stands for."""
    if image.shape[:2] == size:
        return image
    how = cv2.INTER_AREA if image.shape[1] > size[1] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, size[::-1], interpolation=how), np.uint8)


def bring_mask(mask: Mask, size: tuple[int, int]) -> Mask:
    """Bring a mask to (height, width)."""
    return np.asarray(cv2.resize(mask.astype(np.uint8), size[::-1], interpolation=cv2.INTER_NEAREST), np.bool_)


def bring_map(map_: FloatMap, size: tuple[int, int]) -> FloatMap:
    """Bring a map to (height, width); values between pixels are mixed."""
    return map_ if map_.shape == size else np.asarray(cv2.resize(map_, size[::-1]), np.float32)


def chance_in_pixels(chance: FloatMap, pixels: float) -> FloatMap:
    """Return the probability (h, w) of an error within so many times what `chance` is the probability of.

    The error has a Laplace distribution, P(|error| <= a) = 1 - exp(-a / spread), as in priors/error_model.py.
    """
    return chance if pixels == 1 else 1 - (1 - chance) ** np.float32(pixels)
