"""Matching features at given disparities: fused kernels on CPUs, plain torch (volume.py) on GPUs and for export."""

from typing import Any

import torch
from torch import Tensor

from priors.nets import volume
from priors.nets.dispatch import on_cpu, without_gradient


def unit(features: Tensor, groups: int) -> Tensor:
    """Turn features (b, c, h, w) into (b, h, w, c) of unit length; see volume.unit, which this equals.

    Without gradients the result is float32 on CPUs, as the kernels have it.
    """
    if not without_gradient(features):
        return volume.unit(features, groups)
    from priors.kernels import distribution as kernels

    plain = features.permute(0, 2, 3, 1)
    out = torch.empty(plain.shape)
    kernels.unit(_rows(plain), groups, _rows(out))
    return out


def expect(logits: Tensor, position_px: Tensor, window: int | None = None) -> tuple[Tensor, Tensor]:
    """Return mean and deviation of the matching distribution; see volume.expect, which this equals."""
    if not without_gradient(logits):
        return volume.expect(logits, position_px, window)
    from priors.kernels import distribution as kernels

    planes = logits.shape[-1]
    values, positions = (t.float().contiguous().view(-1, planes).numpy() for t in (logits, position_px))
    mean, sigma = torch.empty(logits.shape[:-1]), torch.empty(logits.shape[:-1])
    kernels.expect(
        values, positions, planes if window is None else window, mean.view(-1).numpy(), sigma.view(-1).numpy()
    )
    return mean, sigma


def lookup(left: Tensor, right: Tensor, disparity_px: Tensor, groups: int) -> Tensor:
    """Match at each pixel's own disparities; see volume.lookup, which this equals."""
    if not on_cpu(left):
        return volume.lookup(left, right, disparity_px, groups)
    found: Tensor = _Match.apply(left, right, disparity_px, groups)
    return found.permute(0, 4, 1, 2, 3)


def lookup_flat(left: Tensor, right: Tensor, disparity_px: Tensor, groups: int) -> Tensor:
    """Match as `lookup` does, for 2D convolutions: (b, h, w, groups * planes), the planes fastest."""
    if not without_gradient(left):
        return lookup(left, right, disparity_px, groups).permute(0, 2, 3, 1, 4).flatten(3)
    planes = disparity_px.shape[3]
    out = torch.empty(*left.shape[:3], groups, planes)
    _match(left, right, disparity_px, groups, out.transpose(3, 4))
    return out.flatten(3)


def correlate(left: Tensor, right: Tensor, groups: int, planes: int) -> Tensor:
    """Match at disparities 0 .. planes - 1; see volume.correlate, which this equals."""
    if not on_cpu(left):
        return volume.correlate(left, right, groups, planes)
    disparity_px = torch.arange(planes, dtype=torch.float32).expand(*left.shape[:3], planes)
    return lookup(left, right, disparity_px, groups)


class _Match(torch.autograd.Function):
    """The kernel as a differentiable function; products are float32 inside and of the features' type outside."""

    @staticmethod
    def forward(ctx: Any, left: Tensor, right: Tensor, disparity_px: Tensor, groups: int) -> Tensor:
        ctx.save_for_backward(left, right, disparity_px)
        out = torch.empty(*disparity_px.shape, groups)
        _match(left, right, disparity_px, groups, out)
        return out.to(left.dtype)

    @staticmethod
    def backward(ctx: Any, *d_out: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:
        from priors.kernels import lookup as kernels

        left, right, disparity_px = ctx.saved_tensors
        rows = [_rows(t) for t in (left, right, disparity_px)]
        d_left, d_right = torch.zeros(left.shape), torch.zeros(right.shape)
        d_disparity = torch.empty(disparity_px.shape)
        kernels.match_backward(*rows, _rows(d_out[0]), *(_rows(t) for t in (d_left, d_right, d_disparity)))
        return d_left.to(left.dtype), d_right.to(right.dtype), d_disparity.to(disparity_px.dtype), None


def _match(left: Tensor, right: Tensor, disparity_px: Tensor, groups: int, out: Tensor) -> None:
    """Write matches into out (b, h, w, planes, groups), float32, its first three dimensions dense."""
    from priors.kernels import lookup as kernels

    kernels.match(*(_rows(t) for t in (left, right, disparity_px)), groups, out.flatten(0, 1).numpy())


def _rows(tensor: Tensor) -> Any:
    """View (b, h, ...) as a numpy float32 array (b * h, ...)."""
    plain = tensor.detach().float().contiguous()
    return plain.view(-1, *plain.shape[2:]).numpy()
