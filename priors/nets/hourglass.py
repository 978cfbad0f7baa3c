"""3D hourglass, the first stage of a stereo network: it fuses cost volumes of three scales."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from priors.nets.blocks import Exact, UpsampleConv, conv3d
from priors.nets.matching import concatenate, correlate, expect
from priors.nets.onnx_volume import beside, weigh
from priors.nets.stereo_output import Matched

GROUPS, GROUP_CHANNELS = 8, 8
WIDTHS = {"s": 16, "m": 24, "l": 32}
"""Channels of the 3D convolutions at 1/8."""


class Hourglass(nn.Module):
    """The whole range of disparities at 1/8, helped by volumes at 1/16 and 1/32."""

    def __init__(self, channels: tuple[int, int, int, int], width: int, joined: int = 0) -> None:
        """Take the trunk's channels, the 3D convolutions' width, and how many features of each view to concatenate."""
        super().__init__()
        matched = GROUPS * GROUP_CHANNELS
        self.heads = nn.ModuleList(nn.Conv2d(c, matched, 1) for c in channels[1:])
        self.joined = nn.ModuleList(nn.Conv2d(c, joined, 1) for c in channels[1:]) if joined else None
        self.first = nn.ModuleList(conv3d(GROUPS + 2 * joined, width * k) for k in (1, 2, 2))
        self.down = nn.ModuleList([conv3d(width, 2 * width, stride=2), conv3d(2 * width, 2 * width, stride=2)])
        self.fuse = nn.ModuleList([conv3d(4 * width, 2 * width), conv3d(4 * width, 2 * width)])
        self.up = nn.ModuleList([UpsampleConv(*conv3d(2 * width, width)), UpsampleConv(*conv3d(2 * width, 2 * width))])
        self.gate = nn.Conv2d(channels[1], width, 1)
        self.last = Exact(conv3d(width, width), nn.Conv3d(width, 1, 3, padding=1))

    def forward(self, left: Sequence[Tensor], right: Sequence[Tensor], planes: int) -> Matched:
        """Match features at 1/8, 1/16 and 1/32 over `planes` (a multiple of 4) disparities at 1/8."""
        volumes = []
        for level, head in enumerate(self.heads):
            volume = correlate(head(left[level + 1]), head(right[level + 1]), GROUPS, planes >> level)
            if self.joined is not None:
                pair = self.joined[level](left[level + 1]), self.joined[level](right[level + 1])
                volume = beside(volume, concatenate(*pair, planes >> level))
            volumes.append(self.first[level](volume))
        eighth, sixteenth, coarsest = volumes
        eighth = weigh(eighth, torch.sigmoid(self.gate(left[1])))
        sixteenth = self.fuse[0](beside(self.down[0](eighth), sixteenth))
        coarsest = self.fuse[1](beside(self.down[1](sixteenth), coarsest))
        sixteenth = self.up[1](coarsest, sixteenth)
        eighth = self.up[0](sixteenth, eighth)
        logits = self.last(eighth).squeeze(1)
        position = torch.arange(planes, device=logits.device, dtype=torch.float32)
        disparity, sigma = expect(logits, position, window=2)
        return Matched(disparity, sigma, logits, position)
