"""A training step: what training a network and fine-tuning it share."""

import copy
from collections.abc import Iterable
from typing import TypeAlias

import torch
from torch import Tensor, nn

Batch: TypeAlias = dict[str, Tensor]
"""A batch of training crops: tensors by name. The first axis of each counts the crops."""


class WeightAverage:
    """The exponential moving average of a network's weights (Polyak and Juditsky, 1992).

    It starts as about a plain mean, so that early weights do not linger.
    """

    def __init__(self, net: nn.Module, decay: float, delay: int) -> None:
        """Start from a network's weights.

        Args:
            net: the network; it is copied.
            decay: share of the average that a step keeps, at most.
            delay: step t keeps t / (t + delay) at most.
        """
        self.net = copy.deepcopy(net).eval().requires_grad_(False)
        self.decay, self.delay = decay, delay

    def update(self, net: nn.Module, step: int) -> None:
        """Move towards the weights that a network has after a step, counted from 1."""
        keep = min(self.decay, step / (step + self.delay))
        with torch.no_grad():
            for ours, theirs in zip(self.net.parameters(), net.parameters(), strict=True):
                ours.lerp_(theirs, 1 - keep)


def descend(
    loss: Tensor, optimiser: torch.optim.Optimizer, parameters: Iterable[nn.Parameter], largest_norm: float
) -> Tensor:
    """Take one step of an optimiser down a loss; returns the gradient's norm.

    A gradient with a larger norm is scaled down. With one that is not finite no step is taken.
    """
    optimiser.zero_grad(set_to_none=True)
    loss.backward()
    norm = torch.nn.utils.clip_grad_norm_(parameters, largest_norm)
    if torch.isfinite(norm):
        optimiser.step()
    return norm


def to_device(batch: Batch, device: torch.device) -> Batch:
    """Return a batch on a device."""
    return {name: value.to(device) for name, value in batch.items()}
