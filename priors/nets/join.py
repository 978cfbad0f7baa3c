"""Maps of two scales side by side, as a convolution reads them."""

import torch
import torch.nn.functional as F
from torch import Tensor


def join(*maps: Tensor) -> Tensor:
    """Join maps (b, c, h, w) of one type to (b, sum of c, h, w); pixels of a map of half the size are repeated.

    All should be channels-last: torch transposes everything otherwise.
    """
    width = max(map_.shape[3] for map_ in maps)
    same = [map_ if map_.shape[3] == width else F.interpolate(map_, scale_factor=2.0) for map_ in maps]
    return torch.cat(same, dim=1)
