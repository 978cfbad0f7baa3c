"""What training of Gaussians needs beside the rasteriser, on GPUs: Adam for those in view, and the colour's loss."""

import math

import torch
from torch import Tensor

from nerf.gaussians.types import NAMES, ColourLoss, Gaussians, Rates, SplatGradients, SplatMoments
from nerf.kernels.triton import colour_loss as loss
from nerf.kernels.triton import splat_adam
from nerf.twin import colour_loss as twin
from nerf.twin.adam import BETA_MEAN, BETA_SQUARE

_NUMBERS = 512
"""Numbers that a program of the optimiser moves, or of the loss compares."""
_ROWS = 128
"""Quaternions that a program straightens."""


def adam(gaussians: Gaussians, gradients: SplatGradients, moments: SplatMoments, rates: Rates, step: int) -> None:
    """Do the step-th step of Adam for the Gaussians in view."""
    raised, scale = 1 / (1 - BETA_SQUARE**step), 1 / (1 - BETA_MEAN**step)
    index = gradients.index
    for name, rate in zip(NAMES, rates[:5], strict=True):
        parameter, mean, square = (getattr(x, name) for x in (gaussians, moments.mean, moments.square))
        if not all(x.is_contiguous() for x in (parameter, mean, square)):
            raise ValueError("expected contiguous parameters and moments")
        gradient = getattr(gradients.of, name).contiguous()
        stored, given = math.prod(parameter.shape[1:]), math.prod(gradient.shape[1:])
        of_rest = rates.view if name == "harmonics" else rate
        splat_adam.move[-(-gradient.numel() // _NUMBERS),](
            index, parameter, gradient, mean, square, moments.unit_m, gradient.numel(), stored, given, scale * rate,
            scale * of_rest, 3, raised, UNITS=name == "means_m", BLOCK=_NUMBERS,
        )  # fmt: skip
    splat_adam.straighten[-(-len(index) // _ROWS),](index, gaussians.rotations, len(index), BLOCK=_ROWS)


def colour_loss(rgb: Tensor, truth: Tensor, share: float, weight: Tensor | None = None) -> ColourLoss:
    """Return L1 and SSIM of pictures, and the derivative; waits for the device once."""
    height, width = rgb.shape[:2]
    if share > 0 and min(height, width) < twin.WINDOW:
        raise ValueError(
            f"SSIM needs pictures of {twin.WINDOW} x {twin.WINDOW} pixels or more, found {(height, width)}"
        )
    rgb, truth = (x.detach().float().contiguous() for x in (rgb, truth))
    weight = torch.ones_like(rgb[..., 0]) if weight is None else weight.float().contiguous()
    rim, windows = twin.WINDOW // 2, height - twin.WINDOW + 1
    inner = weight[rim : height - rim, rim : width - rim]
    totals = 3 * torch.stack([weight.sum(), inner.sum()]).clamp(min=1e-12)
    count = windows * 3 * (width - twin.WINDOW + 1) if share > 0 else 0
    maps, unlike = rgb.new_empty(3, count), rgb.new_empty(-(-count // _NUMBERS))
    d_rgb, apart = torch.empty_like(rgb), rgb.new_empty(-(-rgb.numel() // _NUMBERS))
    pair = rgb, truth, weight, twin.taps().float().to(rgb.device), totals, share, height, width
    loss.compare[len(unlike),](*pair, count, maps, unlike, BLOCK=_NUMBERS)
    loss.differ[len(apart),](*pair, rgb.numel(), count, maps, d_rgb, apart, SSIM=share > 0, BLOCK=_NUMBERS)
    sums = torch.stack([x.sum(dtype=torch.float64) for x in (apart, unlike)])
    absolute, dissimilarity = (sums / totals).tolist()
    return ColourLoss(absolute, dissimilarity, (1 - share) * absolute + share * dissimilarity, d_rgb)
