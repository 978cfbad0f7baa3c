"""Russian roulette (Arvo and Kirk, SIGGRAPH 1990): what matters little is computed rarely, with a larger weight.

What is kept with probability p counts 1 / p, so that sums over what is kept are right on average.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from nerf.types import Key, padded_count
from nerf.world import here

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
        chance = chances(weight[weighs], self.least)
        spun = spin(chance, self.key, self.stream)
        kept = weighs[spun]
        grown = values.clone()
        grown[kept] /= chance[spun]
        return grown, kept


def chances(weight: Tensor, least: float, used: int | None = None) -> Tensor:
    """Return the probabilities (n,) with which to keep what weighs (n,) so much, in proportion, from `least` to 1.

    The mean weight is kept for sure: few weigh more, and they make up most of the sum. So something is always kept.
    All processes of a fit have one mean. `used`: how many weights are no padding; None: all.
    """
    world = here()
    if world.size == 1:
        if not len(weight):
            return weight
        mean = weight.mean()
        top = weight.max()
    else:
        count = sum(world.counts(len(weight) if used is None else used))
        mean = world.total(weight.sum()) / (max(1, count) if used is None else padded_count(count))
        top = world.most(torch.cat([weight.new_zeros(1), weight]).max())
    mean = torch.minimum(mean, top)  # rounding puts the mean of equal weights above them all
    return torch.clamp(weight / mean, least, 1.0) if mean > 0 else torch.ones_like(weight)


def spin(chance: Tensor, key: Key, stream: int, used: int | None = None) -> Tensor:
    """Return the places (k,), ascending, of what is kept with probability `chance` (n,): random numbers of a key.

    `used`: how many of them are no padding; None: all. Processes of a fit draw one after the other.
    """
    generator = np.random.Generator(np.random.Philox(key=list(key), counter=[0, 0, 0, stream]))
    before = here().before(len(chance) if used is None else used)
    numbers = generator.random(before + len(chance), dtype=np.float32)[before:]
    drawn = torch.from_numpy(numbers).to(chance.device)
    return torch.nonzero(drawn < chance).view(-1)
