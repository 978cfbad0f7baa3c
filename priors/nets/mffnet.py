"""Depth completion after MFFNet (Liu et al., 2023), for CPUs: two modalities, fused by gates at every scale.

An image branch and a depth branch exchange channels at every scale. One decoder follows the depth branch, the other
climbs the gated fusions of both by pixel shuffle; each corrects the pre-fill, and they are mixed with weights that they
predict. What MFFNet spends elsewhere (122 M parameters, full-size layers, a learned pre-fill) is left out.
"""

from dataclasses import dataclass
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from priors.errors import DataError
from priors.nets.blocks import Residual, conv
from priors.nets.trunk import normalise, pad

SIZES: dict[str, tuple[int, ...]] = {"s": (16, 32, 48, 64, 96), "m": (16, 48, 64, 96, 128)}
"""Channels at 1/2, 1/4, 1/8, 1/16 and 1/32 of the image."""
LARGEST_CHANGE = 3.0
"""The correction's bound, in e-folds of depth: 20 times nearer or farther."""
SMALLEST_SCALE, LARGEST_SCALE = -7.0, 1.0
"""Bounds of the logarithm of the predicted scale."""


@dataclass(frozen=True, slots=True)
class Completed:
    """What the network says about every pixel, float32."""

    depth_m: Tensor
    """(b, h, w) in the pre-fill's unit."""
    log_scale: Tensor
    """(b, h, w) natural logarithm of the expected absolute error as a share of the depth (a Laplace scale)."""
    branches_m: tuple[Tensor, ...]
    """The two outputs before mixing, each (b, h, w): for the losses; empty in eval mode."""


class MffNet(nn.Module):
    """Corrects a filled depth map with the image and the samples that it was filled from."""

    def __init__(self, channels: tuple[int, ...] = SIZES["m"]) -> None:
        super().__init__()
        self.channels = channels
        finest = channels[0]
        self.image_stem, self.depth_stem = _stem(3, finest), _stem(4, finest)
        steps = list(pairwise(channels))
        self.image_down = nn.ModuleList(nn.Sequential(conv(a, b, stride=2), Residual(b)) for a, b in steps)
        self.depth_down = nn.ModuleList(nn.Sequential(conv(a, b, stride=2), Residual(b)) for a, b in steps)
        self.fuse = nn.ModuleList(Fuse(c) for c in channels[1:])
        self.lower = nn.ModuleList(conv(b, a, 1) for a, b in steps)
        self.up = nn.ModuleList(conv((3 if a == finest else 2) * a, a) for a in channels[:-1])
        self.ladder = nn.ModuleList(conv((2 if a == finest else 1) * a + b // 4, a) for a, b in steps)
        self.heads = nn.ModuleList([_head(finest), _head(finest)])

    def forward(self, image: Tensor, fill_m: Tensor, certain: Tensor, sparse_m: Tensor) -> Completed:
        """Correct a pre-fill.

        Args:
            image: (b, 3, h, w) in [0, 1].
            fill_m: (b, h, w) the pre-fill, > 0 everywhere; any unit and range: only its ratios are looked at.
            certain: (b, h, w) the pre-fill's confidence in [0, 1].
            sparse_m: (b, h, w) the samples, 0 = none.

        Returns:
            Depth within e^LARGEST_CHANGE of the pre-fill's, and its expected error.
        """
        height, width = image.shape[-2:]
        kind = next(self.parameters()).dtype
        log_fill = fill_m.float().log()
        mean = log_fill.mean(dim=(1, 2), keepdim=True)
        there = sparse_m > 0
        against = torch.where(there, sparse_m.float().clamp_min(1e-6).log() - log_fill, 0.0)  # what the fill left out
        depth = torch.stack([log_fill - mean, certain.float(), there.float(), 4 * against], dim=1)
        layout = torch.channels_last
        image = pad(normalise(image)).to(kind, memory_format=layout)
        depth = pad(depth).to(kind, memory_format=layout)
        first, second = self._decode(*self._encode(image, depth))
        weight = torch.sigmoid(first[:, 8:] - second[:, 8:])
        mixed = torch.lerp(second[:, :8], first[:, :8], weight.repeat(1, 2, 1, 1))

        def correct(raw: Tensor) -> Tensor:
            change = F.pixel_shuffle(raw[:, :4], 2)[:, 0, :height, :width].float()
            return torch.exp(log_fill + change.clamp(-LARGEST_CHANGE, LARGEST_CHANGE))

        log_scale = F.pixel_shuffle(mixed[:, 4:], 2)[:, 0, :height, :width].float() - 3.5
        branches = (correct(first), correct(second)) if self.training else ()
        return Completed(correct(mixed), log_scale.clamp(SMALLEST_SCALE, LARGEST_SCALE), branches)

    def _encode(self, image: Tensor, depth: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """Return both modalities' features at every scale, finest first, channels exchanged."""
        seen, measured = self.image_stem(image), self.depth_stem(depth)
        images, depths = [seen], [measured]
        for image_down, depth_down in zip(self.image_down, self.depth_down, strict=True):
            seen, measured = exchange(image_down(seen), depth_down(measured))
            images.append(seen)
            depths.append(measured)
        return images, depths

    def _decode(self, images: list[Tensor], depths: list[Tensor]) -> tuple[Tensor, Tensor]:
        """Return both branches' outputs (b, 12, h/2, w/2): changes, scales and mixing weights of 2x2 pixels each."""
        fused = [fuse(a, b) for fuse, a, b in zip(self.fuse, images[1:], depths[1:], strict=True)]
        first = second = fused[-1]
        for level in range(len(self.channels) - 2, -1, -1):
            above = F.interpolate(self.lower[level](first), scale_factor=2.0, mode="nearest")
            climbed = F.pixel_shuffle(second, 2)
            if level:
                first = self.up[level](torch.cat([above, depths[level]], dim=1))
                second = self.ladder[level](torch.cat([climbed, fused[level - 1]], dim=1))
            else:  # a gate at 1/2 would cost as much as all the others
                first = self.up[0](torch.cat([above, depths[0], images[0]], dim=1))
                second = self.ladder[0](torch.cat([climbed, depths[0], images[0]], dim=1))
        return self.heads[0](first), self.heads[1](second)


class Fuse(nn.Module):
    """Gates two modalities by what both say together: (b, channels, h, w) each, in and out."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.joint = conv(2 * channels, channels)
        self.gates = nn.Conv2d(channels, 2 * channels, 1)

    def forward(self, image: Tensor, depth: Tensor) -> Tensor:
        """Fuse."""
        joint = self.joint(torch.cat([image, depth], dim=1))
        of_image, of_depth = torch.sigmoid(self.gates(joint)).chunk(2, dim=1)
        return joint + of_image * image + of_depth * depth


def exchange(image: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
    """Swap the second half of the channels of two modalities (b, c, h, w)."""
    half = image.shape[1] // 2
    return torch.cat([image[:, :half], depth[:, half:]], 1), torch.cat([depth[:, :half], image[:, half:]], 1)


def _stem(inputs: int, outputs: int) -> nn.Sequential:
    """Return layers from full size to 1/2; the first is a pixel-unshuffle and a 1x1 convolution in one."""
    first = nn.Sequential(nn.Conv2d(inputs, outputs, 2, 2, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))
    return nn.Sequential(first, conv(outputs, outputs))


def _head(channels: int) -> nn.Sequential:
    last = nn.Conv2d(channels, 12, 3, padding=1)
    nn.init.zeros_(last.weight)  # the pre-fill is where training starts
    assert last.bias is not None
    nn.init.zeros_(last.bias)
    return nn.Sequential(conv(channels, channels), last)


def create(size: str) -> MffNet:
    """Make the network in a size of SIZES, with fresh weights; DataError for another size."""
    if size not in SIZES:
        raise DataError(f"mffnet has sizes {', '.join(SIZES)}, not {size}")
    return MffNet(SIZES[size])
