"""Depth completion after MFFNet (Liu et al., 2023), for CPUs: two modalities, fused by gates at every scale.

An image branch and a depth branch exchange channels at every scale. One decoder follows the depth branch, the other
climbs the gated fusions of both by pixel shuffle; each ends in a correction of the pre-fill, and the two are mixed by a
predicted weight. What MFFNet spends elsewhere (122 M parameters, full-size layers, a learned pre-fill) is left out, and
memory traffic is kept low: at 1/2 of the image's size a copy costs as much as a convolution at 1/4.
"""

from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from priors.errors import DataError
from priors.machine import threads
from priors.nets.blocks import Residual, bias_of, conv
from priors.nets.tensors import as_bits, join, without_gradient
from priors.nets.trunk import normalise, pad

SIZES: dict[str, tuple[int, ...]] = {"s": (16, 32, 48, 64, 96), "m": (16, 48, 64, 96, 128)}
"""Channels at 1/2, 1/4, 1/8, 1/16 and 1/32 of the image."""
LARGEST_CHANGE = 3.0
"""The correction's bound, in e-folds of depth: 20 times nearer or farther."""
FIRST_SCALE, SMALLEST_SCALE, LARGEST_SCALE = -3.5, -7.0, 1.0
"""The logarithm of the predicted scale before training, and its bounds."""


@dataclass(frozen=True, slots=True)
class Completed:
    """What the network says about every pixel, float32."""

    depth_m: Tensor
    """(b, h, w) in the pre-fill's unit."""
    log_scale: Tensor
    """(b, h, w) natural logarithm of the expected absolute error as a share of the depth (a Laplace scale)."""
    branches_m: tuple[Tensor, ...]
    """The two outputs before mixing, each (b, h, w): for the losses; empty in eval mode."""


class Mffnet(nn.Module):
    """Corrects a filled depth map with the image and the samples that it was filled from."""

    def __init__(self, size: str = "m") -> None:
        """Raises DataError for a size that is not in SIZES."""
        super().__init__()
        if size not in SIZES:
            raise DataError(f"mffnet has sizes {', '.join(SIZES)}, not {size}")
        finest, quarter, *_ = self.channels = SIZES[size]
        steps = list(pairwise(self.channels))
        self.image_stem, self.depth_stem = _stem(3, finest), _stem(4, finest)
        self.image_down = nn.ModuleList(nn.Sequential(conv(a, b, stride=2), Residual(b)) for a, b in steps)
        self.depth_down = nn.ModuleList(nn.Sequential(conv(a, b, stride=2), Residual(b)) for a, b in steps)
        self.fuse = nn.ModuleList(Fuse(c) for c in self.channels[1:])
        self.lower = nn.ModuleList(conv(b, a, 1) for a, b in steps)
        self.up = nn.ModuleList(conv(2 * a, a) for a, _ in steps[1:])
        self.ladder = nn.ModuleList(conv(a + b // 4, a) for a, b in steps[1:])
        self.meet = conv(3 * finest + quarter // 4, 2 * finest)
        self.head = nn.Conv2d(2 * finest, 16, 3, padding=1)
        nn.init.zeros_(self.head.weight)  # the pre-fill is where training starts
        nn.init.zeros_(bias_of(self.head))

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
        kind = self.head.weight.dtype
        log_fill = fill_m.log()
        depth = describe(log_fill, certain, sparse_m, kind)
        image = normalise(image.to(kind, memory_format=torch.channels_last))
        raw = self._decode(*self._encode(pad(image), pad(depth)))
        corrected = (
            correct_fast(raw, log_fill) if without_gradient(raw) else correct(raw, log_fill, branches=self.training)
        )
        mixed, scale, *branches = corrected
        return Completed(mixed, (scale + FIRST_SCALE).clamp(SMALLEST_SCALE, LARGEST_SCALE), tuple(branches))

    def _encode(self, image: Tensor, depth: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """Return both modalities' features at every scale, finest first, channels exchanged from 1/8 on."""
        images, depths = [self.image_stem(image)], [self.depth_stem(depth)]
        for level, (image_down, depth_down) in enumerate(zip(self.image_down, self.depth_down, strict=True)):
            seen, measured = image_down(images[-1]), depth_down(depths[-1])
            if level:
                seen, measured = exchange(seen, measured)
            images.append(seen)
            depths.append(measured)
        return images, depths

    def _decode(self, images: list[Tensor], depths: list[Tensor]) -> Tensor:
        """Return two changes, their choice and the scale, 2x2 pixels each: (b, 16, h/2, w/2)."""
        fused = [fuse(a, b) for fuse, a, b in zip(self.fuse, images[1:], depths[1:], strict=True)]
        first = second = fused[-1]
        for level in range(len(fused) - 2, -1, -1):
            first = self.up[level](join(self.lower[level + 1](first), depths[level + 1]))
            second = self.ladder[level](join(F.pixel_shuffle(second, 2), fused[level]))
        merged = self.meet(join(self.lower[0](first), F.pixel_shuffle(second, 2), depths[0], images[0]))
        raw: Tensor = self.head(merged)
        return raw


class Fuse(nn.Module):
    """Gates two modalities by what both say together: (b, channels, h, w) each, in and out."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.joint = conv(2 * channels, channels)
        self.gate = nn.Conv2d(channels, channels, 1)

    def forward(self, image: Tensor, depth: Tensor) -> Tensor:
        """Fuse."""
        joint: Tensor = self.joint(join(image, depth))
        return joint + torch.lerp(depth, image, torch.sigmoid(self.gate(joint)))


def correct(raw: Tensor, log_fill: Tensor, *, branches: bool) -> tuple[Tensor, ...]:
    """Apply what the head says (b, 16, >= h / 2, >= w / 2) to a pre-fill's logarithm (b, h, w).

    Returns the mixed depth and the scale, each (b, h, w); if asked also the two depths before mixing.
    """
    height, width = log_fill.shape[1:]
    first, second, choice, scale = F.pixel_shuffle(raw, 2)[:, :, :height, :width].float().unbind(dim=1)
    changes = torch.lerp(second, first, torch.sigmoid(choice)), *((first, second) if branches else ())
    mixed, *before = (torch.exp(log_fill + c.clamp(-LARGEST_CHANGE, LARGEST_CHANGE)) for c in changes)
    return mixed, scale, *before


def correct_fast(raw: Tensor, log_fill: Tensor) -> tuple[Tensor, ...]:
    """Do the same in a kernel, without the branches."""
    from priors.kernels import depth_correction as kernels

    depth, scale = torch.empty_like(log_fill), torch.empty_like(log_fill)
    cells = as_bits(raw.permute(0, 2, 3, 1))
    work = partial(kernels.correct, cells, log_fill.float().numpy(), LARGEST_CHANGE, depth.numpy(), scale.numpy())
    batch, height, width = depth.shape
    threads.over(batch * height, work, threads.worth(5 * width))
    return depth, scale


def exchange(image: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
    """Swap the second half of the channels of two modalities (b, c, h, w)."""
    half = image.shape[1] // 2
    return torch.cat([image[:, :half], depth[:, half:]], 1), torch.cat([depth[:, :half], image[:, half:]], 1)


def describe(log_fill: Tensor, certain: Tensor, sparse_m: Tensor, kind: torch.dtype) -> Tensor:
    """Return what the depth branch sees, (b, 4, h, w), channels-last.

    Logarithm of the pre-fill against its mean, confidence, where samples are, and by how much the pre-fill left them.
    """
    mean = log_fill.mean(dim=(1, 2), keepdim=True)
    there = sparse_m > 0
    left = torch.where(there, 4 * (sparse_m.clamp_min(1e-6).log() - log_fill), 0.0)
    maps = (log_fill - mean, certain, there, left)
    return torch.stack([one.to(kind) for one in maps], dim=3).permute(0, 3, 1, 2)


def _stem(inputs: int, outputs: int) -> nn.Sequential:
    """Return a pixel-unshuffle to 1/2 and a 1x1 convolution in one."""
    first = nn.Conv2d(inputs, outputs, 2, 2, bias=False)
    return nn.Sequential(first, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))
