"""Photometric error: how badly a depth map explains a view by its posed neighbours (Monodepth2, ICCV 2019).

A neighbour, looked up where the depth says that a pixel lies in it, should look as the pixel does. Of several the best
one counts, as others may be hidden. A pixel that looks more like the neighbour's same pixel moves with the camera, or
shows nothing: it teaches nothing (Godard et al.'s auto-masking).
"""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from priors.adapt.objective import masked_mean
from priors.adapt.training_step import Batch

NEAREST_M = 0.1
STRUCTURE = 0.85
"""Share of structural dissimilarity in the error; the rest is the absolute difference."""
UNSEEN = 10.0
"""Stands for the error of a pixel that lies outside a neighbour: larger than any."""


def photometric(inverse: Tensor, counts: Tensor, batch: Batch, stride: int, finest: int) -> Tensor:
    """Return the mean error of a batch of crops, in [0, 1].

    Args:
        inverse: (b, h, w) inverse depth, 1/m, > 0.
        counts: (b, h, w) which pixels may take part.
        batch: from posed_views.posed_batch.
        stride: side of the cells, in the crops' pixels, that are compared: a multiple of `finest`.
        finest: how many times smaller the batch's sources are than the crops' content.
    """
    depth_m = 1 / shrink(inverse[:, None], stride)[:, 0]
    counts = shrink(counts[:, None].float(), stride)[:, 0] > 0.999
    (error,), unmoved = explain([depth_m], batch, stride, finest)
    return masked_mean(torch.minimum(error, unmoved), counts & (error < UNSEEN))


def explain(depths_m: Sequence[Tensor], batch: Batch, stride: int, finest: int) -> tuple[Tensor, Tensor]:
    """Return how unlike the target its neighbours look by each of k depth maps, and if the camera had not moved.

    Args:
        depths_m: of cells of `stride` pixels, (b, h, w) each.
        batch: from posed_views.posed_batch.
        stride: side of the cells.
        finest: see photometric.

    Returns:
        (k, b, h, w) and (b, h, w): of the neighbour that is less unlike; UNSEEN where no neighbour shows a pixel.
    """
    target, still = shrink(batch["target"], stride), torch.ones_like(depths_m[0])
    moved, unmoved = [], []
    for n in range(batch["sources"].shape[1]):
        source = shrink(batch["sources"][:, n], stride // finest)
        turn, shift = batch["turn"][:, n], batch["shift"][:, n]
        moved.append([mismatch(target, *look_up(source, turn, shift, depth_m, stride)) for depth_m in depths_m])
        here = look_up(source, batch["still"][:, n], torch.zeros_like(shift), still, stride)
        unmoved.append(mismatch(target, *here))
    best = [torch.stack(errors).amin(dim=0) for errors in zip(*moved, strict=True)]
    return torch.stack(best), torch.stack(unmoved).amin(dim=0)


def look_up(source: Tensor, turn: Tensor, shift: Tensor, depth_m: Tensor, stride: int) -> tuple[Tensor, Tensor]:
    """Return the source (b, 3, h, w) as the target's pixels of that depth see it, and where they lie in it (b, h, w).

    Args:
        source: (b, 3, height, width).
        turn: (b, 3, 3), see posed_views.posed_batch.
        shift: (b, 3).
        depth_m: (b, h, w), of cells of `stride` pixels.
        stride: their side.
    """
    batch, height, width = depth_m.shape
    u, v = ((torch.arange(n, device=depth_m.device) + 0.5) * stride - 0.5 for n in (width, height))
    ones = torch.ones(height, width, device=depth_m.device)
    pixels = torch.stack([u[None] * ones, v[:, None] * ones, ones]).view(3, -1)
    at = (turn @ pixels).view(batch, 3, height, width) * depth_m[:, None] + shift[:, :, None, None]
    place = (at[:, :2] / at[:, 2:].clamp_min(NEAREST_M)).clamp(-2, 2)
    inside = (at[:, 2] > NEAREST_M) & (place.abs() <= 1).all(dim=1)
    seen = F.grid_sample(source, place.permute(0, 2, 3, 1), padding_mode="border", align_corners=False)
    return seen, inside


def mismatch(image: Tensor, seen: Tensor, inside: Tensor) -> Tensor:
    """Return how unlike two images (b, c, h, w) in [0, 1] are, (b, h, w) in [0, 1]; UNSEEN where not inside."""
    difference = (image - seen).abs()
    error = STRUCTURE * dissimilarity(image, seen) + (1 - STRUCTURE) * difference
    return torch.where(inside, error.mean(dim=1), UNSEEN)


def dissimilarity(a: Tensor, b: Tensor) -> Tensor:
    """Return (1 - SSIM) / 2 (Wang et al., 2004) of images (b, c, h, w) in [0, 1] over windows of 3x3 pixels.

    A loss: scikit-image's SSIM, which scores pictures, has no gradient.
    """
    a, b = F.pad(a, (1, 1, 1, 1), mode="replicate"), F.pad(b, (1, 1, 1, 1), mode="replicate")
    mean_a, mean_b = average(a), average(b)
    variance_a, variance_b = average(a * a) - mean_a**2, average(b * b) - mean_b**2
    together = average(a * b) - mean_a * mean_b
    above = (2 * mean_a * mean_b + 0.01**2) * (2 * together + 0.03**2)
    below = (mean_a**2 + mean_b**2 + 0.01**2) * (variance_a + variance_b + 0.03**2)
    return ((1 - above / below) / 2).clamp(0, 1)


def roughness(inverse: Tensor, image: Tensor, counts: Tensor) -> Tensor:
    """Return how inverse depth (b, h, w), over its mean, changes where the image (b, 3, h, w) does not."""
    share = inverse / inverse.mean(dim=(1, 2), keepdim=True)
    across = (share[:, :, 1:] - share[:, :, :-1]).abs() * torch.exp(-(image[..., 1:] - image[..., :-1]).abs().mean(1))
    down = (share[:, 1:] - share[:, :-1]).abs() * torch.exp(-(image[:, :, 1:] - image[:, :, :-1]).abs().mean(1))
    return masked_mean(across, counts[:, :, 1:] & counts[:, :, :-1]) + masked_mean(down, counts[:, 1:] & counts[:, :-1])


def shrink(maps: Tensor, times: int) -> Tensor:
    """Average maps (b, c, h, w) over cells; those at the right and bottom are cut to fit."""
    size = [max(1, n // times) for n in maps.shape[-2:]]
    return maps if times == 1 else F.interpolate(maps, size=size, mode="area")


def average(maps: Tensor) -> Tensor:
    """Average maps over windows of 3x3 pixels; a border is lost."""
    return F.avg_pool2d(maps, 3, stride=1)
