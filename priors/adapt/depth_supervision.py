"""Depth supervision of a scene: its views know depth, a LiDAR's, or stereo's where it is sure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from priors.adapt.objective import loss
from priors.adapt.training_step import Batch
from priors.adapt.views import LabelledView, augment_view, collate
from priors.adapt.windows import ZOOM, crop_size, random_crop
from priors.nets.bts import MonoOut


@dataclass(frozen=True)
class DepthSupervision:
    """Supervises by views with depth; see finetune.Supervision."""

    views: Sequence[LabelledView]
    """Images of one camera with the depth that is known."""
    measures: str = "mean log error"

    def batch(self, rng: np.random.Generator, count: int) -> Batch:
        """Make a batch of crops."""
        size = crop_size(self.views)
        picked = (self.views[int(rng.integers(len(self.views)))] for _ in range(count))
        return collate([augment_view(random_crop(view, rng, size, ZOOM), rng) for view in picked])

    def loss(self, out: MonoOut, batch: Batch) -> tuple[Tensor, Tensor]:
        """Return the training's loss, and the mean log error."""
        total, parts = loss(out, batch)
        return total, parts["log_error"]
