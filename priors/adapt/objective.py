"""Objective of single-image depth: BTS's scale-invariant loss, and a network's prediction of an image."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from priors.adapt.training_step import Batch
from priors.adapt.views import LARGEST_M, to_tensor
from priors.nets import bts
from priors.types import Camera, Image


def predict(net: nn.Module, image: Image, camera: Camera, *, bf16: bool = True) -> bts.MonoOut:
    """Run a network on a whole image; the maps are (1, h, w) on the CPU."""
    device = next(net.parameters()).device
    K = torch.from_numpy(camera.K)[None].float()
    with torch.inference_mode(), torch.autocast(device.type, torch.bfloat16, enabled=bf16):
        out: bts.MonoOut = net(to_tensor([image]).to(device), K.to(device))
    return bts.MonoOut(*(map_.float().cpu() for map_ in (out.depth_m, out.sky_logit, out.log_scale, out.coarse_m)))


def loss(out: bts.MonoOut, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
    """Return BTS's scale-invariant loss, plus gradients, sky, predicted error and the coarse planes; and the parts."""
    truth_m, sky = batch["depth_m"], batch["sky"]
    known = (truth_m > 0) & (truth_m < LARGEST_M)
    error = torch.where(known, out.depth_m.log() - truth_m.clamp_min(1e-3).log(), 0.0)
    coarse_m = nearest_of_cells(torch.where(known, truth_m, 0.0))
    coarse_error = torch.where(coarse_m > 0, out.coarse_m.log() - coarse_m.clamp_min(1e-3).log(), 0.0)
    fit, coarse = silog(error, known), silog(coarse_error, coarse_m > 0)
    edges = sum((edge_loss(error, known, stride) for stride in (1, 2, 4, 8)), error.new_zeros(()))
    sky_loss = masked_mean(
        F.binary_cross_entropy_with_logits(out.sky_logit, sky.clamp_min(0), reduction="none"), sky >= 0
    )
    size = error.detach().abs()
    scale = masked_mean(out.log_scale + size * torch.exp(-out.log_scale), known)
    total = fit + 0.3 * coarse + edges + 0.5 * sky_loss + 0.1 * scale
    parts = {"silog": fit, "edges": edges, "sky": sky_loss, "scale": scale, "log_error": masked_mean(size, known)}
    return total, {name: value.detach() for name, value in parts.items()}


def silog(error: Tensor, known: Tensor, balance: float = 0.85) -> Tensor:
    """Return BTS's 10 sqrt(mean(g^2) - balance mean(g)^2) of log errors g (b, h, w) where known, mean over images."""
    count = known.flatten(1).sum(1)
    weight = known.flatten(1) / count.clamp_min(1)[:, None]
    error = error.flatten(1)
    variance = (weight * error**2).sum(1) - balance * (weight * error).sum(1) ** 2
    there = count > 0
    return 10 * (torch.sqrt(variance.clamp_min(1e-6)) * there).sum() / there.sum().clamp_min(1)


def edge_loss(error: Tensor, known: Tensor, stride: int) -> Tensor:
    """Return the mean absolute difference of neighbouring log errors, `stride` pixels apart: wrong edges and slopes."""
    error, known = error[:, ::stride, ::stride], known[:, ::stride, ::stride]
    across = masked_mean((error[:, :, 1:] - error[:, :, :-1]).abs(), known[:, :, 1:] & known[:, :, :-1])
    down = masked_mean((error[:, 1:] - error[:, :-1]).abs(), known[:, 1:] & known[:, :-1])
    return across + down


def nearest_of_cells(depth_m: Tensor) -> Tensor:
    """Return the nearest known depth of every 4x4 pixels, 0 where none is: (b, ceil(h / 4), ceil(w / 4))."""
    inverse = torch.where(depth_m > 0, 1 / depth_m.clamp_min(1e-3), 0.0)
    most = F.max_pool2d(inverse[:, None], 4, ceil_mode=True)[:, 0]
    return torch.where(most > 0, 1 / most.clamp_min(1e-6), 0.0)


def masked_mean(values: Tensor, weight: Tensor) -> Tensor:
    """Return the mean of values weighed by weight (any equal shapes; a mask counts as 0 and 1); 0 without weight."""
    return (values * weight).sum() / weight.sum().clamp_min(1)
