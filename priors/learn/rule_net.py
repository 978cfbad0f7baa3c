"""Fit of a small rule that chooses (nets/surface_choice.py): its network, its clues, and parts that are left out."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from priors.nets.surface_choice import SurfaceChoice
from priors.types import FloatMap

PARTS, NEIGHBOURS = 4, 5
"""Into how many parts scenes are split, and how many that follow each other stay together: they look alike."""


class RuleNet:
    """A rule while it is fitted. It looks at clues of mean 0 and spread 1."""

    def __init__(self, clues: FloatMap, sides: tuple[int, ...], seed: int) -> None:
        """Make a rule for clues like those given (clues, n), which at first says: the first of what is offered.

        Args:
            clues: what it will be fitted to.
            sides: values of its layers, from the clues to what is offered.
            seed: decides its weights.
        """
        self.mean, self.spread = clues.mean(axis=1), clues.std(axis=1) + 1e-6
        self.clues = torch.from_numpy(((clues - self.mean[:, None]) / self.spread[:, None]).T.astype(np.float32))
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.dense = [nn.Linear(*side) for side in pairwise(sides)]
        self.net = nn.Sequential(*(part for each in self.dense[:-1] for part in (each, nn.ReLU())), self.dense[-1])
        weight, bias = self.dense[-1].parameters()
        with torch.no_grad():
            weight.mul_(0.1)
            bias[0] = 2.0

    def choose(self, at: Tensor, offered: Tensor) -> Tensor:
        """Return the mean (b,) of what is offered (n, offered) to the pixels `at` (b,), as the rule weighs it."""
        return (self.net(self.clues[at]).softmax(1) * offered[at]).sum(1)

    def rule(self) -> SurfaceChoice:
        """Return the rule for clues as they are: their mean and spread go into the first layer."""
        layers = [
            (np.ascontiguousarray(each.weight.detach().numpy().T), each.bias.detach().numpy()) for each in self.dense
        ]
        first, bias = layers[0]
        layers[0] = first / self.spread[:, None], bias - (self.mean / self.spread) @ first
        return SurfaceChoice(tuple((weight.astype(np.float32), bias.astype(np.float32)) for weight, bias in layers))


def draw_batch(seed: int, step: int, count: int, size: int) -> Tensor:
    """Return which of `count` pixels a step learns from (size,)."""
    return torch.from_numpy(np.random.default_rng([seed, step]).integers(count, size=size))


def leave_out(
    own: FloatMap, part: npt.NDArray[np.int64], decide: Callable[[npt.NDArray[np.bool_]], FloatMap]
) -> FloatMap:
    """Return what pixels (n,) get by a rule that has not seen their part.

    Args:
        own: what they have without a rule.
        part: which part each is of.
        decide: fits a rule to all but those where its argument (n,) is True, and returns what these get.
    """
    chosen = own.copy()
    for number in range(PARTS):
        apart = part == number
        if apart.any() and not apart.all():
            chosen[apart] = decide(apart)
    return chosen
