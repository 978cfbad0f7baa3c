"""The trunk that all networks share: a dense U-Net that starts at a quarter of the image's size.

Pixel-unshuffle turns 4x4 pixels into channels, so that no convolution ever runs at full size and no detail is lost.
"""

from itertools import pairwise

import torch.nn.functional as F
from torch import Tensor, nn

from priors.nets.blocks import Residual, conv
from priors.nets.tensors import join

SIZES: dict[str, tuple[int, int, int, int]] = {
    "s": (32, 64, 96, 128),
    "m": (48, 96, 128, 160),
    "l": (64, 128, 192, 256),
}
"""Channels at 1/4, 1/8, 1/16 and 1/32 of the image."""
MULTIPLE = 32
"""Heights and widths inside a network are multiples of this."""


class Pyramid(nn.Module):
    """The way back up: tells the finer levels of a pyramid of features what the coarser ones saw."""

    def __init__(self, channels: tuple[int, int, int, int]) -> None:
        super().__init__()
        self.channels = channels
        self.lower = nn.ModuleList(conv(b, a, 1) for a, b in pairwise(channels))
        self.up = nn.ModuleList(nn.Sequential(conv(2 * a, a), Residual(a)) for a in channels[:-1])

    def join(self, levels: list[Tensor]) -> list[Tensor]:
        """Mend features (b, channels, h, w), finest first, from the coarsest on; the list is changed."""
        for index in range(len(levels) - 2, -1, -1):
            levels[index] = self.up[index](join(self.lower[index](levels[index + 1]), levels[index]))
        return levels


class Trunk(Pyramid):
    """Features of an image at four scales."""

    def __init__(self, channels: tuple[int, int, int, int] = SIZES["m"], inputs: int = 3) -> None:
        super().__init__(channels)
        self.stem = nn.Sequential(conv(16 * inputs, channels[0]), Residual(channels[0]))
        self.down = nn.ModuleList(nn.Sequential(conv(a, b, stride=2), Residual(b)) for a, b in pairwise(channels))

    def forward(self, image: Tensor) -> list[Tensor]:
        """Turn images (b, inputs, h, w), h and w multiples of 32, into features at 1/4, 1/8, 1/16 and 1/32."""
        return self.see(F.pixel_unshuffle(image, 4))

    def see(self, quarter: Tensor) -> list[Tensor]:
        """Do the same with 4x4 pixels as channels: (b, 16 * inputs, h / 4, w / 4)."""
        levels = [self.stem(quarter)]
        for down in self.down:
            levels.append(down(levels[-1]))
        return self.join(levels)


def pad(image: Tensor) -> Tensor:
    """Repeat the right and bottom edges of (b, c, h, w) until both sizes are multiples of 32."""
    height, width = image.shape[-2:]
    extra = (0, -width % MULTIPLE, 0, -height % MULTIPLE)
    return F.pad(image, extra, mode="replicate") if any(extra) else image


def normalise(image: Tensor) -> Tensor:
    """Bring colours in [0, 1] to about zero mean and unit spread."""
    return (image - 0.42) * 4.0
