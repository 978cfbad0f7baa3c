"""Filling: what a map lacks comes from around, near gaps from near, wide gaps from far (push-pull).

Gortler, Grzeszczuk, Szeliski, Cohen, "The Lumigraph", SIGGRAPH 1996, section 3.4.
"""

import cv2
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]


def fill(values: Floats, known: npt.NDArray[np.bool_]) -> Floats:
    """Fill a map (h, w) or (h, w, c) where it is not known (h, w); known pixels stay as they are, all unknown: 0."""
    if known.all():
        return values
    weight = known.astype(np.float32)
    pulled = _pull(values.reshape(*known.shape, -1) * weight[..., None], weight).reshape(values.shape)
    pulled[known] = values[known]
    return pulled


def _pull(total: Floats, weight: Floats) -> Floats:
    """Return weighted sums (h, w, c) of weights (h, w) in [0, 1], completed by the level of half the size."""
    height, width = weight.shape
    if height == width == 1 or weight.min() >= 1:
        return (total / np.maximum(weight, np.float32(1e-9))[..., None]).astype(np.float32)
    below, share = _halved(total), _halved(weight[..., None])[..., 0]
    most = np.minimum(1, 1 / np.maximum(share, np.float32(1e-9)))
    coarse = _pull(below * most[..., None], share * most)
    upsampled = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR).reshape(total.shape)
    return total + (1 - weight)[..., None] * upsampled


def _halved(values: Floats) -> Floats:
    """Sum blocks of 2x2 pixels; odd sizes end in smaller blocks."""
    height, width, _ = values.shape
    padded = np.pad(values, ((0, height % 2), (0, width % 2), (0, 0)))
    return padded[::2, ::2] + padded[1::2, ::2] + padded[::2, 1::2] + padded[1::2, 1::2]
