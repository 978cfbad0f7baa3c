"""Rows of a pair: how far the other image lies too low or too high, and the image put right.

Rectified images show a point in the same row. Where they do not, every matcher looks beside the truth: a network is
right within 1 px on nine tenths of the pixels of a good pair, and on a quarter at seven rows.
"""

import cv2
import numpy as np

from priors.codecs import as_grey
from priors.pairs.agreement import match_corners
from priors.pairs.read import Pair
from priors.types import Image

FEWEST = 30
"""Corners that must be found in the other image."""
OFF_PX = 0.75
"""A smaller offset is left as it is: a single pair of KITTI shows up to 0.56 px."""
SCATTER_PX = 1.0
"""Deviation from the offset, median, beyond which it is no offset: the images are of two moments, say."""
DIGITS = 1
"""Of an offset in px: corners tell no more."""


def measure_rows(pair: Pair) -> float | None:
    """Return how many rows the right image lies too low, px, to a tenth; None where it is right or cannot be told."""
    shifts = match_corners(as_grey(pair.left), as_grey(pair.right), "left")
    if shifts is None or len(shifts) < FEWEST:
        return None
    rows_px = float(np.median(shifts[:, 1]))
    scatter_px = float(np.median(np.abs(shifts[:, 1] - rows_px)))
    return round(rows_px, DIGITS) if abs(rows_px) > OFF_PX and scatter_px < SCATTER_PX else None


def raise_rows(image: Image, rows_px: float) -> Image:
    """Return the image (height, width[, 3]) with what lies rows_px too low where it belongs; its edge is repeated."""
    matrix = np.array([[1, 0, 0], [0, 1, rows_px]], np.float64)
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    raised = cv2.warpAffine(image, matrix, image.shape[1::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(raised, np.uint8)
