"""Depth hints: where depth is far off, the factor by which it would explain the posed neighbours best.

The photometric error's slope leads to the truth from nearby only; from farther away it mostly leads to infinity, where
nothing moves and little is very wrong. So a few factors are tried, on small pictures, and the best is a hint where no
other comes close (after Watson et al., Depth Hints, ICCV 2019, whose hints are a stereo matcher's).
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from priors.adapt.objective import masked_mean
from priors.adapt.photometric import explain, shrink
from priors.adapt.training_step import Batch

FARTHEST, TRIED = 1.2, 21
"""Largest change of log depth that is tried, up and down, and how many changes."""
STEP = 2 * FARTHEST / (TRIED - 1)
WINDOW = 5
"""Cells across that share a factor."""
CLEAR = 0.7
"""The best factor's error is at most this share of any other's that is more than two steps away."""


@dataclass(frozen=True)
class Hints:
    """What the search found, in cells: (b, h, w) each."""

    log_depth: Tensor
    """The network's, in natural logarithms of metres; carries gradients."""
    change: Tensor
    """What should be added to it."""
    certain: Tensor
    """Where that is known."""

    @property
    def elsewhere(self) -> Tensor:
        """Where the depth is too far off for the photometric error's slope."""
        return self.certain & (self.change.abs() > 1.5 * STEP)

    def error(self) -> Tensor:
        """Return the mean distance to the hinted log depth."""
        return masked_mean((self.log_depth - (self.log_depth + self.change).detach()).abs(), self.certain)


def find_hints(inverse: Tensor, counts: Tensor, batch: Batch, stride: int, finest: int) -> Hints:
    """Search; arguments as of photometric.photometric."""
    log_depth = -shrink(inverse[:, None], stride)[:, 0].log()
    with torch.no_grad():
        tried = torch.linspace(-FARTHEST, FARTHEST, TRIED, device=inverse.device)
        errors, unmoved = explain([(log_depth + change).exp() for change in tried], batch, stride, finest)
        errors, unmoved = blur(errors), blur(unmoved[None])[0]
        least, best = errors.min(dim=0)
        away = (torch.arange(TRIED, device=best.device)[:, None, None, None] - best).abs() > 2
        other = torch.where(away, errors, math.inf).amin(dim=0)
        certain = (least < CLEAR * other) & (least < unmoved) & (best > 0) & (best < TRIED - 1)
        certain &= shrink(counts[:, None].float(), stride)[:, 0] > 0.999
    return Hints(log_depth, tried[best], certain)


def blur(errors: Tensor) -> Tensor:
    """Average maps (k, b, h, w) over windows."""
    half = WINDOW // 2
    return F.avg_pool2d(F.pad(errors, (half, half, half, half), mode="replicate"), WINDOW, stride=1)
