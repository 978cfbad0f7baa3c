"""The small networks in plain PyTorch."""

from typing import NamedTuple

import torch
from torch import Tensor

LOGIT_MAX = 12.0
"""Densities stop at e^12 times the initial one."""


class Layers(NamedTuple):
    """The weights of the two networks, (out, in) each; no biases."""

    density0: Tensor
    density1: Tensor
    colour0: Tensor
    colour1: Tensor
    colour2: Tensor


def rounded(x: Tensor) -> Tensor:
    """Round to bfloat16 and back, the gradient too."""
    return _Rounded.apply(x)  # type: ignore[no-any-return,no-untyped-call]


class _Rounded(torch.autograd.Function):
    @staticmethod
    def forward(ctx: object, x: Tensor) -> Tensor:
        return x.bfloat16().to(x.dtype)

    @staticmethod
    def backward(ctx: object, d_x: Tensor) -> Tensor:
        return d_x.bfloat16().to(d_x.dtype)


def density(features: Tensor, layers: Layers, initial: float, half: bool = False) -> tuple[Tensor, Tensor]:
    """Return density (m,) and geometry (m, 16), whose first is the logit; features (levels, m, 2).

    sigma = initial * exp(min(logit, 12)); the gradient passes the limit ("truncated exponential", as Instant-NGP).
    `half` rounds where the bfloat16 kernels do.
    """
    cut = rounded if half else _same
    x = features.permute(1, 0, 2).flatten(1)
    geometry = cut(torch.relu(x @ cut(layers.density0).T)) @ cut(layers.density1).T
    logit = geometry[:, 0]
    limited = logit + (logit.clamp(max=LOGIT_MAX) - logit).detach()
    return initial * torch.exp(limited), geometry


def shade(
    features: Tensor, harmonics: Tensor, ray: Tensor, layers: Layers, initial: float, half: bool = False
) -> tuple[Tensor, Tensor]:
    """Return density (m,) and colour (m, 3) in [0, 1]: features (levels, m, 2), harmonics (r, 16), ray (m,).

    The colour sees the harmonics of its ray's direction and all 16 outputs of the first network.
    """
    cut = rounded if half else _same
    sigma, geometry = density(features, layers, initial, half)
    x = torch.cat([cut(harmonics)[ray.long().clamp(min=0)], cut(geometry)], dim=1)
    x = cut(torch.relu(x @ cut(layers.colour0).T))
    x = cut(torch.relu(x @ cut(layers.colour1).T))
    return sigma, torch.sigmoid(x @ cut(layers.colour2).T)


def _same(x: Tensor) -> Tensor:
    return x
