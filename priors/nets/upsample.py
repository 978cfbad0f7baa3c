"""Convex upsampling: every fine pixel is a learned average of its 3x3 coarse neighbours (RAFT, Teed and Deng, 2020)."""

from functools import partial

import torch
import torch.nn.functional as F
from torch import Tensor

from priors.machine import threads
from priors.nets import onnx_matching
from priors.nets.tensors import as_bits, is_traced, without_gradient

LARGEST = 30.0


def convex(values: Tensor, weights: Tensor, factor: int) -> Tensor:
    """Upsample maps by a factor.

    Args:
        values: (b, c, h, w) float32; not scaled: a disparity in coarse pixels stays one in coarse pixels.
        weights: (b, factor^2 * 9, h, w) logits; the nine neighbours vary fastest.
        factor: how many times larger the result is.

    Returns:
        (b, c, factor * h, factor * w) float32, each value between the least and the largest of its 3x3 neighbours.
    """
    if is_traced():
        return onnx_matching.convex(values, weights, factor, LARGEST)
    if without_gradient(values):
        return _on_cpu(values, weights, factor)
    batch, channels, height, width = values.shape
    logits = weights.permute(0, 2, 3, 1).reshape(batch, height, width, factor * factor, 9)
    # Logits are held where float32's exp is safe; torch's softmax is slow over so few values.
    share = logits.float().clamp(-LARGEST, LARGEST).exp()
    share = share / share.sum(-1, keepdim=True)
    padded = F.pad(values.float(), (1, 1, 1, 1), mode="replicate")
    views = [padded[:, :, row : row + height, column : column + width] for row in range(3) for column in range(3)]
    around = torch.stack(views, dim=-1)  # (b, c, h, w, 9)
    fine = [(around[:, channel, :, :, None] * share).sum(-1) for channel in range(channels)]
    return torch.cat([F.pixel_shuffle(f.permute(0, 3, 1, 2), factor) for f in fine], dim=1)


def _on_cpu(values: Tensor, weights: Tensor, factor: int) -> Tensor:
    """Do the same in a kernel."""
    from priors.kernels import convex_upsampling as kernels

    batch, channels, height, width = values.shape
    out = torch.empty(batch, channels, factor * height, factor * width)
    logits = as_bits(weights.permute(0, 2, 3, 1))
    work = partial(kernels.upsample, values.float().contiguous().numpy(), logits, factor, LARGEST, out.numpy())
    threads.over(batch * height, work, threads.worth(2 * logits[0, 0].size))
    return out
