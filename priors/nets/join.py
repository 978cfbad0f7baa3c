"""Maps of two scales side by side, as a convolution reads them."""

import torch
import torch.nn.functional as F
from torch import Tensor

from priors.nets.bits import as_bits
from priors.nets.dispatch import without_gradient


def join(*maps: Tensor) -> Tensor:
    """Join maps (b, c, h, w) of one type to (b, sum of c, h, w); pixels of a map of half the size are repeated."""
    width = max(map_.shape[3] for map_ in maps)
    if not without_gradient(maps[0]):
        same = [map_ if map_.shape[3] == width else F.interpolate(map_, scale_factor=2.0) for map_ in maps]
        return torch.cat(same, dim=1)
    from priors.kernels.join import put

    height = max(map_.shape[2] for map_ in maps)
    counts = [map_.shape[1] for map_ in maps]
    out = torch.empty(maps[0].shape[0], height, width, sum(counts), dtype=maps[0].dtype)
    for number, map_ in enumerate(maps):
        put(as_bits(map_.permute(0, 2, 3, 1)), sum(counts[:number]), as_bits(out))
    return out.permute(0, 3, 1, 2)
