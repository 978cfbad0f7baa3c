"""Inference on CPUs: convolution, addition and ReLU in one pass over memory (oneDNN's post-operations).

A ReLU or an addition on its own costs half of what a small convolution does: it is bound by memory. The operators are
those that torch's own compiler emits, so they need no compiler on the machine; where a torch build lacks them, or on
another device, the network stays as it is.
"""

from typing import TypeVar

import torch
from torch import Tensor, nn

from priors.nets.blocks import Residual

Net = TypeVar("Net", bound=nn.Module)


def fuse(net: Net) -> Net:
    """Replace folded convolution + ReLU pairs (2D, 3D) and Residual blocks, in place; folded and cast before.

    The result computes the same up to the rounding of what is no longer rounded in between; it cannot be trained,
    moved or exported.
    """
    if not available():
        return net
    for name, child in list(net.named_children()):
        if isinstance(child, Residual):
            setattr(net, name, FusedResidual(child))
        elif isinstance(child, nn.Sequential) and _is_pair(child):
            setattr(net, name, FusedConv(_conv_of(child), 6.0 if isinstance(child[-1], nn.ReLU6) else None))
        elif isinstance(child, nn.ModuleList | nn.Sequential) or len(list(child.children())):
            fuse(child)
    return net


def available() -> bool:
    """Tell whether this torch has the operators and can run them."""
    try:
        x = torch.zeros(1, 16, 4, 4).to(memory_format=torch.channels_last)
        FusedConv(nn.Conv2d(16, 16, 3, padding=1))(x)
    except (RuntimeError, AttributeError):
        return False
    return True


class FusedConv(nn.Module):
    """ReLU of a convolution (of a convolution plus a given map), weights laid out for this machine once."""

    def __init__(self, conv: nn.Conv2d | nn.Conv3d, most: float | None = None) -> None:
        """Take a convolution, and where the ReLU ends: 6 for a ReLU6."""
        super().__init__()
        self.groups, self.bound = conv.groups, ("relu", []) if most is None else ("hardtanh", [0.0, most])
        self.padding, self.stride, self.dilation = (
            list(map(int, p)) for p in (conv.padding, conv.stride, conv.dilation)
        )
        weight = conv.weight.detach()
        self.weight = torch.ops.mkldnn._reorder_convolution_weight(
            weight, self.padding, self.stride, self.dilation, conv.groups, None
        )
        self.bias = None if conv.bias is None else conv.bias.detach()

    def forward(self, x: Tensor, plus: Tensor | None = None) -> Tensor:
        """Return relu(conv(x) + plus), (b, channels, ...)."""
        shape = self.padding, self.stride, self.dilation, self.groups
        if plus is None:
            return torch.ops.mkldnn._convolution_pointwise(x, self.weight, self.bias, *shape, *self.bound, "")
        run = torch.ops.mkldnn._convolution_pointwise.binary
        return run(x, plus, self.weight, self.bias, *shape, "add", 1.0, *self.bound, "")


class FusedResidual(nn.Module):
    """A residual block in two passes over memory."""

    def __init__(self, block: Residual) -> None:
        super().__init__()
        self.first, self.second = FusedConv(_conv_of(block.first)), FusedConv(_conv_of(block.second))

    def forward(self, x: Tensor) -> Tensor:
        """Add what the convolutions find."""
        return self.second(self.first(x), x)


def _is_pair(sequence: nn.Sequential) -> bool:
    kinds = [type(layer) for layer in sequence if not isinstance(layer, nn.Identity)]
    return kinds in ([nn.Conv2d, nn.ReLU], [nn.Conv2d, nn.ReLU6], [nn.Conv3d, nn.ReLU])


def _conv_of(sequence: nn.Sequential) -> nn.Conv2d | nn.Conv3d:
    first = sequence[0]
    assert isinstance(first, nn.Conv2d | nn.Conv3d)
    return first
