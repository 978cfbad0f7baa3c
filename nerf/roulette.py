"""Russian roulette (Arvo and Kirk, SIGGRAPH 1990): what hardly matters is taken rarely, and then counts for more.

What is kept with probability p counts 1 / p, so that sums over what is kept are right on average.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from nerf.types import Key

SAMPLES, RAYS, PROPOSED = 4, 5, 6
"""Streams of random numbers: of samples in the backward pass, of rays, of the proposals' samples."""


@dataclass(frozen=True)
class Wheel:
    """Chooses which of a step's values go on."""

    least: float
    """Probability of the least ones; 1: all go."""
    key: Key
    """Seed and step."""
    stream: int
    """Stream of random numbers."""

    def thinned(self, values: Tensor, weight: Tensor) -> tuple[Tensor, Tensor | None]:
        """Return values (n,), those that are kept grown, and the places (k,) of the kept ones; None: all.

        weight (n,): how much each matters. What weighs nothing is not kept.
        """
        if self.least == 1:
            return values, None
        weighs = torch.nonzero(weight > 0).view(-1)
        chance = chances(weight[weighs], self.least) if len(weighs) else weight[:0]
        spun = spin(chance, self.key, self.stream)
        kept = weighs[spun]
        grown = values.clone()
        grown[kept] /= chance[spun]
        return grown, kept


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
