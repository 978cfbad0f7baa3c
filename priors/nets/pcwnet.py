"""PCWNet-style stereo: multi-scale combination volumes, then refinement by warping volumes (Shen et al., ECCV 2022).

1. Combination volumes (group-wise correlation and concatenated features) at 1/8, 1/16 and 1/32 of the image are fused
   by one 3D hourglass over the full range of disparities.
2. Warping volume: the right features are brought to where the answer so far says they are, and compared with the left
   ones there and a few pixels to each side; a 2D network reads the remaining error from that. Once at 1/4, once at 1/2.

The paper starts at 1/4, puts the volume at full size and warps there; a CPU cannot afford either.
"""

import torch
from torch import Tensor, nn

from priors.nets.blocks import Residual, conv
from priors.nets.cost_volume import shift
from priors.nets.hourglass import WIDTHS, Hourglass
from priors.nets.matching import lookup_beside, unit
from priors.nets.stereo_input import preprocess
from priors.nets.stereo_output import Matched, StereoOut, finer
from priors.nets.tensors import join
from priors.nets.trunk import SIZES, Trunk

JOINED = 8
GROUPS = 2


class Warping(nn.Module):
    """Refine a disparity by what is left between the left view and the right one warped by it."""

    def __init__(self, features: int, reach_px: int, width: int, dilations: tuple[int, ...]) -> None:
        super().__init__()
        self.reach_px = reach_px
        self.head = nn.Conv2d(features, 16, 1)
        compared = GROUPS * (2 * reach_px + 1)
        self.first = conv(features + 16 + compared + 2, width)
        self.body = nn.Sequential(*(Residual(width, dilation) for dilation in dilations))
        self.change = nn.Conv2d(width, 1, 3, padding=1)
        self.weights = nn.Conv2d(width, 36, 1)

    def forward(
        self, left: Tensor, right: Tensor, disparity_px: Tensor, sigma_px: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Take features (b, c, h, w), disparity and sigma (b, h, w) in their pixels.

        Returns the refined disparity (b, h, w), upsampling logits (b, 36, h, w) and features (b, width, h, w).
        """
        ours, theirs = self.head(left), self.head(right)
        here_px = disparity_px.detach()
        step = torch.arange(-self.reach_px, self.reach_px + 1, device=left.device, dtype=torch.float32)
        difference = unit(ours, GROUPS) - shift(unit(theirs, GROUPS), here_px)
        told = torch.stack([here_px * 0.05, torch.log(sigma_px.detach() + 0.05)], dim=3)
        before = [left.permute(0, 2, 3, 1), difference]
        compared = lookup_beside(before, ours, theirs, here_px[..., None] + step, GROUPS, [told])
        body = self.body(self.first(compared))
        refined = (disparity_px + self.change(body)[:, 0].float()).clamp(min=0)
        return refined, self.weights(body), body


class Pcwnet(nn.Module):
    """Stereo network; sizes s, m, l differ in the trunk and in the volume's width."""

    def __init__(self, size: str = "m") -> None:
        super().__init__()
        channels = SIZES[size]
        self.trunk = Trunk(channels)
        self.coarse = Hourglass(channels, WIDTHS[size], JOINED)
        self.to_quarter = nn.Conv2d(channels[1], 36, 1)
        self.quarter = Warping(channels[0], 4, 48, (1, 2, 4))
        self.lift = conv(channels[0], 16, 1)
        self.features = conv(16 + 12, 32)
        self.fine = Warping(32, 2, 32, (1, 1))
        self.doubt = nn.Conv2d(32, 1, 3, padding=1)

    def forward(self, left: Tensor, right: Tensor, largest_px: int, stages: int = 3) -> StereoOut:
        """Match images (b, 3, h, w), [0, 1] or bytes, any size, over disparities 0 to largest_px (a multiple of 32).

        Training may ask for fewer stages, the first ones, at sizes that are multiples of 32.
        """
        size = (left.shape[-2], left.shape[-1])
        quarters, halves = preprocess(left, right, self.to_quarter.weight.dtype)
        levels = self.trunk.see(quarters)
        ours, theirs = zip(*(level.chunk(2) for level in levels), strict=True)
        coarse = self.coarse(ours, theirs, largest_px // 8)
        if stages == 1:
            return StereoOut.unfinished([coarse], size)
        disparity, sigma = finer([coarse.disparity_px, coarse.sigma_px], self.to_quarter(ours[1]))
        disparity4, weights, _ = self.quarter(ours[0], theirs[0], disparity, sigma)
        if stages == 2:
            return StereoOut.unfinished([coarse, Matched(disparity4, sigma)], size)
        disparity, sigma = finer([disparity4, sigma], weights)
        a, b = self.features(join(halves, self.lift(levels[0]))).chunk(2)
        disparity2, weights, body = self.fine(a, b, disparity, sigma)
        matched = [coarse, Matched(disparity4, sigma), Matched(disparity2, sigma)]
        maps = finer([disparity2, sigma], weights)
        return StereoOut.whole(maps, self.doubt(body), matched, size, training=self.training)
