"""The small networks in plain PyTorch."""

from typing import Any

import torch
from torch import Tensor

from nerf.types import Layers

LOGIT_MAX = 12.0
"""Densities stop at e^12 times the initial one."""


class _Rounded(torch.autograd.Function):
    """Round a value to bfloat16, its gradient, or both: `kind` is "value", "gradient" or "both"."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, kind: str) -> Tensor:
        ctx.rounds = kind != "value"
        return x.clone() if kind == "gradient" else x.bfloat16().to(x.dtype)

    @staticmethod
    def backward(ctx: Any, d_x: Tensor) -> tuple[Tensor, None]:
        return d_x.bfloat16().to(d_x.dtype) if ctx.rounds else d_x, None


class _Limited(torch.autograd.Function):
    """Hold a logit at LOGIT_MAX, an infinite one too; its gradient passes."""

    @staticmethod
    def forward(ctx: Any, logit: Tensor) -> Tensor:
        return logit.clamp(max=LOGIT_MAX)

    @staticmethod
    def backward(ctx: Any, d_logit: Tensor) -> Tensor:
        return d_logit


def _round(x: Tensor, half: bool, kind: str = "both") -> Tensor:
    """Round where the bfloat16 kernels do, if they are to be followed."""
    return _Rounded.apply(x, kind) if half else x


def _product(x: Tensor, weights: Tensor, half: bool) -> Tensor:
    return x @ _round(weights, half, "value").T


def density(features: Tensor, layers: Layers, initial: float, half: bool = False) -> tuple[Tensor, Tensor]:
    """Return density (m,) and geometry (m, 16), whose first is the logit; features (levels, m, 2).

    sigma = initial * exp(min(logit, 12)); the gradient passes the limit ("truncated exponential", as Instant-NGP).
    `half` rounds where the bfloat16 kernels do.
    """
    x = _round(features.permute(1, 0, 2).flatten(1), half)
    x = _round(torch.relu(_product(x, layers.density0, half)), half)
    geometry = _round(_product(x, layers.density1, half), half, "gradient")
    logit = geometry[:, 0]
    return initial * torch.exp(_Limited.apply(logit)), geometry


def shade(
    features: Tensor, harmonics: Tensor, ray: Tensor, layers: Layers, initial: float, half: bool = False
) -> tuple[Tensor, Tensor]:
    """Return density (m,) and colour (m, 3) in [0, 1]: features (levels, m, 2), harmonics (r, 16), ray (m,).

    The colour sees the harmonics of its ray's direction and all 16 outputs of the first network.
    """
    sigma, geometry = density(features, layers, initial, half)
    basis = _round(harmonics, half)[ray.long().clamp(min=0)]
    x = torch.cat([basis, _round(geometry, half, "value")], dim=1)
    x = _round(torch.relu(_product(x, layers.colour0, half)), half)
    x = _round(torch.relu(_product(x, layers.colour1, half)), half)
    return sigma, torch.sigmoid(_round(_product(x, layers.colour2, half), half, "gradient"))
