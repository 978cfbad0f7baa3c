"""Image metrics: PSNR and two SSIMs, each by the definition that papers took it from.

| key            | of                     | formula                                                                   |
|----------------|------------------------|---------------------------------------------------------------------------|
| psnr           | float images in [0, 1] | 10 log10(1 / MSE), MSE over all pixels and channels of one image          |
| psnr_uint8     | images as saved        | 10 log10(255^2 / MSE)                                                     |
| ssim_uniform7  | images as saved        | 7x7 uniform window, sample covariance: scikit-image's default             |
| ssim_gauss11   | float images in [0, 1] | 11x11 Gaussian window, sigma 1.5: the original, and torchmetrics' default |

SSIM: Wang et al., IEEE TIP 2004, K1 = 0.01, K2 = 0.03, each channel by itself, then the mean. Windows lie inside the
image: both libraries leave out the border that half a window touches. The two differ by hundredths: a table must name
which it holds, as these keys do.

Equal images have an infinite PSNR, and a mean over images with one of them is infinite. Float images are clipped to
[0, 1] first; "as saved" is rounded to 8 bits. A value that is not finite is an error and no score.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from eval.protocol import ScoreError, text

Float = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]
AnyImage = npt.NDArray[Any]

K1, K2 = 0.01, 0.03
UNIFORM_PX, GAUSS_PX, GAUSS_SIGMA_PX = 7, 11, 1.5


@dataclass(frozen=True, slots=True)
class ImageScore:
    """What one image scores; the errors are kept, the PSNRs are made from them."""

    mse: float
    """Mean squared error of float images in [0, 1]."""
    mse_uint8: float
    """Mean squared error of the images as saved, in steps of 8 bits."""
    ssim_uniform7: float
    ssim_gauss11: float
    lpips: dict[str, float] = field(default_factory=dict)
    """LPIPS by its network's name: squeeze, vgg; empty without weights."""

    @classmethod
    def over(cls, image: AnyImage, truth: AnyImage) -> "ImageScore":
        """Score an image against the true one: float in [0, 1] or uint8, (height, width[, 3]) each.

        Raises:
            ScoreError: the shapes differ, a value is not finite, or the image is smaller than a window.
        """
        if image.shape != truth.shape:
            raise ScoreError(f"image is {text(image.shape)}, truth {text(truth.shape)}: they must be one size")
        floats, saved = (as_float(image), as_float(truth)), (as_uint8(image), as_uint8(truth))
        return cls(mse(*floats), mse(*saved), ssim_uniform7(*saved), ssim_gauss11(*floats))

    def figures(self) -> dict[str, float]:
        """Return the figures by the keys above, and lpips_<network>."""
        return {
            "psnr": psnr(self.mse),
            "psnr_uint8": psnr(self.mse_uint8, 255),
            "ssim_uniform7": self.ssim_uniform7,
            "ssim_gauss11": self.ssim_gauss11,
            **{f"lpips_{net}": value for net, value in self.lpips.items()},
        }


def mean(scores: Sequence[ImageScore]) -> dict[str, float]:
    """Average every figure over images, as papers do (not the error: a mean of PSNRs, not the PSNR of a mean).

    LPIPS is there only where every image has it. NaN without images.
    """
    rows = [score.figures() for score in scores] or [ImageScore(np.nan, np.nan, np.nan, np.nan).figures()]
    common = [key for key in rows[0] if all(key in row for row in rows)]
    return {key: float(np.mean([row[key] for row in rows])) for key in common}


def as_float(image: AnyImage) -> Float:
    """Return an image as float64 in [0, 1]; floats are clipped."""
    if image.dtype == np.uint8:
        return np.asarray(image / 255.0, dtype=np.float64)
    if not np.isfinite(image).all():
        raise ScoreError(f"image has {np.count_nonzero(~np.isfinite(image))} values that are not finite")
    return np.clip(image.astype(np.float64), 0, 1)


def as_uint8(image: AnyImage) -> Bytes:
    """Return an image as it is saved: clipped to [0, 1], rounded to the nearest of 256 steps."""
    return image if image.dtype == np.uint8 else np.rint(as_float(image) * 255).astype(np.uint8)


def mse(image: AnyImage, truth: AnyImage) -> float:
    """Return the mean squared difference, in the images' own unit."""
    return float(np.mean((image.astype(np.float64) - truth.astype(np.float64)) ** 2))


def psnr(mse: float, data_range: float = 1.0) -> float:
    """Turn a mean squared error into decibels; infinite where it is 0."""
    return float("inf") if mse == 0 else float(10 * np.log10(data_range**2 / mse))


def ssim_uniform7(image: Bytes, truth: Bytes) -> float:
    """Return the mean SSIM of 8-bit images by a uniform window, as scikit-image's structural_similarity has it."""
    count = UNIFORM_PX**2
    return _ssim(image, truth, np.full(UNIFORM_PX, 1 / UNIFORM_PX), 255.0, count / (count - 1))


def ssim_gauss11(image: Float, truth: Float) -> float:
    """Return the mean SSIM of images in [0, 1] by a Gaussian window, as Wang et al. and torchmetrics have it."""
    offset = np.arange(GAUSS_PX) - GAUSS_PX // 2
    window = np.exp(-(offset**2) / (2 * GAUSS_SIGMA_PX**2))
    return _ssim(image, truth, window / window.sum(), 1.0, 1.0)


def _ssim(image: AnyImage, truth: AnyImage, window: Float, data_range: float, unbias: float) -> float:
    """Average SSIM over all windows that lie inside the image; `unbias` scales variances and covariance."""
    if min(image.shape[:2]) < len(window):
        raise ScoreError(f"image is {text(image.shape[:2])}: SSIM needs {len(window)} px each way")
    x, y = image.astype(np.float64), truth.astype(np.float64)
    mean_x, mean_y = _inside(x, window), _inside(y, window)
    var_x = unbias * (_inside(x * x, window) - mean_x**2)
    var_y = unbias * (_inside(y * y, window) - mean_y**2)
    both = unbias * (_inside(x * y, window) - mean_x * mean_y)
    c1, c2 = (K1 * data_range) ** 2, (K2 * data_range) ** 2
    similar = (2 * mean_x * mean_y + c1) * (2 * both + c2)
    return float(np.mean(similar / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2))))


def _inside(image: Float, window: Float) -> Float:
    """Filter rows and columns by a window; only where it lies inside the image."""
    half = len(window) // 2
    filtered = cv2.sepFilter2D(image, cv2.CV_64F, window, window)
    return np.asarray(filtered[half : image.shape[0] - half, half : image.shape[1] - half], dtype=np.float64)
