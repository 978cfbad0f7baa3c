"""How much of a network's correction counts, by how densely the samples lie.

Where samples are dense the fill is right already, and what a network changes is as often wrong. From which density on
that is so was measured for each file of weights (priors/learn/completion_gate.py) and stands in its header.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from priors.types import FloatMap, Mask

ENTRY = "dense"
"""Of the weights' header: [full, none]."""


@dataclass(frozen=True, slots=True)
class DensityGate:
    """The densities between which a network's say falls from all to nothing."""

    full: float
    none: float

    @classmethod
    def of(cls, about: Mapping[str, Any]) -> Self:
        """Read the header of weights; a network that was not measured always counts."""
        return cls(*(about.get(ENTRY) or (np.inf, np.inf)))

    def share(self, density: float) -> float:
        """Return how much of the correction counts, 0 to 1."""
        if density <= self.full:
            return 1.0
        return max(0.0, (self.none - density) / (self.none - self.full)) if density < self.none else 0.0


def density_of(sparse_m: FloatMap, near: Mask) -> float:
    """Return the share of the pixels where a value is wanted (height, width) that have a sample."""
    return int(np.count_nonzero(sparse_m > 0)) / max(1, int(np.count_nonzero(near)))
