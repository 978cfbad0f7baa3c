"""Cost volumes and convex upsampling for ONNX export: maps channel by channel, nothing sorted pixel by pixel.

The results equal those of cost_volume.py and upsample.py. onnxruntime is slow at sorting the channels of every pixel
(Transpose), at broadcasting over a few values (Mul, Where) and at a softmax over any axis but the last: they are
avoided here.
"""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from priors.nets.onnx_volume import Planes


def unit(features: Tensor, groups: int) -> Tensor:
    """Return features (b, c, h, w) with every group of channels of length 1; see cost_volume.unit."""
    batch, channels, height, width = features.shape
    split = features.view(batch, groups, channels // groups, height, width)
    return (split / torch.sqrt((split * split).sum(2, keepdim=True) + 1e-4)).view(batch, channels, height, width)


def correlate(left: Tensor, right: Tensor, groups: int, planes: int) -> Planes:
    """Match features (b, c, h, w) at disparities 0 .. planes - 1: maps (b, groups, h, w); see cost_volume.correlate."""
    batch, channels, height, width = left.shape
    left, right = unit(left, groups), F.pad(unit(right, groups), (planes - 1, 0))
    maps = []
    for disparity in range(planes):
        start = planes - 1 - disparity
        product = left * right[..., start : start + width]
        maps.append(product.view(batch, groups, channels // groups, height, width).sum(2))
    return Planes(maps)


def concatenate(left: Tensor, right: Tensor, planes: int) -> Planes:
    """Put features side by side at disparities 0 .. planes - 1: maps (b, 2c, h, w); see cost_volume.concatenate."""
    width, padded = left.shape[3], F.pad(right, (planes - 1, 0))
    starts = range(planes - 1, -1, -1)
    return Planes([torch.cat([left, padded[..., start : start + width]], dim=1) for start in starts])


def lookup(left: Tensor, right: Tensor, disparity_px: Tensor, groups: int) -> Tensor:
    """Match features (b, c, h, w) at disparities (b, h, w, planes): (b, planes, groups, h, w).

    See cost_volume.lookup.
    """
    batch, channels, height, width = left.shape
    planes = disparity_px.shape[3]
    asked = torch.arange(width, dtype=torch.float32) - disparity_px.permute(0, 3, 1, 2)
    held = asked.clamp(0, width - 1)
    inside = (asked == held).float()
    first = held.floor().clamp(max=max(0, width - 2))
    share = held - first
    rows = width * torch.arange(batch * height).view(batch, 1, height, 1)
    index = (rows + first.long()).permute(0, 2, 3, 1).reshape(-1)
    ours, theirs = (unit(view, groups).permute(0, 2, 3, 1) for view in (left, right))
    neighbours = torch.cat([theirs[:, :, 1:], theirs[:, :, -1:]], dim=2)
    pairs = torch.cat([theirs, neighbours], dim=3).reshape(-1, 2 * channels)
    features = pairs.index_select(0, index).view(-1, 2 * planes, channels)
    # One product of small matrices a pixel: our features stand in the column of their group, zeros elsewhere.
    number = torch.arange(channels)
    place = (number * groups + number // (channels // groups))[:, None] == torch.arange(channels * groups)
    blocks = torch.matmul(ours.reshape(-1, channels), place.float()).view(-1, channels, groups)
    products = torch.matmul(features, blocks).view(batch, height * width, 2 * planes * groups)
    near, far = products.transpose(1, 2).reshape(batch, planes, 2, groups, height, width).unbind(2)
    return (near + (far - near) * share[:, :, None]) * inside[:, :, None]


def lookup_beside(
    before: Sequence[Tensor], left: Tensor, right: Tensor, disparity_px: Tensor, groups: int, after: Sequence[Tensor]
) -> Tensor:
    """Match between other maps (b, h, w, c); see matching.lookup_beside."""
    matches = lookup(left, right, disparity_px, groups).transpose(1, 2).flatten(1, 2)
    return torch.cat(
        [*(m.permute(0, 3, 1, 2) for m in before), matches, *(m.permute(0, 3, 1, 2) for m in after)], dim=1
    )


def expect(logits: Tensor, position_px: Tensor, window: int | None) -> tuple[Tensor, Tensor]:
    """Return mean and deviation (b, h, w) of distributions (b, h, w, planes); see cost_volume.expect."""
    planes = logits.shape[-1]
    values, position = (
        logits.permute(0, 3, 1, 2),
        position_px.expand(1, 1, 1, planes) if position_px.dim() < 4 else position_px,
    )
    position = position.permute(0, 3, 1, 2)
    share = torch.exp(values - values.amax(1, keepdim=True))
    whole = share.sum(1, keepdim=True)
    if window is None:
        part, total = share, whole
    else:
        away = torch.arange(planes).view(1, planes, 1, 1) - values.argmax(1, keepdim=True)
        part = share * (away.abs() <= window).float()
        total = part.sum(1, keepdim=True)
    mean = (part * position).sum(1, keepdim=True) / total
    off = position - mean
    variance = (share * (off * off)).sum(1, keepdim=True) / whole
    return mean[:, 0], (variance + 1e-6).sqrt()[:, 0]


def convex(values: Tensor, weights: Tensor, factor: int, largest: float) -> Tensor:
    """Upsample maps (b, c, h, w) by averages of nine neighbours; see upsample.convex."""
    batch, channels, height, width = values.shape
    share = weights.view(batch, factor**2, 9, height, width).clamp(-largest, largest).exp()
    whole = share.sum(2)
    padded = F.pad(values, (1, 1, 1, 1), mode="replicate")
    around = [padded[:, :, y : y + height, x : x + width] for y in range(3) for x in range(3)]
    near = torch.stack(around, dim=2)
    fine = [(share * near[:, c, None]).sum(2) / whole for c in range(channels)]
    return torch.cat([F.pixel_shuffle(one, factor) for one in fine], dim=1)
