"""CFNet-style stereo: a fused cost volume, then ranges that each pixel's own uncertainty sets (Shen et al., CVPR 2021).

1. Correlations at 1/8, 1/16 and 1/32 of the image are fused by one 3D hourglass over the full range of disparities.
2. At 1/4 each pixel searches disparity +- ((1 + gamma) sigma + beta), sigma being the standard deviation of its own
   matching distribution; gamma and beta are learned. (In the released code they are not: its planes are cast to
   integers. Here features are read between pixels, so that the range gets a gradient.)
3. At 1/2 the same again, and a convex upsampling to full size.

What differs from the paper is for speed: dense convolutions on a shared quarter-size trunk, few planes, 2D aggregation
in the last stage. Confidence is the probability of an error below 1 px, read from the three stages' sigmas.
"""

import torch
from torch import Tensor, nn

from priors.nets.blocks import Residual, UpsampleConv, both, conv, conv3d
from priors.nets.hourglass import WIDTHS, Hourglass
from priors.nets.matching import expect, lookup, lookup_beside
from priors.nets.onnx_volume import weigh
from priors.nets.stereo_input import preprocess
from priors.nets.stereo_output import Matched, StereoOut, finer
from priors.nets.tensors import is_traced, join
from priors.nets.trunk import SIZES, Trunk

QUARTER_PLANES, HALF_PLANES = 8, 6
QUARTER_REACH_PX, HALF_REACH_PX = 2.5, 1.5
"""Least half-width of a range, pixels of its stage."""


class SearchRange(nn.Module):
    """The disparities a stage searches around the last one's answer; the width is learned."""

    def __init__(self, planes: int, reach_px: float) -> None:
        super().__init__()
        self.planes, self.reach_px = planes, reach_px
        self.gamma = nn.Parameter(torch.zeros(()))
        self.beta = nn.Parameter(torch.zeros(()))

    def forward(self, disparity_px: Tensor, sigma_px: Tensor) -> Tensor:
        """Return positions (b, h, w, planes) for maps (b, h, w), evenly spaced, none below 0."""
        half = ((1 + self.gamma.float()) * sigma_px + self.beta.float()).clamp(min=self.reach_px)
        low = (disparity_px - half).clamp(min=0)
        step = (disparity_px + half - low) / (self.planes - 1)
        number = torch.arange(self.planes, device=low.device, dtype=torch.float32)
        if is_traced():  # the same, laid out as what follows reads it
            return (low[:, None] + step[:, None] * number[:, None, None]).permute(0, 2, 3, 1)
        return low[..., None] + step[..., None] * number


class Quarter(nn.Module):
    """Stage 2: a few planes at 1/4, aggregated in 3D."""

    def __init__(self, channels: int, width: int = 16) -> None:
        super().__init__()
        self.range = SearchRange(QUARTER_PLANES, QUARTER_REACH_PX)
        self.head = nn.Conv2d(channels, 32, 1)
        self.groups = 4
        self.first = conv3d(self.groups + 1, width)
        self.gate = nn.Conv2d(channels, width, 1)
        self.down = nn.Sequential(conv3d(width, 2 * width, stride=2), conv3d(2 * width, 2 * width))
        self.up = UpsampleConv(*conv3d(2 * width, width))
        self.last = nn.Sequential(conv3d(width, width), nn.Conv3d(width, 1, 3, padding=1))

    def forward(self, left: Tensor, right: Tensor, disparity_px: Tensor, sigma_px: Tensor) -> Matched:
        """Search around disparities (b, h, w) with deviations, in quarter pixels."""
        position = self.range(disparity_px, sigma_px)
        where = (position - disparity_px[..., None]) * 0.2
        match = lookup(self.head(left), self.head(right), position, self.groups, where)
        volume = weigh(self.first(match), torch.sigmoid(self.gate(left)))
        volume = self.up(self.down(volume), volume)
        logits = self.last(volume).squeeze(1)
        return Matched(*expect(logits, position), logits, position)


class Half(nn.Module):
    """Stage 3: a few planes at 1/2, aggregated in 2D, and the way to full size."""

    def __init__(self, channels: int, width: int = 32) -> None:
        super().__init__()
        self.range = SearchRange(HALF_PLANES, HALF_REACH_PX)
        self.groups = 4
        self.lift = conv(channels, 16, 1)
        self.features = conv(16 + 12, 32)
        self.head = nn.Conv2d(32, 16, 1)
        inputs = 32 + self.groups * HALF_PLANES + 2 + HALF_PLANES
        self.body = nn.Sequential(conv(inputs, width), Residual(width), Residual(width))
        self.logits = nn.Conv2d(width, HALF_PLANES, 3, padding=1)
        self.doubt = nn.Conv2d(width, 1, 3, padding=1)
        self.weights = nn.Conv2d(width, 36, 1)

    def forward(
        self, left: tuple[Tensor, Tensor], right: tuple[Tensor, Tensor], disparity_px: Tensor, sigmas_px: list[Tensor]
    ) -> tuple[Matched, Tensor, Tensor]:
        """Search around disparities (b, h, w), in half pixels.

        Args:
            left: image, 2x2 pixels as channels (b, 12, h, w), and features (b, c, h / 2, w / 2).
            right: the same.
            disparity_px: (b, h, w) half pixels.
            sigmas_px: deviations (b, h, w) of the stages before, the last one first, half pixels.

        Returns:
            the match; doubt (b, 1, h, w); upsampling logits (b, 36, h, w).
        """
        position = self.range(disparity_px, sigmas_px[0])
        ours, theirs = self._features(*left), self._features(*right)
        spread = torch.stack([torch.log(s + 0.05) for s in sigmas_px], dim=3)
        where = position - disparity_px[..., None]
        heads = self.head(ours), self.head(theirs)
        before, after = [ours.permute(0, 2, 3, 1)], [spread, where]
        body = self.body(lookup_beside(before, *heads, position, self.groups, after))
        logits, doubt = both(body, self.logits, self.doubt)
        logits = logits.permute(0, 2, 3, 1)
        matched = Matched(*expect(logits, position), logits, position)
        return matched, doubt, self.weights(body)

    def _features(self, image: Tensor, quarter: Tensor) -> Tensor:
        return self.features(join(image, self.lift(quarter)))


class Cfnet(nn.Module):
    """Stereo network; sizes s, m, l differ in the trunk and in the coarse volume's width."""

    def __init__(self, size: str = "m") -> None:
        super().__init__()
        channels = SIZES[size]
        self.trunk = Trunk(channels)
        self.coarse = Hourglass(channels, WIDTHS[size])
        self.to_quarter = nn.Conv2d(channels[1], 36, 1)
        self.quarter = Quarter(channels[0])
        self.to_half = nn.Conv2d(channels[0], 36, 1)
        self.fine = Half(channels[0])

    def forward(self, left: Tensor, right: Tensor, largest_px: int, stages: int = 3) -> StereoOut:
        """Match images (b, 3, h, w), [0, 1] or bytes, any size, over disparities 0 to largest_px (a multiple of 32).

        Training may ask for fewer stages, the first ones, at sizes that are multiples of 32.
        """
        size = (left.shape[-2], left.shape[-1])
        quarters, halves = preprocess(left, right, self.to_half.weight.dtype)
        ours, theirs = zip(*(level.chunk(2) for level in self.trunk.see(quarters)), strict=True)
        image, other = halves.chunk(2)
        coarse = self.coarse(ours, theirs, largest_px // 8)
        if stages == 1:
            return StereoOut.unfinished([coarse], size)
        disparity, sigma8 = finer([coarse.disparity_px, coarse.sigma_px], self.to_quarter(ours[1]))
        quarter = self.quarter(ours[0], theirs[0], disparity, sigma8)
        if stages == 2:
            return StereoOut.unfinished([coarse, quarter], size)
        maps = [quarter.disparity_px, quarter.sigma_px, sigma8]
        disparity, sigma4, sigma8 = finer(maps, self.to_half(ours[0]))
        half, doubt, weights = self.fine((image, ours[0]), (other, theirs[0]), disparity, [sigma4, sigma8])
        maps = finer([half.disparity_px, half.sigma_px], weights)
        return StereoOut.whole(maps, doubt, [coarse, quarter, half], size, training=self.training)
