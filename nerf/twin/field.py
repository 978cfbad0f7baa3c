"""The small networks in plain PyTorch."""

from typing import Any

import torch
from torch import Tensor

from nerf.types import Layers

LOGIT_MAX = 12.0
"""Densities stop at e^12 times the initial one."""


class _Rounded(torch.autograd.Function):
    """Round a value to bfloat16, or its gradient, or both."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, value: bool, gradient: bool) -> Tensor:
        ctx.gradient = gradient
        return x.bfloat16().to(x.dtype) if value else x.clone()

    @staticmethod
    def backward(ctx: Any, d_x: Tensor) -> tuple[Tensor, None, None]:
        return d_x.bfloat16().to(d_x.dtype) if ctx.gradient else d_x, None, None


def _cut(x: Tensor, half: bool, value: bool = True, gradient: bool = True) -> Tensor:
    """Round where the bfloat16 kernels do, if they are to be followed."""
    return _Rounded.apply(x, value, gradient) if half else x


def _product(x: Tensor, weights: Tensor, half: bool) -> Tensor:
    return x @ _cut(weights, half, gradient=False).T


def density(features: Tensor, layers: Layers, initial: float, half: bool = False) -> tuple[Tensor, Tensor]:
    """Return density (m,) and geometry (m, 16), whose first is the logit; features (levels, m, 2).

    sigma = initial * exp(min(logit, 12)); the gradient passes the limit ("truncated exponential", as Instant-NGP).
    `half` rounds where the bfloat16 kernels do.
    """
    x = _cut(features.permute(1, 0, 2).flatten(1), half)
    x = _cut(torch.relu(_product(x, layers.density0, half)), half)
    geometry = _cut(_product(x, layers.density1, half), half, value=False)
    logit = geometry[:, 0]
    limited = logit + (logit.clamp(max=LOGIT_MAX) - logit).detach()
    return initial * torch.exp(limited), geometry


def shade(
    features: Tensor, harmonics: Tensor, ray: Tensor, layers: Layers, initial: float, half: bool = False
) -> tuple[Tensor, Tensor]:
    """Return density (m,) and colour (m, 3) in [0, 1]: features (levels, m, 2), harmonics (r, 16), ray (m,).

    The colour sees the harmonics of its ray's direction and all 16 outputs of the first network.
    """
    sigma, geometry = density(features, layers, initial, half)
    seen = _cut(harmonics, half)[ray.long().clamp(min=0)]
    x = torch.cat([seen, _cut(geometry, half, gradient=False)], dim=1)
    x = _cut(torch.relu(_product(x, layers.colour0, half)), half)
    x = _cut(torch.relu(_product(x, layers.colour1, half)), half)
    return sigma, torch.sigmoid(_cut(_product(x, layers.colour2, half), half, value=False))
