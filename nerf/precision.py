"""Precision: how much a prior's value counts in a depth loss, by the probability that it is right.

Errors have a Laplace distribution, as in priors/error_model.py: P(|e| <= a) = 1 - exp(-a / s). So a value that is right
with probability c has the spread s = a / -log(1 - c). Its likelihood weighs |e| by 1 / s, and least squares weigh e^2
by the inverse of the variance, which is in proportion to 1 / s^2. The tolerance a is all values' own and goes out in
the mean.
"""

import math

import torch
from torch import Tensor

SUREST = 0.95
"""Probability from which on a value counts as much as it can: those above are not told apart well enough."""
POWERS = {"l1": 1.0, "mse": 2.0, "urf": 2.0}
"""Power of 1 / s that a depth loss is weighed by. kl is no error's size: it is weighed by the probability itself."""


def precision(loss: str, chance: Tensor) -> Tensor:
    """Return how much values count (r,), 0 to 1, in a depth loss by the probability that they are right (r,)."""
    if loss not in POWERS:
        return chance
    rate = torch.log1p(-chance.clamp(0, SUREST)) / math.log1p(-SUREST)
    return rate ** POWERS[loss]
