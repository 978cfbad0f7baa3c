"""Rows of the table: image metrics."""

import math

import numpy as np
import numpy.typing as npt

from eval.image import ImageScore
from eval.protocol import ScoreError
from priors.stress.inputs import INFINITE, NOT_A_NUMBER, ONE_PIXEL, Given
from priors.stress.precision import Floats
from priors.stress.routine import NO_BFLOAT, NO_DEPTH, NO_MASK, NO_POSES, Case, Outputs, Routine

SIZE = (14, 17)
K1, K2 = 0.01, 0.03


def image_metrics(given: Given) -> Case:
    """Score an image against the true one; one that is not finite, or smaller than a window, is refused."""
    size = (*given.size(*SIZE), 3)
    image, truth = given.values(0.05, 0.9, size), given.plain(0.05, 0.9, size)
    ours, theirs = given.precision.array(image), given.precision.array(truth)
    refused = given.input in (INFINITE, NOT_A_NUMBER, ONE_PIXEL) or not np.isfinite(image).all()
    return Case(
        found=lambda: ImageScore.over(ours, theirs).figures(),
        wanted=lambda: _formulas(np.clip(image, 0, 1), np.clip(truth, 0, 1)),
        scale={"ssim_uniform7": 1.0, "ssim_gauss11": 1.0},
        raises=ScoreError if refused else None,
    )


def _formulas(image: Floats, truth: Floats) -> Outputs:
    """Return the table in eval/image.py, window by window."""
    saved, true = np.rint(image * 255), np.rint(truth * 255)
    even, step = np.full((7, 7), 1 / 49), np.arange(-5, 6)
    bell = np.exp(-(step**2) / (2 * 1.5**2))
    gauss = np.outer(bell, bell) / bell.sum() ** 2
    return {
        "psnr": _psnr(image, truth, 1),
        "psnr_uint8": _psnr(saved, true, 255),
        "ssim_uniform7": _ssim(saved, true, even, 255, 49 / 48),
        "ssim_gauss11": _ssim(image, truth, gauss, 1, 1.0),
    }


def _psnr(image: Floats, truth: Floats, largest: float) -> float:
    mse = math.fsum(((image - truth) ** 2).ravel()) / image.size
    return math.inf if mse == 0 else 10 * math.log10(largest**2 / mse)


def _ssim(image: Floats, truth: Floats, window: npt.NDArray[np.float64], largest: float, sample: float) -> float:
    """Average SSIM over channels and all windows inside the image; `sample`: n / (n - 1) for the sample covariance."""
    found = []
    rows, columns = window.shape
    for top in range(image.shape[0] - rows + 1):
        for left in range(image.shape[1] - columns + 1):
            part = (slice(top, top + rows), slice(left, left + columns))
            for channel in range(image.shape[2]):
                found.append(_one_ssim(image[(*part, channel)], truth[(*part, channel)], window, largest, sample))
    return math.fsum(found) / len(found)


def _one_ssim(x: Floats, y: Floats, window: Floats, largest: float, sample: float) -> float:
    mean_x, mean_y = float((window * x).sum()), float((window * y).sum())
    spread_x = sample * float((window * (x - mean_x) ** 2).sum())
    spread_y = sample * float((window * (y - mean_y) ** 2).sum())
    both = sample * float((window * (x - mean_x) * (y - mean_y)).sum())
    c1, c2 = (K1 * largest) ** 2, (K2 * largest) ** 2
    top = (2 * mean_x * mean_y + c1) * (2 * both + c2)
    return top / ((mean_x**2 + mean_y**2 + c1) * (spread_x + spread_y + c2))


ROUTINES = (Routine("PSNR and SSIM", "eval/image.py", image_metrics, {**NO_POSES, **NO_MASK, **NO_DEPTH}, NO_BFLOAT),)
