"""Cost volumes by the fastest way that a device has: fused kernels on CPUs, cost_volume.py in plain torch elsewhere."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from priors.machine import threads
from priors.nets import cost_volume, onnx_matching
from priors.nets.blocks import side_by_side
from priors.nets.onnx_volume import Planes
from priors.nets.tensors import as_bits, is_traced, on_cpu, rows_of_bits, without_gradient


def unit(features: Tensor, groups: int) -> Tensor:
    """Turn features (b, c, h, w) into (b, h, w, c) of unit length; see cost_volume.unit, which this equals.

    Without gradients the result is float32 on CPUs.
    """
    if not without_gradient(features):
        return cost_volume.unit(features, groups)
    from priors.kernels import cost_volume as kernels

    plain = features.permute(0, 2, 3, 1)
    out = torch.empty(plain.shape)
    _over_rows(kernels.units, rows_of_bits(plain), groups, out.flatten(0, 1).numpy())
    return out


def expect(logits: Tensor, position_px: Tensor, window: int | None = None) -> tuple[Tensor, Tensor]:
    """Return mean and deviation of the matching distribution; see cost_volume.expect, which this equals."""
    if is_traced():
        return onnx_matching.expect(logits, position_px, window)
    if not without_gradient(logits):
        return cost_volume.expect(logits, position_px, window)
    from priors.kernels import distribution as kernels

    planes = logits.shape[-1]
    values, positions = as_bits(logits.reshape(-1, planes)), position_px.float().reshape(-1, planes).numpy()
    mean, sigma = torch.empty(logits.shape[:-1]), torch.empty(logits.shape[:-1])
    reach = planes if window is None else window
    work = partial(kernels.expect, values, positions, reach, mean.view(-1).numpy(), sigma.view(-1).numpy())
    threads.over(len(values), work, kernels.STRETCH)
    return mean, sigma


def lookup(
    left: Tensor, right: Tensor, disparity_px: Tensor, groups: int, also: Tensor | None = None
) -> Tensor | Planes:
    """Match features, brought to unit length, at each pixel's own disparities.

    Args:
        left: (b, c, h, w); a group's channels are a power of two.
        right: the same.
        disparity_px: (b, h, w, planes) in pixels of these features; it gets a gradient.
        groups: how many channels of the volume.
        also: (b, h, w, planes), to be told beside the matches.

    Returns:
        (b, groups, h, w, planes), or groups + 1, of the features' type; see cost_volume.unit and .lookup.
    """
    if is_traced():
        maps = onnx_matching.lookup(left, right, disparity_px, groups).unbind(1)
        more = [] if also is None else [also.permute(0, 3, 1, 2).split(1, dim=1)]
        return Planes([torch.cat(parts, dim=1) for parts in zip(maps, *more, strict=True)])
    if not without_gradient(left):
        matches = lookup_units(unit(left, groups), unit(right, groups), disparity_px, groups).to(left.dtype)
        return matches if also is None else torch.cat([matches, also[:, None].to(matches.dtype)], dim=1)
    from priors.kernels import cost_volume as kernels

    out = torch.empty(*disparity_px.shape, groups + (also is not None), dtype=left.dtype)
    told = torch.empty(0, 0, 0) if also is None else also.flatten(0, 1)
    _over_rows(
        kernels.match, *_pair(left, right), _rows(disparity_px), groups, told.numpy(), as_bits(out.flatten(0, 1))
    )
    return out.permute(0, 4, 1, 2, 3)


def lookup_beside(
    before: Sequence[Tensor], left: Tensor, right: Tensor, disparity_px: Tensor, groups: int, after: Sequence[Tensor]
) -> Tensor:
    """Match as `lookup` does, for 2D convolutions: the matches stand between other maps.

    Args:
        before: maps (b, h, w, c), the first one's type is the result's.
        left: features as `lookup` takes them.
        right: the same.
        disparity_px: (b, h, w, planes).
        groups: how many matches a plane has; in the result the planes vary fastest.
        after: maps (b, h, w, c), float32.

    Returns:
        (b, sum of c + groups * planes, h, w), channels-last.
    """
    if is_traced():
        return onnx_matching.lookup_beside(before, left, right, disparity_px, groups, after)
    if not without_gradient(left):
        matches = lookup_units(unit(left, groups), unit(right, groups), disparity_px, groups)
        return side_by_side(*before, matches.permute(0, 2, 3, 1, 4).flatten(3), *after)
    from priors.kernels import cost_volume as kernels

    first = before[0] if len(before) == 1 else torch.cat([map_.to(before[0].dtype) for map_ in before], dim=3)
    behind = torch.cat(list(after), dim=3)
    channels = first.shape[3] + groups * disparity_px.shape[3] + behind.shape[3]
    out = torch.empty(*first.shape[:3], channels, dtype=first.dtype)
    rows = rows_of_bits(first), *_pair(left, right), _rows(disparity_px)
    _over_rows(kernels.match_beside, *rows, groups, _rows(behind), as_bits(out.flatten(0, 1)))
    return out.permute(0, 3, 1, 2)


def correlate(left: Tensor, right: Tensor, groups: int, planes: int) -> Tensor | Planes:
    """Match at disparities 0 .. planes - 1: (b, groups, h, w, planes), as `lookup` does."""
    if is_traced():
        return onnx_matching.correlate(left, right, groups, planes)
    if not on_cpu(left):
        return cost_volume.correlate(cost_volume.unit(left, groups), cost_volume.unit(right, groups), groups, planes)
    batch, _, height, width = left.shape
    disparity_px = torch.arange(planes, dtype=torch.float32).expand(batch, height, width, planes)
    return lookup(left, right, disparity_px, groups)


def concatenate(left: Tensor, right: Tensor, planes: int) -> Tensor | Planes:
    """Put both views' features side by side; see cost_volume.concatenate, which this equals."""
    return (onnx_matching if is_traced() else cost_volume).concatenate(left, right, planes)


def lookup_units(left: Tensor, right: Tensor, disparity_px: Tensor, groups: int) -> Tensor:
    """Match unit features (b, h, w, c) with gradients, or on a GPU, or for export; see cost_volume.lookup."""
    if not on_cpu(left):
        return cost_volume.lookup(left, right, disparity_px, groups)
    matches: Tensor = _Match.apply(left, right, disparity_px, groups)
    return matches.permute(0, 4, 1, 2, 3)


def _pair(left: Tensor, right: Tensor) -> tuple[Any, Any]:
    """View features (b, c, h, w) as rows of bits (b * h, w, c)."""
    return rows_of_bits(left.permute(0, 2, 3, 1)), rows_of_bits(right.permute(0, 2, 3, 1))


class _Match(torch.autograd.Function):
    """The kernel as a differentiable function; products are float32 inside and of the features' type outside."""

    @staticmethod
    def forward(ctx: Any, left: Tensor, right: Tensor, disparity_px: Tensor, groups: int) -> Tensor:
        ctx.save_for_backward(left, right, disparity_px)
        from priors.kernels import cost_volume_gradient as kernels

        out = torch.empty(*disparity_px.shape, groups)
        rows = [_rows(t) for t in (left, right, disparity_px)]
        _over_rows(kernels.match, *rows, groups, out.flatten(0, 1).numpy())
        return out.to(left.dtype)

    @staticmethod
    def backward(ctx: Any, *d_out: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:
        from priors.kernels import cost_volume_gradient as kernels

        left, right, disparity_px = ctx.saved_tensors
        rows = [_rows(t) for t in (left, right, disparity_px)]
        d_left, d_right = torch.zeros(left.shape), torch.zeros(right.shape)
        d_disparity = torch.empty(disparity_px.shape)
        _over_rows(kernels.match_backward, *rows, _rows(d_out[0]), *(_rows(t) for t in (d_left, d_right, d_disparity)))
        return d_left.to(left.dtype), d_right.to(right.dtype), d_disparity.to(disparity_px.dtype), None


def _over_rows(kernel: Any, *arrays: Any) -> None:
    """Run a kernel over the rows of its arrays, the last of which is the largest or as large as any."""
    rows = arrays[-1]
    threads.over(len(rows), partial(kernel, *arrays), threads.worth(arrays[0][:1].size + rows[:1].size))


def _rows(tensor: Tensor) -> Any:
    """View (b, h, ...) as a numpy float32 array (b * h, ...)."""
    plain = tensor.detach().float().contiguous()
    return plain.view(-1, *plain.shape[2:]).numpy()
