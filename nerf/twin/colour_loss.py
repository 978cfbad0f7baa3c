"""L1 and SSIM of pictures in plain torch."""

import torch
from torch import Tensor

WINDOW, DEVIATION = 11, 1.5
C1, C2 = 0.01**2, 0.03**2
"""Of pictures in [0, 1] (Wang et al., IEEE TIP 2004, section III)."""


def taps() -> Tensor:
    """Return the window's weights along one axis: (11,) float64, of sum 1."""
    x = torch.arange(WINDOW, dtype=torch.float64) - WINDOW // 2
    weights = torch.exp(-0.5 * (x / DEVIATION) ** 2)
    return weights / weights.sum()


def ssim(rgb: Tensor, truth: Tensor) -> Tensor:
    """Return SSIM of each window that lies inside (h - 10, w - 10), mean over the channels; pictures (h, w, 3)."""
    line = taps().to(rgb)

    def mean(x: Tensor) -> Tensor:
        """No convolution of torch's: on GPUs those round to TF32, and variances are differences here."""
        down = (x.unfold(0, WINDOW, 1) * line).sum(-1)
        return (down.unfold(1, WINDOW, 1) * line).sum(-1)

    mx, my = mean(rgb), mean(truth)
    spread = mean(rgb * rgb + truth * truth) - mx * mx - my * my
    common = mean(rgb * truth) - mx * my
    values = (2 * mx * my + C1) * (2 * common + C2) / ((mx * mx + my * my + C1) * (spread + C2))
    return values.mean(2)


def parts(rgb: Tensor, truth: Tensor, share: float, weight: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Return the weighted means of |rgb - truth| and of 1 - SSIM; the latter 0 where share is 0.

    ValueError where no window fits.
    """
    weight = torch.ones_like(rgb[..., 0]) if weight is None else weight
    absolute = (weight[..., None] * (rgb - truth).abs()).sum() / (3 * weight.sum()).clamp(min=1e-12)
    if share == 0:
        return absolute, torch.zeros_like(absolute)
    if min(rgb.shape[:2]) < WINDOW:
        raise ValueError(f"SSIM needs pictures of {WINDOW} x {WINDOW} pixels or more, found {tuple(rgb.shape[:2])}")
    rim = WINDOW // 2
    inner = weight[rim:-rim, rim:-rim]
    return absolute, (inner * (1 - ssim(rgb, truth))).sum() / inner.sum().clamp(min=1e-12)
