"""How much of a network's correction counts, by how densely the samples lie.

Where samples are dense the fill is right already, and what a network changes is as often wrong. From which density on
that is so was measured for each file of weights (priors/learn/completion_gate.py) and stands in its header. In holes of
a dense map, far from any sample, the network counts all the same.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import cv2
import numpy as np

from priors.types import FloatMap, Mask

ENTRY = "dense"
"""Of the weights' header: [full, none]."""
HOLE_PX = 3.0, 9.0
"""Distances to the nearest sample between which the network's say in a dense map rises from nothing to all."""


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
        """Return how much of the correction counts beside samples, 0 to 1."""
        if density <= self.full:
            return 1.0
        return max(0.0, (self.none - density) / (self.none - self.full)) if density < self.none else 0.0

    def shares(self, sparse_m: FloatMap, near: Mask) -> FloatMap | None:
        """Return how much of the correction counts at each pixel (height, width); None: all of it everywhere.

        Args:
            sparse_m: the samples (height, width), 0 = none.
            near: where a value is wanted.
        """
        share = np.float32(self.share(density_of(sparse_m, near)))
        if share == 1:
            return None
        distance_px = cv2.distanceTransform((sparse_m <= 0).astype(np.uint8), cv2.DIST_L2, 5)
        hole = np.clip((distance_px - HOLE_PX[0]) / (HOLE_PX[1] - HOLE_PX[0]), 0, 1)
        return np.asarray(share + (1 - share) * hole, np.float32)


def density_of(sparse_m: FloatMap, near: Mask) -> float:
    """Return the share of the pixels where a value is wanted (height, width) that have a sample."""
    return int(np.count_nonzero(sparse_m > 0)) / max(1, int(np.count_nonzero(near)))
