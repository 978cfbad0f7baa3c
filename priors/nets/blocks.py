"""Building blocks: dense 3x3 convolutions with batch normalisation, which folds away before inference.

Dense convolutions are what CPUs with matrix units do at 250 to 1500 GMAC/s; depthwise ones and other normalisations
run at a tenth of that (docs/benchmarks.md).
"""

from typing import TypeVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

Net = TypeVar("Net", bound=nn.Module)


def conv(inputs: int, outputs: int, kernel: int = 3, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    """Return convolution, batch normalisation, ReLU over (b, inputs, h, w)."""
    padding = dilation * (kernel // 2)
    layer = nn.Conv2d(inputs, outputs, kernel, stride, padding, dilation, bias=False)
    return nn.Sequential(layer, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


def conv3d(inputs: int, outputs: int, kernel: int = 3, stride: int = 1) -> nn.Sequential:
    """Return convolution, batch normalisation, ReLU over (b, inputs, planes, h, w)."""
    layer = nn.Conv3d(inputs, outputs, kernel, stride, kernel // 2, bias=False)
    return nn.Sequential(layer, nn.BatchNorm3d(outputs), nn.ReLU(inplace=True))


class Residual(nn.Module):
    """Two 3x3 convolutions around a skip: (b, channels, h, w) in and out."""

    def __init__(self, channels: int, dilation: int = 1) -> None:
        super().__init__()
        self.first = conv(channels, channels, dilation=dilation)
        second = conv(channels, channels, dilation=dilation)
        self.second = nn.Sequential(second[0], second[1])

    def forward(self, x: Tensor) -> Tensor:
        """Add what the convolutions find."""
        return torch.relu(x + self.second(self.first(x)))


class Exact(nn.Sequential):
    """A head of two layers, the last one in float32 whatever its weights' type; returns float32.

    Rounded to eight bits, a logarithm would be a percent of depth, and a logit would choose another surface.
    """

    def forward(self, x: Tensor) -> Tensor:
        """Run both."""
        first, last = self
        if not isinstance(last, nn.Conv2d | nn.Conv3d):
            raise TypeError(f"{last}: expected a convolution as the last layer")
        run = F.conv2d if isinstance(last, nn.Conv2d) else F.conv3d
        values = first(x).float(), last.weight.float(), bias_of(last).float()
        return run(*values, last.stride, last.padding, last.dilation)


class UpsampleConv(nn.Sequential):
    """A 3D convolution of a volume of half the size, repeated to full size, on top of one of full size.

    Repeating first and convolving then is how it was learned; fused.py and onnx_volume.py know quicker ways.
    """

    def forward(self, small: Tensor, plus: Tensor) -> Tensor:  # type: ignore[override]
        """Take volumes (b, inputs, h / 2, w / 2, planes / 2) and (b, outputs, h, w, planes)."""
        return plus + super().forward(F.interpolate(small, scale_factor=2.0, mode="nearest"))


def conv_of(sequence: nn.Sequential) -> nn.Conv2d | nn.Conv3d:
    """Return the convolution that a sequence begins with; TypeError where it begins with something else."""
    first = sequence[0]
    if not isinstance(first, nn.Conv2d | nn.Conv3d):
        raise TypeError(f"{sequence}: expected a convolution as the first layer")
    return first


def conv3d_of(sequence: nn.Sequential) -> nn.Conv3d:
    """Return the 3D convolution that a sequence begins with; TypeError where it begins with something else."""
    first = sequence[0]
    if not isinstance(first, nn.Conv3d):
        raise TypeError(f"{sequence}: expected a 3D convolution as the first layer")
    return first


def bias_of(layer: nn.Conv2d | nn.Conv3d) -> Tensor:
    """Return a convolution's bias; TypeError where it has none, as before `fold`."""
    if layer.bias is None:
        raise TypeError(f"{layer}: expected a bias: fold the network first")
    return layer.bias


def both(x: Tensor, first: nn.Conv2d, second: nn.Conv2d) -> tuple[Tensor, Tensor]:
    """Run two layers of one shape but for their outputs, (b, c, h, w) each, in one pass over what they look at.

    A head of one channel takes a CPU as long as one of sixteen.
    """
    weight, bias = torch.cat([first.weight, second.weight]), torch.cat([bias_of(first), bias_of(second)])
    if x.device.type == "cpu":
        weight = weight.contiguous(memory_format=torch.channels_last)
    joint = F.conv2d(x, weight, bias, first.stride, first.padding, first.dilation)
    a, b = joint.split([first.out_channels, second.out_channels], dim=1)
    return a, b


def side_by_side(first: Tensor, *others: Tensor) -> Tensor:
    """Join maps (b, h, w, c) to (b, sum of c, h, w), channels-last, of the first one's type.

    Joined in this layout every pixel is a few short copies; across layouts torch would transpose everything, twice.
    """
    return torch.cat([first, *(other.to(first.dtype) for other in others)], dim=3).permute(0, 3, 1, 2)


def fold(net: Net) -> Net:
    """Merge every batch normalisation into the convolution before it, in place; the network must be in eval mode.

    The result computes the same up to rounding, and cannot be trained further.
    """
    for module in net.modules():
        if isinstance(module, nn.Sequential):
            _fold_sequence(module)
    return net


def _fold_sequence(sequence: nn.Sequential) -> None:
    for index in range(len(sequence) - 1):
        layer, norm = sequence[index], sequence[index + 1]
        if isinstance(layer, nn.Conv2d | nn.Conv3d) and isinstance(norm, nn.BatchNorm2d | nn.BatchNorm3d):
            sequence[index] = fuse_conv_bn_eval(layer, norm)
            sequence[index + 1] = nn.Identity()


def channels_last(net: Net) -> Net:
    """Store convolution weights, in place, the way that makes them run fast on CPUs: channels fastest."""
    for module in net.modules():
        if isinstance(module, nn.Conv2d | nn.Conv3d):
            layout = torch.channels_last if module.weight.ndim == 4 else torch.channels_last_3d
            module.weight.data = module.weight.data.contiguous(memory_format=layout)
    return net
