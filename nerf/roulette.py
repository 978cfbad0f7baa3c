"""Russian roulette (Arvo and Kirk, SIGGRAPH 1990): what hardly matters is taken rarely, and then counts for more.

What is kept with probability p counts 1 / p, so that sums over what is kept are right on average.
"""

import numpy as np
import torch
from torch import Tensor

from nerf.types import Key

SAMPLES, RAYS = 4, 5
"""Streams of random numbers: of samples in the backward pass, of rays."""


def chances(weight: Tensor, least: float) -> Tensor:
    """Return the probabilities (n,) with which to keep what weighs (n,) so much, in proportion, from `least` to 1.

    The mean weight is kept for sure: few weigh more, and they make up most of the sum. So something is always kept.
    """
    mean = torch.minimum(weight.mean(), weight.max())  # rounding puts the mean of equal weights above them all
    return torch.clamp(weight / mean, least, 1.0) if mean > 0 else torch.ones_like(weight)


def spin(chance: Tensor, key: Key, stream: int) -> Tensor:
    """Return the places (k,), ascending, of what is kept with probability `chance` (n,): random numbers of a key."""
    generator = np.random.Generator(np.random.Philox(key=list(key), counter=[0, 0, 0, stream]))
    drawn = torch.from_numpy(generator.random(len(chance), dtype=np.float32)).to(chance.device)
    return torch.nonzero(drawn < chance).view(-1)
