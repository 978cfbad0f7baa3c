"""Appearance: an affine change of colour for each training frame, as exposure and white balance change it.

A frame shows A c + b of what the Gaussians show, c, in [0, 1] (as in Urban Radiance Fields, Rematas et al., CVPR 2022,
section 3.2). A and b are learned with the Gaussians and held to no change. A view that is no training frame shows the
mean of its two nearest training frames, by how near they are: its own image is never asked.
"""

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nerf.harmonics import Y0
from nerf.warp.frames import unlike_m
from priors.types import Matrix

RATE = 1e-2
"""A step of Adam moves a number by about so much at most: in a minute a frame of many is drawn twenty times."""
PULL = 0.01
"""How firmly numbers are held to no change: the loss is PULL times their squared change, summed."""
BETAS, EPSILON = (0.9, 0.99), 1e-8
GREY = 0.5
"""The colour of a Gaussian without coefficients."""
NEAREST = 2
"""Training frames that a view between them is shown as."""


class Appearance:
    """The changes of colour of n training frames."""

    def __init__(self, T_world_cam: npt.NDArray[np.float64], device: torch.device) -> None:
        """Change nothing; poses (n, 4, 4) of the training frames."""
        self.poses = torch.from_numpy(np.ascontiguousarray(T_world_cam))
        self.change = torch.zeros(len(T_world_cam), 3, 4, device=device)
        """(n, 3, 4) A - 1 and b."""
        self._mean, self._square = torch.zeros_like(self.change), torch.zeros_like(self.change)
        self._steps = torch.zeros(len(T_world_cam), dtype=torch.int64)

    def at(self, T_world_cam: Matrix) -> Tensor:
        """Return the change (3, 4) of a view: the training frame's that stands there, else of its nearest."""
        away_m = unlike_m(self.poses.numpy(), T_world_cam)
        near = np.argsort(away_m, kind="stable")[:NEAREST]
        closeness = 1 / np.maximum(away_m[near], 1e-9)
        shares = torch.from_numpy(closeness / closeness.sum()).to(self.change)
        return (shares[:, None, None] * self.change[torch.from_numpy(near).to(self.change.device)]).sum(0)

    def learn(self, which: int, d_change: Tensor, share: float) -> None:
        """Do a step of Adam for a training frame.

        Args:
            which: number of the frame.
            d_change: (3, 4) the colour loss's derivative by its change.
            share: of the largest rate.
        """
        change = self.change[which]
        gradient = d_change + 2 * PULL * change
        self._steps[which] += 1
        step, (beta, gamma) = int(self._steps[which]), BETAS
        mean, square = self._mean[which], self._square[which]
        mean.mul_(beta).add_(gradient, alpha=1 - beta)
        square.mul_(gamma).addcmul_(gradient, gradient, value=1 - gamma)
        away = (square / (1 - gamma**step)).sqrt() + EPSILON
        change -= share * RATE * mean / (1 - beta**step) / away

    def usual(self, harmonics: Tensor) -> Tensor:
        """Return colour coefficients (n, k, 3) as the mean of all frames shows them: other programs know no frames."""
        change = self.change.mean(0)
        turned = harmonics + harmonics @ change[:, :3].T
        turned[:, 0] += (GREY * change[:, :3].sum(1) + change[:, 3]) / Y0
        return turned

    def state(self) -> dict[str, Tensor]:
        """Return what `load` needs, not copied."""
        moments = {"mean": self._mean, "square": self._square, "steps": self._steps}
        return {"poses": self.poses, "change": self.change, **moments}

    @classmethod
    def loaded(cls, state: dict[str, Tensor], device: torch.device) -> "Appearance":
        """Make a saved one again; ValueError where a tensor is missing."""
        missing = [name for name in ("poses", "change", "mean", "square", "steps") if name not in state]
        if missing:
            raise ValueError(f"expected appearance.{missing[0]}, found none")
        made = cls(state["poses"].double().numpy(), device)
        for name, own in made.state().items():
            own.copy_(state[name])
        return made
