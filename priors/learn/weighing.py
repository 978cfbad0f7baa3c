"""Means over what is known."""

from torch import Tensor


def mean(values: Tensor, weight: Tensor) -> Tensor:
    """Return the mean of values weighed by weight (any equal shapes; a mask counts as 0 and 1); 0 without weight."""
    return (values * weight).sum() / weight.sum().clamp_min(1)
