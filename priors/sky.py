"""Sky mask from the image alone."""

import numpy as np

from priors.types import Image, Mask

VERSION = 1


def sky_mask(image: Image) -> Mask:
    """Tell which pixels are sky."""
    return np.zeros(image.shape[:2], np.bool_)
