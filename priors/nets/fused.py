"""Operator fusion for CPUs: convolution, addition and ReLU in one pass over memory (oneDNN's post-operations).

A ReLU or an addition on its own costs half of what a small convolution does: it is bound by memory. The operators are
those that torch's own compiler emits, so they need no compiler on the machine; where a torch build lacks them, or on
another device, the network stays as it is.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, TypeGuard, TypeVar

import torch
from torch import Tensor, nn

from priors.machine import threads
from priors.nets.blocks import Exact, Residual, UpsampleConv, bias_of, conv3d_of, conv_of
from priors.nets.int8 import ActivationRange, IntegerConv
from priors.nets.tensors import as_bits

Net = TypeVar("Net", bound=nn.Module)
AFTER: dict[type[nn.Module], Callable[[Any], tuple[str, list[float]]]] = {
    nn.ReLU: lambda layer: ("relu", []),
    nn.ReLU6: lambda layer: ("hardtanh", [0.0, 6.0]),
    nn.LeakyReLU: lambda layer: ("leaky_relu", [layer.negative_slope]),
}
"""What can follow a convolution in the same pass: oneDNN's name and numbers."""


def fuse(net: Net) -> Net:
    """Replace folded convolution + ReLU pairs (2D, 3D) and blocks made of them, in place; folded and cast before.

    The result computes the same up to the rounding of what is no longer rounded in between; it cannot be trained,
    moved or exported.
    """
    kinds = {p.dtype for p in net.parameters() if p.is_floating_point()}
    if not all(available(kind) for kind in kinds):
        return net
    for name, child in list(net.named_children()):
        if isinstance(child, FUSED):
            continue
        if isinstance(child, Exact):
            setattr(net, name, FusedExact(child))
        elif isinstance(child, UpsampleConv):
            setattr(net, name, FusedUpsampleConv(child))
        elif isinstance(child, Residual):
            setattr(net, name, FusedResidual(child))
        elif _is_planar(child):
            setattr(net, name, FusedPlanes(child))
        elif isinstance(child, nn.Sequential) and _is_pair(child):
            setattr(net, name, _quick(conv_of(child), child[-1]))
        elif isinstance(child, nn.ModuleList | nn.Sequential) or len(list(child.children())):
            fuse(child)
    return net


@cache
def available(kind: torch.dtype = torch.float32) -> bool:
    """Tell whether this torch has the operators and this CPU can run them on numbers of a kind."""
    try:
        x = torch.zeros(1, 16, 4, 4, dtype=kind).to(memory_format=torch.channels_last)
        FusedConv(nn.Conv2d(16, 16, 3, padding=1).requires_grad_(False).to(kind), nn.ReLU())(x)
    except (RuntimeError, AttributeError):
        return False
    return True


class FusedConv(nn.Module):
    """A convolution (plus a given map) and what follows it, weights laid out for this machine once."""

    def __init__(self, conv: nn.Conv2d | nn.Conv3d, after: nn.Module | None = None) -> None:
        """Take a convolution and what follows it: a ReLU, ReLU6, LeakyReLU or nothing."""
        super().__init__()
        self.groups = conv.groups
        self.after = _post_operation(after)
        self.padding, self.stride, self.dilation = (
            list(map(int, p)) for p in (conv.padding, conv.stride, conv.dilation)
        )
        weight = conv.weight.detach()
        self.weight = torch.ops.mkldnn._reorder_convolution_weight(
            weight, self.padding, self.stride, self.dilation, conv.groups, None
        )
        self.bias = None if conv.bias is None else conv.bias.detach()

    def forward(self, x: Tensor, plus: Tensor | None = None) -> Tensor:
        """Return after(conv(x) + plus), (b, channels, ...)."""
        shape = self.padding, self.stride, self.dilation, self.groups
        run = torch.ops.mkldnn._convolution_pointwise
        if plus is None:
            return run(x, self.weight, self.bias, *shape, *(self.after or ("none", [])), "")
        return run.binary(x, plus, self.weight, self.bias, *shape, "add", 1.0, *(self.after or (None, [])), "")


class FusedPlanes(nn.Module):
    """A 3D convolution to one channel as a 2D one, from all channels of all planes to one value a plane.

    A volume lies in memory as the 2D one reads it, and the zeros between distant planes cost less than a matrix unit
    that works for a single channel: it takes a third of the time.
    """

    def __init__(self, conv: nn.Conv3d) -> None:
        super().__init__()
        self.conv = conv
        self._layers: dict[int, FusedConv] = {}

    def forward(self, x: Tensor, plus: Tensor | None = None) -> Tensor:
        """Return conv(x) + plus: (b, channels, h, w, planes) -> (b, 1, h, w, planes)."""
        batch, channels, height, width, planes = x.shape
        if planes not in self._layers:
            self._layers[planes] = FusedConv(spread_over_planes(self.conv, planes))
        flat = x.permute(0, 2, 3, 4, 1).reshape(batch, height, width, planes * channels).permute(0, 3, 1, 2)
        given = None if plus is None else plus[:, 0].permute(0, 3, 1, 2)
        planes_out: Tensor = self._layers[planes](flat, given)
        return planes_out.permute(0, 2, 3, 1)[:, None]


def spread_over_planes(conv: nn.Conv3d, planes: int) -> nn.Conv2d:
    """Return the 2D convolution (b, planes * channels, h, w) -> (b, planes, h, w) that a 3D one to one channel is.

    The channels vary fastest; a plane sees its own, the one before and the one after.
    """
    kernel, (rows, columns, _) = conv.weight.detach()[0], conv.kernel_size
    weight = kernel.new_zeros(planes, planes, conv.in_channels, rows, columns)
    for there in range(planes):
        for here in range(max(0, there - 1), min(planes, there + 2)):
            weight[there, here] = kernel[..., here - there + 1]
    padding = (int(conv.padding[0]), int(conv.padding[1]))
    flat = nn.Conv2d(planes * conv.in_channels, planes, (rows, columns), padding=padding).to(weight.dtype)
    flat.weight.data = weight.flatten(1, 2).contiguous(memory_format=torch.channels_last)
    if conv.bias is None:
        flat.bias = None
    else:
        bias_of(flat).data = conv.bias.detach().expand(planes).clone()
    return flat


class FusedResidual(nn.Module):
    """A residual block in two passes over memory."""

    def __init__(self, block: Residual) -> None:
        super().__init__()
        self.first, self.second = (_quick(conv_of(part), nn.ReLU()) for part in (block.first, block.second))

    def forward(self, x: Tensor) -> Tensor:
        """Add what the convolutions find."""
        if isinstance(self.first, IntegerConv) and isinstance(self.second, IntegerConv):
            return self.second(self.first(x, to=self.second.span), x)
        return self.second(self.first(x), x)


class FusedUpsampleConv(nn.Module):
    """A convolution of a repeated volume without repeating it: a third of the products, and a pass that sorts them.

    After repeating, two of a kernel's three neighbours along an axis are one and the same value, so that two numbers
    are left of three, other ones at even places than at odd ones: a 2x2x2 kernel for each of the eight kinds of place.
    """

    def __init__(self, block: UpsampleConv) -> None:
        super().__init__()
        self.conv = FusedConv(split_by_place(conv3d_of(block)), block[-1])

    def forward(self, small: Tensor, plus: Tensor) -> Tensor:
        """Take volumes (b, inputs, h / 2, w / 2, planes / 2) and (b, outputs, h, w, planes)."""
        from priors.kernels import upsample_conv as kernels

        answers, given = (volume.permute(0, 2, 3, 4, 1) for volume in (self.conv(small), plus))
        out = torch.empty(given.shape, dtype=plus.dtype)
        bits = as_bits(given.flatten(0, 1)), as_bits(answers), as_bits(out.flatten(0, 1))
        threads.over(bits[0].shape[0], lambda first, last: kernels.add_interleaved(*bits, first, last))
        return out.permute(0, 4, 1, 2, 3)


def split_by_place(conv: nn.Conv3d) -> nn.Conv3d:
    """Return the 2x2x2 convolution that gives what a 3x3x3 one gives of a repeated volume, for eight kinds of place.

    Of (b, c, h, w, d) it makes (b, 8 * outputs, h + 1, w + 1, d + 1), the kinds varying slowest: even or odd row,
    column, plane. What belongs to the place 2 * (i, j, k) + kind is at (i, j, k) + kind.
    """
    taps = conv.weight.new_tensor([[[1, 0, 0], [0, 1, 1]], [[1, 1, 0], [0, 0, 1]]], dtype=torch.float32)
    weight = torch.einsum("oiabc,pxa,qyb,rzc->pqroixyz", conv.weight.detach().float(), taps, taps, taps)
    layer = nn.Conv3d(conv.in_channels, 8 * conv.out_channels, 2, padding=1).to(conv.weight.dtype)
    weight = weight.flatten(0, 3).to(conv.weight.dtype)
    layer.weight.data = weight.contiguous(memory_format=torch.channels_last_3d)
    bias_of(layer).data = bias_of(conv).detach().repeat(8)
    return layer


class FusedExact(nn.Module):
    """A head whose last layer is as exact as float32 would be, computed twice in bf16, which is faster than once there.

    The second time the first answer is taken off before anything is rounded: what is left is small, and so is its
    rounding error, 2^-17 of the answer. In float32 once is enough.
    """

    def __init__(self, head: Exact) -> None:
        super().__init__()
        first, last = head
        if not (isinstance(first, nn.Sequential) and isinstance(last, nn.Conv2d | nn.Conv3d)):
            raise TypeError(f"{head}: expected a block and a convolution")
        self.first = FusedConv(conv_of(first), first[-1])
        self.last = FusedPlanes(last) if _is_planar(last) else FusedConv(last)

    def forward(self, x: Tensor) -> Tensor:
        """Run both layers; returns float32."""
        x = self.first(x)
        answer: Tensor = self.last(x)
        if answer.dtype == torch.float32:
            return answer
        return answer.float() + self.last(x, -answer).float()


def _quick(conv: nn.Conv2d | nn.Conv3d, after: nn.Module) -> nn.Module:
    """Return a convolution and what follows it in one pass: on 8 bits where int8.mark has noted a range."""
    span = getattr(conv, "span", None)
    if isinstance(span, ActivationRange) and isinstance(conv, nn.Conv2d) and isinstance(after, nn.ReLU):
        return IntegerConv(conv, span)
    return FusedConv(conv, after)


FUSED = (IntegerConv, FusedConv, FusedPlanes, FusedResidual, FusedUpsampleConv, FusedExact)


def _is_pair(sequence: nn.Sequential) -> bool:
    kinds = [type(layer) for layer in sequence if not isinstance(layer, nn.Identity)]
    return len(kinds) == 2 and kinds[0] in (nn.Conv2d, nn.Conv3d) and kinds[1] in AFTER


def _is_planar(layer: nn.Module) -> TypeGuard[nn.Conv3d]:
    """Tell whether a layer is what FusedPlanes takes: a 3D convolution to one channel that keeps the planes."""
    if not isinstance(layer, nn.Conv3d) or layer.out_channels != 1:
        return False
    return layer.kernel_size[2] == 3 and layer.padding[2] == 1 and layer.stride == layer.dilation == (1, 1, 1)


def _post_operation(after: nn.Module | None) -> tuple[str, list[float]] | None:
    """Return oneDNN's name and numbers for what follows a convolution."""
    return None if after is None else AFTER[type(after)](after)
