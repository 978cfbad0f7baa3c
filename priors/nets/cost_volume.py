"""Cost volumes: how well a left pixel's features match the right image's, plane by plane.

Volumes are (b, groups, h, w, planes) with the groups fastest in memory: what one pixel needs lies together, from the
gather to the 3D convolutions, and nothing is transposed.
"""

import torch
import torch.nn.functional as F
from torch import Tensor


def unit(features: Tensor, groups: int) -> Tensor:
    """Turn features (b, c, h, w) into (b, h, w, c) with every group of channels of length 1.

    Products of unit vectors stay in [-1, 1]: safe in bf16, and blind to contrast.
    """
    batch, channels, height, width = features.shape
    split = features.permute(0, 2, 3, 1).reshape(batch, height, width, groups, channels // groups).float()
    scale = torch.rsqrt(split.square().sum(-1, keepdim=True) + 1e-4)
    return (split * scale).reshape(batch, height, width, channels).to(features.dtype)


def correlate(left: Tensor, right: Tensor, groups: int, planes: int) -> Tensor:
    """Match at disparities 0, 1 .. planes - 1 (group-wise correlation: Guo et al., CVPR 2019).

    Args:
        left: (b, h, w, c) from `unit`.
        right: (b, h, w, c) from `unit`.
        groups: how many channels of the volume; c is a multiple.
        planes: how many disparities.

    Returns:
        (b, groups, h, w, planes); 0 where the match would lie outside the right image.
    """
    width = left.shape[2]
    disparity = torch.arange(planes, device=left.device)
    column = torch.arange(width, device=left.device)[:, None] - disparity
    column = column.expand(*left.shape[:3], planes)
    products = _dot(left, right, column.clamp(min=0), groups)
    return (products * (column >= 0)[..., None].to(products.dtype)).permute(0, 4, 1, 2, 3)


def lookup(left: Tensor, right: Tensor, disparity_px: Tensor, groups: int) -> Tensor:
    """Match at each pixel's own disparities, linear between pixels: disparities get a gradient.

    Args:
        left: (b, h, w, c) from `unit`.
        right: (b, h, w, c) from `unit`.
        disparity_px: (b, h, w, planes) in pixels of these features.
        groups: how many channels of the volume.

    Returns:
        (b, groups, h, w, planes); 0 where the match would lie outside the right image.
    """
    width, planes = left.shape[2], disparity_px.shape[3]
    column = torch.arange(width, device=left.device, dtype=torch.float32)[:, None] - disparity_px.float()
    inside = (column >= 0) & (column <= width - 1)
    column = column.clamp(0, width - 1)
    first = column.detach().floor().clamp(max=max(0, width - 2))
    share = (column - first)[..., None].to(left.dtype)
    index = first.long()
    products = _dot(left, right, torch.cat([index, (index + 1).clamp(max=width - 1)], dim=3), groups)
    near, far = products.split(planes, dim=3)
    return (torch.lerp(near, far, share) * inside[..., None].to(near.dtype)).permute(0, 4, 1, 2, 3)


def concatenate(left: Tensor, right: Tensor, planes: int) -> Tensor:
    """Put the features (b, c, h, w) of both views side by side at disparities 0 .. planes - 1 (PSMNet's volume).

    Returns (b, 2c, h, w, planes); the right view's are 0 where the match would lie outside it.
    """
    batch, channels, height, width = right.shape
    ours = left.permute(0, 2, 3, 1)[:, :, :, None].expand(batch, height, width, planes, channels)
    padded = F.pad(right.permute(0, 2, 3, 1), (0, 0, planes - 1, 0))
    theirs = torch.stack([padded[:, :, planes - 1 - d : planes - 1 - d + width] for d in range(planes)], dim=3)
    return torch.cat([ours, theirs], dim=4).permute(0, 4, 1, 2, 3)


def shift(right: Tensor, disparity_px: Tensor) -> Tensor:
    """Bring right features (b, h, w, c) to where the left pixels (b, h, w) see them, linear between pixels.

    Returns (b, h, w, c); 0 where that is outside the right image.
    """
    batch, height, width, channels = right.shape
    column = torch.arange(width, device=right.device, dtype=torch.float32) - disparity_px.float()
    inside = (column >= 0) & (column <= width - 1)
    column = column.clamp(0, width - 1)
    first = column.detach().floor().clamp(max=max(0, width - 2))
    share = (column - first)[..., None].to(right.dtype)
    index = first.long()
    pair = torch.stack([index, (index + 1).clamp(max=width - 1)], dim=3)
    near, far = _fetch(right, pair).view(batch, height, width, 2, channels).unbind(3)
    return torch.lerp(near, far, share) * inside[..., None].to(right.dtype)


def _fetch(right: Tensor, column: Tensor) -> Tensor:
    """Fetch right features (b, h, w, c) at columns (b, h, w, n) of the same row: (b * h * w, n, c)."""
    batch, height, width, channels = right.shape
    row = torch.arange(batch * height, device=right.device).view(batch, height, 1, 1) * width
    rows = right.reshape(-1, channels).index_select(0, (row + column).reshape(-1))
    return rows.view(batch * height * width, column.shape[3], channels)


def _dot(left: Tensor, right: Tensor, column: Tensor, groups: int) -> Tensor:
    """Multiply left (b, h, w, c) with right at columns (b, h, w, n), group by group: (b, h, w, n, groups)."""
    batch, height, width, channels = left.shape
    theirs = _fetch(right, column)
    # One product of small matrices a pixel: the left features stand in the column of their group, zeros elsewhere.
    member = torch.arange(channels, device=left.device)[:, None] // (channels // groups)
    spread = (member == torch.arange(groups, device=left.device)).to(left.dtype)
    blocks = left.reshape(-1, channels, 1) * spread
    return torch.matmul(theirs, blocks).view(batch, height, width, column.shape[3], groups)


def expect(logits: Tensor, position_px: Tensor, window: int | None = None) -> tuple[Tensor, Tensor]:
    """Return mean and standard deviation of the matching distribution (CFNet, Shen et al., CVPR 2021, eq. 3 and 4).

    Args:
        logits: (b, h, w, planes).
        position_px: disparities, broadcastable to the same shape.
        window: planes to each side of the likeliest that the mean is taken over; a mean over two surfaces would lie
            between them. None: all. The deviation is always over all planes.

    Returns:
        disparity and sigma (b, h, w) float32, in the positions' unit.
    """
    share = logits.float().softmax(dim=-1)
    position = position_px.float().expand_as(share)
    if window is None:
        mean = (share * position).sum(-1)
    else:
        plane = torch.arange(share.shape[-1], device=share.device)
        near = (plane - share.argmax(-1, keepdim=True)).abs() <= window
        part = share * near
        mean = (part * position).sum(-1) / part.sum(-1)
    variance = (share * (position - mean.detach()[..., None]).square()).sum(-1)
    return mean, (variance + 1e-6).sqrt()
