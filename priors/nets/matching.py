"""Matching features at given disparities: one fused kernel on CPUs, plain torch on GPUs and for export."""

from typing import Any

import torch
from torch import Tensor

from priors.nets import volume
from priors.nets.upsample import is_traced


def lookup(left: Tensor, right: Tensor, disparity_px: Tensor, groups: int) -> Tensor:
    """Match at each pixel's own disparities; see volume.lookup, which this equals."""
    if left.device.type != "cpu" or is_traced():
        return volume.lookup(left, right, disparity_px, groups)
    found: Tensor = _Match.apply(left, right, disparity_px, groups)
    return found.permute(0, 4, 1, 2, 3)


def correlate(left: Tensor, right: Tensor, groups: int, planes: int) -> Tensor:
    """Match at disparities 0 .. planes - 1; see volume.correlate, which this equals."""
    if left.device.type != "cpu" or is_traced():
        return volume.correlate(left, right, groups, planes)
    disparity_px = torch.arange(planes, dtype=torch.float32).expand(*left.shape[:3], planes)
    return lookup(left, right, disparity_px, groups)


class _Match(torch.autograd.Function):
    """The kernel as a differentiable function; products are float32 inside and of the features' type outside."""

    @staticmethod
    def forward(ctx: Any, left: Tensor, right: Tensor, disparity_px: Tensor, groups: int) -> Tensor:
        from priors.kernels import lookup as kernels

        ctx.save_for_backward(left, right, disparity_px)
        batch, height, width, _ = left.shape
        planes = disparity_px.shape[3]
        out = torch.empty(batch * height, width, planes, groups)
        kernels.match(*(_rows(t) for t in (left, right, disparity_px)), groups, out.numpy())
        return out.view(batch, height, width, planes, groups).to(left.dtype)

    @staticmethod
    def backward(ctx: Any, *d_out: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:
        from priors.kernels import lookup as kernels

        left, right, disparity_px = ctx.saved_tensors
        rows = [_rows(t) for t in (left, right, disparity_px)]
        d_left, d_right = torch.zeros(left.shape), torch.zeros(right.shape)
        d_disparity = torch.empty(disparity_px.shape)
        kernels.match_backward(*rows, _rows(d_out[0]), *(_rows(t) for t in (d_left, d_right, d_disparity)))
        return d_left.to(left.dtype), d_right.to(right.dtype), d_disparity.to(disparity_px.dtype), None


def _rows(tensor: Tensor) -> Any:
    """View (b, h, ...) as a numpy float32 array (b * h, ...)."""
    plain = tensor.detach().float().contiguous()
    return plain.view(-1, *plain.shape[2:]).numpy()
