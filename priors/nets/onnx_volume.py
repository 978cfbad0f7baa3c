"""3D convolutions for ONNX export: a volume is a list of planes, for onnxruntime convolves maps fast, volumes slowly.

Its 3D convolution copies every neighbourhood into a matrix first, its 2D one does not. A 3x3x3 convolution is three 3x3
ones a plane, added up, which onnxruntime does in the layout that suits it from the first to the last; and a repeated
volume needs two of them, not three.
"""

from collections.abc import Iterator, Sequence
from copy import deepcopy
from typing import TypeVar

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from priors.nets.blocks import UpsampleConv, bias_of, conv3d_of
from priors.types import FloatMap

Net = TypeVar("Net", bound=nn.Module)
TAPS = (-1, 0, 1)
"""Planes that a kernel looks at, beside the one in its middle."""


class Planes:
    """A volume (b, c, h, w, planes) as one map (b, c, h, w) a plane."""

    def __init__(self, maps: Sequence[Tensor]) -> None:
        self.maps = list(maps)

    def __len__(self) -> int:
        return len(self.maps)

    def __iter__(self) -> Iterator[Tensor]:
        return iter(self.maps)


def beside(first: Tensor | Planes, second: Tensor | Planes) -> Tensor | Planes:
    """Join the channels of two volumes."""
    if isinstance(first, Planes) and isinstance(second, Planes):
        return Planes([torch.cat(pair, dim=1) for pair in zip(first, second, strict=True)])
    if isinstance(first, Tensor) and isinstance(second, Tensor):
        return torch.cat([first, second], dim=1)
    raise TypeError(f"expected two volumes of one kind, not {type(first).__name__} and {type(second).__name__}")


def weigh(volume: Tensor | Planes, weights: Tensor) -> Tensor | Planes:
    """Multiply every plane of a volume by weights (b, c, h, w)."""
    if isinstance(volume, Planes):
        return Planes([map_ * weights for map_ in volume])
    return volume * weights[..., None]


def portable(net: Net) -> Net:
    """Return a copy of a folded network whose 3D layers take and give `Planes`."""
    net = deepcopy(net)
    _replace(net)
    return net


def _replace(net: nn.Module) -> None:
    for name, child in list(net.named_children()):
        if isinstance(child, UpsampleConv):
            setattr(net, name, PlaneUpsampleConv(child))
        elif isinstance(child, nn.Sequential) and isinstance(child[-1], nn.Conv3d):
            setattr(net, name, PlaneHead(child))
        elif isinstance(child, nn.Sequential) and isinstance(child[0], nn.Conv3d):
            setattr(net, name, _layers(child))
        else:
            _replace(child)


def _layers(layers: nn.Sequential) -> nn.Module:
    """Return a sequence's twin: convolution + ReLU; or more of them, the last one possibly to a single channel."""
    steps = [layer for layer in layers if not isinstance(layer, nn.Identity)]
    if isinstance(steps[-1], nn.ReLU) and len(steps) == 2 and isinstance(steps[0], nn.Conv3d):
        return PlaneConv(steps[0])
    raise TypeError(f"no twin for {layers}")


class PlaneConv(nn.Module):
    """A 3x3x3 convolution, of stride 1 or 2, and a ReLU."""

    def __init__(self, conv: nn.Conv3d) -> None:
        super().__init__()
        if not (conv.kernel_size == (3, 3, 3) and conv.padding == conv.dilation == (1, 1, 1)):
            raise TypeError(f"no twin for {conv}")
        self.stride = int(conv.stride[0])
        self.taps = nn.ModuleList(flat(conv, conv.weight[..., k], with_bias=k == 1) for k in range(3))

    def forward(self, volume: Planes) -> Planes:
        """Convolve."""
        out = []
        for middle in range(0, len(volume), self.stride):
            total = self.taps[1](volume.maps[middle])
            for tap in (0, 2):
                if 0 <= middle + TAPS[tap] < len(volume):
                    total = total + self.taps[tap](volume.maps[middle + TAPS[tap]])
            out.append(torch.relu(total))
        return Planes(out)


class PlaneUpsampleConv(nn.Module):
    """A convolution of a repeated volume, on top of another: see blocks.UpsampleConv."""

    def __init__(self, block: UpsampleConv) -> None:
        super().__init__()
        conv = conv3d_of(block)
        if not (conv.kernel_size == (3, 3, 3) and conv.stride == (1, 1, 1)):
            raise TypeError(f"no twin for {conv}")
        before, here, after = conv.weight.unbind(dim=4)
        self.near = nn.ModuleList(flat(conv, weight, with_bias=True) for weight in (here + after, before + here))
        self.far = nn.ModuleList(flat(conv, weight, with_bias=False) for weight in (before, after))

    def forward(self, small: Planes, plus: Planes) -> Planes:
        """UpsampleConv."""
        repeated = [F.interpolate(map_, scale_factor=2.0, mode="nearest") for map_ in small]
        out = []
        for index, above in enumerate(plus):
            middle, odd = divmod(index, 2)
            total = self.near[odd](repeated[middle])
            neighbour = middle + (1 if odd else -1)
            if 0 <= neighbour < len(repeated):
                total = total + self.far[odd](repeated[neighbour])
            out.append(above + torch.relu(total))
        return Planes(out)


class PlaneHead(nn.Module):
    """A convolution + ReLU and one to a single channel, which is one 2D convolution over all planes' channels."""

    def __init__(self, head: nn.Sequential) -> None:
        super().__init__()
        first, last = head
        if not (isinstance(first, nn.Sequential) and isinstance(last, nn.Conv3d) and last.kernel_size == (3, 3, 3)):
            raise TypeError(f"no twin for {head}")
        if last.out_channels != 1:
            raise TypeError(f"no twin for {last}: expected one channel")
        self.first = _layers(first)
        self.kernel, self.bias = last.weight[0].float().numpy(), bias_of(last).float().numpy()

    def forward(self, volume: Planes) -> Tensor:
        """Return (b, 1, h, w, planes)."""
        volume = self.first(volume)
        weight = torch.from_numpy(to_2d_kernel(self.kernel, len(volume)))  # numpy's steps are not written down
        bias = torch.from_numpy(np.repeat(self.bias, len(volume)))
        return F.conv2d(torch.cat(volume.maps, dim=1), weight, bias, padding=1).permute(0, 2, 3, 1)[:, None]


def to_2d_kernel(kernel: FloatMap, planes: int) -> FloatMap:
    """Return the 2D kernel (planes, planes * c, 3, 3) of a 3D one (c, 3, 3, 3): see fused.spread_over_planes."""
    weight = np.zeros((planes, planes, *kernel.shape[:3]), np.float32)
    for there in range(planes):
        for here in range(max(0, there - 1), min(planes, there + 2)):
            weight[there, here] = kernel[..., here - there + 1]
    return weight.reshape(planes, -1, *kernel.shape[1:3])


def flat(conv: nn.Conv3d, weight: Tensor, *, with_bias: bool) -> nn.Conv2d:
    """Return the 2D convolution of a 3D one's stride, with a weight (outputs, inputs, 3, 3) of its own."""
    layer = nn.Conv2d(conv.in_channels, conv.out_channels, 3, int(conv.stride[0]), 1, bias=with_bias)
    layer.weight.data = weight.detach().clone()
    if with_bias:
        bias_of(layer).data = bias_of(conv).detach().clone()
    return layer.requires_grad_(False)
