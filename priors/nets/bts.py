"""Depth from one image after BTS (Lee et al., "From Big to Small", 2019), for CPUs and for any camera.

Kept: dense ASPP at 1/8, and local planar guidance: a coarse cell predicts a plane, not a value. Changed:
- Planes are linear in inverse depth, q (1 + p u + r v), with bounded slopes: BTS's n4 / (n1 u + n2 v + n3) with
  p = n1 / n3 and r = n2 / n3. (BTS's angles, up to 60 degrees, let the denominator vanish; bounded slopes do not.)
- The last step averages the planes of nine cells at a quarter of the size, with learned weights, instead of running
  convolutions at full size.
- The camera. The network sees each pixel's place relative to the principal point, in pixels, and predicts depth as a
  camera with KITTI's focal length would have it; the answer is multiplied by fx / 721.5. This is exact: of a scene
  stretched along the optical axis by a factor, a camera with that factor's focal length takes the same picture.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from priors.errors import DataError
from priors.nets.blocks import Exact, bias_of, conv
from priors.nets.mobile import Mobile
from priors.nets.tensors import join
from priors.nets.trunk import SIZES, Trunk, normalise, pad

FOCAL_PX = 721.5377
"""Focal length of the camera that the network thinks in: KITTI's of 2011_09_26."""
NEAREST_M, FARTHEST_M = 0.5, 400.0
"""Bounds of a plane's depth at the middle of its cell, as that camera would have it."""
SMALLEST_SCALE, LARGEST_SCALE = -6.0, 2.0
"""Bounds of the logarithm of the predicted scale."""
CHANNELS = SIZES["s"]
ENCODERS: dict[str, type[Trunk] | type[Mobile]] = {"s": Trunk, "m": Mobile}
WIDTH = 128
RATES = (3, 6, 12, 18)
LARGEST_LOGIT = 20.0
"""Bound of the last step's weights, before the exponential."""
STEEPEST_EIGHTH, STEEPEST_QUARTER = 0.9, 0.35
"""Largest change of inverse depth across a cell, as a share: no plane vanishes where it is evaluated."""


@dataclass(frozen=True, slots=True)
class MonoOut:
    """What the network says about every pixel, float32, (b, h, w)."""

    depth_m: Tensor
    """Along the camera's z axis; finite and > 0, in the sky too."""
    sky_logit: Tensor
    """How sure it is that there is no surface."""
    log_scale: Tensor
    """Natural logarithm of the expected absolute error of log depth (a Laplace scale)."""
    coarse_m: Tensor
    """Depth of the planes at 1/8, for the losses: (b, ceil(h / 4), ceil(w / 4))."""


class Bts(nn.Module):
    """Metric depth, sky and expected error from one image and its camera."""

    def __init__(self, size: str = "m") -> None:
        """Make size s, on the trunk that all networks share, or m, on an encoder that ImageNet has taught.

        Raises DataError for any other size.
        """
        super().__init__()
        if size not in ENCODERS:
            raise DataError(f"bts has sizes {', '.join(ENCODERS)}, not {size}")
        self.trunk = ENCODERS[size](CHANNELS, inputs=5)
        quarter, eighth = CHANNELS[:2]
        self.context = Aspp(eighth)
        self.coarse = head(WIDTH, 3)
        self.lower = conv(WIDTH, quarter, 1)
        self.merge = nn.Sequential(conv(2 * quarter + 1, 64), conv(64, 64))
        self.fine = head(64, 5)
        self.mix = nn.Conv2d(64, 9 * 16, 1)

    def forward(self, image: Tensor, K: Tensor) -> MonoOut:
        """Estimate depth.

        Args:
            image: (b, 3, h, w) in [0, 1], any size.
            K: (b, 3, 3) intrinsics, pixels of that image.

        Returns:
            Maps of the image's size.
        """
        height, width = image.shape[-2:]
        K = K.float()
        image = pad(normalise(image))
        inputs = torch.cat([image, places(K, image)], dim=1).to(self.mix.weight.dtype)
        levels = self.trunk(inputs.contiguous(memory_format=torch.channels_last))
        context = self.context(levels[1])
        log_m, slopes = self._planes(self.coarse, context, STEEPEST_EIGHTH)
        guide = F.pixel_shuffle(log_m - torch.log(tilt(slopes, 2)), 2)
        merged = self.merge(join(levels[0], self.lower(context), guide.to(levels[0].dtype)))
        change, slopes, sky, scale = torch.split(self.fine(merged), [1, 2, 1, 1], dim=1)
        inverse = torch.exp(-guide - change.clamp(-3, 3))
        fine = upsample(inverse, STEEPEST_QUARTER * torch.tanh(slopes), sky, conv1x1(self.mix, merged), 4)[
            ..., :height, :width
        ]
        scale = F.interpolate((scale - 2).clamp(SMALLEST_SCALE, LARGEST_SCALE), scale_factor=4.0, mode="bilinear")
        zoom = (K[:, 0, 0] / FOCAL_PX)[:, None, None]
        rows, columns = (height + 3) // 4, (width + 3) // 4  # an exporter rounds what is negative the other way
        return MonoOut(
            depth_m=zoom / fine[:, 0],
            sky_logit=fine[:, 1],
            log_scale=scale[:, 0, :height, :width],
            coarse_m=zoom * torch.exp(guide[:, 0, :rows, :columns]),
        )

    @staticmethod
    def _planes(layers: nn.Sequential, features: Tensor, steepest: float) -> tuple[Tensor, Tensor]:
        """Return the log depth (b, 1, h, w) of each cell's plane at its middle, and its slopes (b, 2, h, w)."""
        raw = layers(features)
        low, high = math.log(NEAREST_M), math.log(FARTHEST_M)
        return low + (high - low) * torch.sigmoid(raw[:, :1]), steepest * torch.tanh(raw[:, 1:])


class Aspp(nn.Module):
    """Looks around at four distances, each seeing what the nearer ones found: (b, inputs, h, w) -> (b, WIDTH, h, w)."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.first = conv(inputs, WIDTH)
        self.around = nn.ModuleList(
            nn.Sequential(conv(WIDTH + 64 * n, 64, 1), conv(64, 64, dilation=rate)) for n, rate in enumerate(RATES)
        )
        self.last = conv(WIDTH + 64 * len(RATES), WIDTH)

    def forward(self, features: Tensor) -> Tensor:
        """Look."""
        context = self.first(features)
        for look in self.around:
            context = torch.cat([context, look(context)], dim=1)
        return self.last(context)


def places(K: Tensor, image: Tensor) -> Tensor:
    """Return how far each pixel lies from the principal point, (b, 2, h, w): right and down.

    In pixels over FOCAL_PX; rows are squeezed to square pixels, and stretched by 4: images are wide.
    """
    height, width = image.shape[-2:]
    column = torch.arange(width, dtype=torch.float32, device=image.device)
    row = torch.arange(height, dtype=torch.float32, device=image.device)
    x = (column - K[:, 0, 2, None]) / FOCAL_PX
    y = (row - K[:, 1, 2, None]) * (4 / FOCAL_PX * K[:, 0, 0] / K[:, 1, 1])[:, None]
    size = (K.shape[0], height, width)
    return torch.stack([x[:, None, :].expand(size), y[:, :, None].expand(size)], dim=1)


def upsample(inverse: Tensor, slopes: Tensor, others: Tensor, weights: Tensor, factor: int) -> Tensor:
    """Average, at every fine pixel, the planes of the 3x3 coarse cells around it.

    Args:
        inverse: (b, 1, h, w) float32, inverse depth at the middle of each cell.
        slopes: (b, 2, h, w) its change across the cell to the right and down, as a share; at most STEEPEST_QUARTER.
        others: (b, c, h, w) maps that are averaged as they are.
        weights: (b, 9 * factor^2, h, w) logits, clamped to +-LARGEST_LOGIT; the nine neighbours vary slowest.
        factor: how many times larger the result is.

    Returns:
        (b, 1 + c, factor * h, factor * w) float32: inverse depth > 0, then the others.
    """
    batch, _, height, width = inverse.shape
    logits = weights.view(batch, 9, factor**2, height, width).unbind(dim=1)
    padded = F.pad(torch.cat([inverse, inverse * slopes, others.float()], dim=1), (1, 1, 1, 1), mode="replicate")
    across, down = (value.view(1, factor**2, 1, 1) for value in offsets(factor, inverse.device))
    count = 1 + others.shape[1]
    whole = torch.zeros(logits[0].shape, device=inverse.device)
    totals = [whole] * count
    for index, logit in enumerate(logits):  # a softmax over all nine would not fit into the CPU's cache
        share = logit.float().clamp(-LARGEST_LOGIT, LARGEST_LOGIT).exp()
        y, x = divmod(index, 3)
        near = padded[:, :, y : y + height, x : x + width].split(1, dim=1)
        plane = near[0] + near[1] * (across + (1 - x)) + near[2] * (down + (1 - y))
        values = [plane, *near[3:]]
        totals = [torch.addcmul(total, share, value) for total, value in zip(totals, values, strict=True)]
        whole = whole + share
    return torch.cat([F.pixel_shuffle(total / whole, factor) for total in totals], dim=1)


def tilt(slopes: Tensor, factor: int) -> Tensor:
    """Return by which factor a cell's plane changes inverse depth at factor^2 places inside it: (b, factor^2, h, w)."""
    across, down = (value.view(1, factor**2, 1, 1) for value in offsets(factor, slopes.device))
    return 1 + slopes[:, :1] * across + slopes[:, 1:] * down


def offsets(factor: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return where the fine pixels of a cell lie, right of and below its middle, in cells: (factor^2,) each."""
    places = (torch.arange(factor, device=device, dtype=torch.float32) + 0.5) / factor - 0.5
    return places.repeat(factor), places.repeat_interleave(factor)


def head(inputs: int, outputs: int) -> Exact:
    """Return layers that end in a 1x1 convolution which starts at 0."""
    last = nn.Conv2d(32, outputs, 1)
    nn.init.normal_(last.weight, std=1e-3)
    nn.init.zeros_(bias_of(last))
    first = conv(inputs, 32)
    first[-1] = nn.LeakyReLU(0.1, inplace=True)  # with a ReLU all features die in the sky, and nothing is learned there
    return Exact(first, last)


def conv1x1(layer: nn.Conv2d, features: Tensor) -> Tensor:
    """Run a 1x1 convolution whose result (b, c, h, w) lies channel by channel, whatever its input's layout."""
    batch, inputs, height, width = features.shape
    pixels = features.permute(0, 2, 3, 1).reshape(batch, height * width, inputs)
    out = torch.matmul(layer.weight.view(-1, inputs), pixels.transpose(1, 2)) + bias_of(layer)[:, None]
    return out.view(batch, -1, height, width)
