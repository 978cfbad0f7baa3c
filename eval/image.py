"""Image metrics: PSNR and two SSIMs, each by the definition that papers took it from.

| key            | of                     | formula                                                                   |
|----------------|------------------------|---------------------------------------------------------------------------|
| psnr           | float images in [0, 1] | 10 log10(1 / MSE), MSE over all pixels and channels of one image          |
| psnr_uint8     | images as saved        | 10 log10(255^2 / MSE)                                                     |
| ssim_uniform7  | images as saved        | 7x7 uniform window, sample covariance: scikit-image's default             |
| ssim_gauss11   | float images in [0, 1] | 11x11 Gaussian window, sigma 1.5: the original, and torchmetrics' default |

SSIM: Wang et al., IEEE TIP 2004, K1 = 0.01, K2 = 0.03, each channel by itself, then the mean. Windows lie inside the
image: the border that half a window touches is left out. Both are computed by scikit-image's structural_similarity; its
options make the second one torchmetrics'. The two differ by hundredths: a table must name which it holds, as these keys
do.

Equal images have an infinite PSNR, and a mean over images with one of them is infinite. Float images are clipped to
[0, 1] first; "as saved" is rounded to 8 bits. A value that is not finite is an error and no score.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from eval.protocol import ScoreError, text

Float = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]
AnyImage = npt.NDArray[Any]

UNIFORM_PX, GAUSS_PX = 7, 11


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
    from skimage.metrics import mean_squared_error

    return float(mean_squared_error(image, truth))


def psnr(mse: float, data_range: float = 1.0) -> float:
    """Turn a mean squared error into decibels; infinite where it is 0."""
    # Result files keep the error, so that figures can be made anew: scikit-image's PSNR starts from images.
    return float("inf") if mse == 0 else float(10 * np.log10(data_range**2 / mse))


def ssim_uniform7(image: Bytes, truth: Bytes) -> float:
    """Return the mean SSIM of 8-bit images by a uniform window and the sample covariance."""
    return _ssim(image, truth, UNIFORM_PX, data_range=255)


def ssim_gauss11(image: Float, truth: Float) -> float:
    """Return the mean SSIM of images in [0, 1] by a Gaussian window and the population covariance."""
    # scikit-image cuts its Gaussian off at 3.5 sigma: 5 px each way, 11 in all.
    return _ssim(image, truth, GAUSS_PX, data_range=1, gaussian_weights=True, sigma=1.5, use_sample_covariance=False)


def _ssim(image: AnyImage, truth: AnyImage, window_px: int, **options: float) -> float:
    """Average scikit-image's SSIM over channels and over all windows that lie inside the image."""
    from skimage.metrics import structural_similarity

    if min(image.shape[:2]) < window_px:
        raise ScoreError(f"image is {text(image.shape[:2])}: SSIM needs {window_px} px each way")
    channels = 2 if image.ndim == 3 else None
    return float(structural_similarity(image, truth, win_size=window_px, channel_axis=channels, **options))
