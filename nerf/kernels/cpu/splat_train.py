"""What training of Gaussians needs beside the rasteriser, on the CPU: Adam for those in view, and the colour's loss."""

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nerf.gaussians.types import NAMES, ColourLoss, Gaussians, Rates, SplatGradients, SplatMoments
from nerf.kernels.cpu import colour_loss as loops
from nerf.kernels.cpu.colour_loss import MARGIN, TAPS, Pair
from nerf.kernels.cpu.splat_adam import Columns, Settings, straighten
from nerf.kernels.cpu.splat_adam import adam as move
from nerf.twin import adam as twin_adam
from nerf.twin import colour_loss as twin_loss
from priors.machine import threads

Numbers = npt.NDArray[np.float32]


def adam(gaussians: Gaussians, gradients: SplatGradients, moments: SplatMoments, rates: Rates, step: int) -> None:
    """Do the step-th step of Adam for the Gaussians in view."""
    index, none, unit_m = gradients.index.numpy(), np.empty(0, np.float32), moments.unit_m.numpy()
    betas = twin_adam.BETA_MEAN, twin_adam.BETA_SQUARE
    numbers = (*betas, *(1 / (1 - beta**step) for beta in betas), twin_adam.EPSILON)
    settings = Settings._make(np.float32(x) for x in numbers)
    means, log_scales, rotations, opacities, harmonics = (
        _columns(*(getattr(x, name) for x in (gaussians, moments.mean, moments.square, gradients.of))) for name in NAMES
    )
    first, rest = harmonics._replace(last=3), harmonics._replace(first=3)
    plain = (log_scales, rotations, opacities, first, rest), rates[1:]
    work = [(means, np.float32(rates.means), unit_m)]
    work += [(columns, np.float32(rate), none) for columns, rate in zip(*plain, strict=True)]

    def some(start: int, end: int) -> None:
        for columns, rate, unit in work:
            move(columns, index, rate, unit, settings, start, end)
        straighten(rotations.parameter, index, start, end)

    threads.over(len(index), some)


def _columns(parameter: Tensor, mean: Tensor, square: Tensor, gradient: Tensor) -> Columns:
    """Return all columns that have a gradient; what is written lies where it lies."""
    written = [x.numpy().reshape(-1) for x in (parameter, mean, square)]
    if not all(x.is_contiguous() for x in (parameter, mean, square)):
        raise ValueError("expected contiguous parameters and moments")
    stored, given = (parameter[:1].numel() for parameter in (parameter, gradient))
    flat = gradient.contiguous().numpy().reshape(-1)
    return Columns(written[0], written[1], written[2], flat, stored, given, 0, given)


def colour_loss(rgb: Tensor, truth: Tensor, share: float, weight: Tensor | None = None) -> ColourLoss:
    """Return L1 and SSIM of pictures, and the derivative."""
    height, width = rgb.shape[:2]
    if share > 0 and min(height, width) < TAPS:
        raise ValueError(f"SSIM needs pictures of {TAPS} x {TAPS} pixels or more, found {(height, width)}")
    windows, rim = max(height - TAPS + 1, 0), TAPS // 2
    per_window, per_number = 1 / max(windows * (width - TAPS + 1), 1), 1 / (height * width)
    if weight is not None:
        per_window = 1 / max(float(weight[rim : height - rim, rim : width - rim].sum()), 1e-12)
        per_number = 1 / max(float(weight.sum()), 1e-12)
    each = torch.empty(0) if weight is None else weight.float().repeat_interleave(3)
    arrays = (_flat(x) for x in (rgb, truth, each, twin_loss.taps().float()))
    scales = (np.float32(x) for x in (share * per_window / 3, (1 - share) * per_number / 3, twin_loss.C1, twin_loss.C2))
    pair = Pair._make([*arrays, (height, width), *scales])
    maps = np.empty(3 * windows * (3 * width + MARGIN) if share > 0 else 0, np.float32)
    unlike, apart = np.zeros(windows), np.zeros(height)
    d_rgb = torch.empty(height, width, 3)
    filled = d_rgb.numpy().reshape(-1)
    if share > 0:
        threads.over(windows, lambda first, last: loops.compare(pair, maps, unlike, first, last), each=1)
    threads.over(height, lambda first, last: loops.differ(pair, maps, filled, apart, first, last))
    absolute = float(apart.sum()) * per_number / 3
    dissimilarity = float(unlike.sum()) / share if share > 0 else 0.0
    return ColourLoss(absolute, dissimilarity, (1 - share) * absolute + share * dissimilarity, d_rgb)


def _flat(tensor: Tensor) -> Numbers:
    return tensor.detach().float().contiguous().numpy().reshape(-1)
