"""Preprocessing of a stereo pair: normalised, padded, and brought to two scales by pixel-unshuffle."""

from functools import partial

import torch
import torch.nn.functional as F
from torch import Tensor

from priors.machine import threads
from priors.nets.tensors import as_bits, without_gradient
from priors.nets.trunk import MULTIPLE, normalise, pad


def preprocess(left: Tensor, right: Tensor, kind: torch.dtype) -> tuple[Tensor, Tensor]:
    """Normalise a pair, pad it to multiples of 32 and turn pixels into channels.

    Args:
        left: (b, 3, h, w) in [0, 1], or uint8.
        right: the same.
        kind: of the results.

    Returns:
        Both views at a quarter and at half of the size: (2b, 48, h / 4, w / 4) and (2b, 12, h / 2, w / 2), left first.
    """
    if left.dtype == right.dtype == torch.uint8 and without_gradient(left):
        return _unshuffle(left, right, kind, 4), _unshuffle(left, right, kind, 2)
    images = torch.cat([left, right])
    if images.dtype == torch.uint8:
        images = images.float() / 255
    images = pad(normalise(images.float())).to(kind)
    return F.pixel_unshuffle(images, 4), F.pixel_unshuffle(images, 2)


def _unshuffle(left: Tensor, right: Tensor, kind: torch.dtype, factor: int) -> Tensor:
    """Do the same in a kernel: 256 values are looked up, not computed."""
    from priors.kernels import pixel_unshuffle as kernels

    batch, channels, *size = left.shape
    rows, columns = (-(-side // MULTIPLE) * MULTIPLE // factor for side in size)
    out = torch.empty(2 * batch, rows, columns, channels * factor**2, dtype=kind)
    table = as_bits(normalise(torch.arange(256) / 255).to(kind))
    for view, part in zip((left, right), out.chunk(2), strict=True):
        pixels, cells = view.permute(0, 2, 3, 1).contiguous().numpy(), as_bits(part)
        work = partial(kernels.unshuffle, pixels, table, factor, cells)
        threads.over(batch * rows, work, threads.worth(1.5 * cells[0, 0].size))
    return out.permute(0, 3, 1, 2)
