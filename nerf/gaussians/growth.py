"""Growth: where the image asks for more Gaussians there are more, and those that show nothing are deleted.

After Kerbl et al., TOG 2023, section 5.2, but within a budget (as Kheradmand et al., "3D Gaussian Splatting as Markov
Chain Monte Carlo", NeurIPS 2024, keep one): of all Gaussians, those whose place the loss pulls at hardest are split
in two along their longest axis. Nothing is random.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nerf.gaussians.types import Gaussians, SplatGradients, SplatMoments

EVERY = 100
"""Steps from one look to the next, at least; and every training view is drawn once between two."""
FROM, UNTIL = 0.05, 0.6
"""Shares of the fit's budget between which Gaussians are densified and deleted."""
SHARE = 0.05
"""Share of the Gaussians that is densified at a time, at most."""
CLEAR = 0.02
"""A Gaussian of a smaller opacity shows nothing."""
ALONG, ACROSS = 0.6, 0.85
"""The halves of a split one are so much as long along its longest axis, and as wide."""
APART = 0.6
"""They lie so many deviations to both sides of its middle."""


@dataclass
class Growth:
    """What is known of how the loss pulls at each Gaussian since the last look."""

    pull: Tensor
    """(n,) sum of the derivative's length by the place in the image."""
    views: Tensor
    """(n,) in how many views each was seen."""

    @classmethod
    def of(cls, count: int, device: torch.device) -> "Growth":
        """Know nothing."""
        return cls(torch.zeros(count, device=device), torch.zeros(count, device=device))

    def observe(self, gradients: SplatGradients) -> None:
        """Note a step."""
        self.pull.index_add_(0, gradients.index, gradients.screen)
        self.views.index_add_(0, gradients.index, torch.ones_like(gradients.screen))

    def state(self) -> dict[str, Tensor]:
        """Return what `load` needs."""
        return {"pull": self.pull, "views": self.views}


def is_due(step: int, frames: int, progress: float) -> bool:
    """Tell whether to look after the step of a number."""
    return FROM <= progress < UNTIL and (step + 1) % max(EVERY, frames) == 0


def grown(gaussians: Gaussians, moments: SplatMoments, growth: Growth, most: int) -> tuple[Gaussians, SplatMoments]:
    """Return the Gaussians after a look, at most `most` of them, with their running means; new ones have none."""
    kept = torch.sigmoid(gaussians.opacities) > CLEAR
    seen = kept & (growth.views > 0)
    pull = torch.where(seen, growth.pull / growth.views.clamp(min=1), 0.0)
    room = min(int(SHARE * len(gaussians)), most - int(kept.sum()), int((pull > 0).sum()))
    chosen = torch.zeros_like(kept)
    if room > 0:
        chosen[torch.sort(pull, descending=True, stable=True).indices[:room]] = True
    stay = kept & ~chosen
    parts = [(gaussians.rows(stay), stay), *[(half, chosen) for half in halves(gaussians.rows(chosen))]]
    made = Gaussians(*(torch.cat([part.tensors()[name] for part, _ in parts]) for name in gaussians.tensors()))
    fresh = len(made) - int(stay.sum())
    return made, SplatMoments(
        _with_new(moments.mean.rows(stay), fresh),
        _with_new(moments.square.rows(stay), fresh),
        torch.cat([moments.unit_m[origin] for _, origin in parts]),
    )


def halves(gaussians: Gaussians) -> list[Gaussians]:
    """Split Gaussians in two along their longest axis."""
    axis = gaussians.log_scales.argmax(1, keepdim=True)
    along = matrices(gaussians.rotations).gather(2, axis[:, None, :].expand(-1, 3, 1))[..., 0]
    shift_m = APART * torch.exp(gaussians.log_scales.gather(1, axis)) * along
    factor = torch.full_like(gaussians.log_scales, math.log(ACROSS)).scatter_(1, axis, math.log(ALONG))
    rest = gaussians.rotations, gaussians.opacities, gaussians.harmonics
    smaller = gaussians.log_scales + factor
    return [Gaussians(gaussians.means_m + side * shift_m, smaller, *rest) for side in (1, -1)]


def matrices(quaternions: Tensor) -> Tensor:
    """Return rotation matrices (n, 3, 3) of quaternions (n, 4) w x y z of any length."""
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=1).unbind(1)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(rows, dim=1).view(-1, 3, 3)


def _with_new(means: Gaussians, count: int) -> Gaussians:
    """Append zeros for new Gaussians."""
    return Gaussians(*(torch.cat([x, x.new_zeros(count, *x.shape[1:])]) for x in means.tensors().values()))
