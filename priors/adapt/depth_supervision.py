"""What a scene teaches by depth that its views know: a LiDAR's, or stereo's where it is sure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from priors.adapt.batch import Batch
from priors.adapt.objective import loss
from priors.adapt.views import ZOOM, View, collate, crop_size, cut, repaint
from priors.nets.bts import MonoOut


@dataclass(frozen=True)
class Measured:
    """Supervises by views with depth; see adapt.Supervision."""

    views: Sequence[View]
    """Images of one camera with the depth that is known."""
    measures: str = "mean log error"

    def batch(self, rng: np.random.Generator, count: int) -> Batch:
        """Make a batch of crops."""
        size = crop_size(self.views)
        picked = (self.views[int(rng.integers(len(self.views)))] for _ in range(count))
        return collate([repaint(cut(view, rng, size, ZOOM), rng) for view in picked])

    def loss(self, out: MonoOut, batch: Batch) -> tuple[Tensor, Tensor]:
        """Return the training's loss, and the mean log error."""
        total, parts = loss(out, batch)
        return total, parts["log_error"]
