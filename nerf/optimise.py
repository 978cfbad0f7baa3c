"""Adam with a learning-rate schedule that follows the progress of the fit, whether its budget is time or steps."""

import math
from collections.abc import Collection
from dataclasses import dataclass

import torch
from torch import Tensor

from nerf.kernels import FieldKernels, kernels_for
from nerf.state import copy_into
from priors.errors import expect


@dataclass(frozen=True, slots=True)
class OptimiserConfig:
    """Learning rates and their course."""

    grid: float = 1e-2
    """Rate of the grids' features."""
    network: float = 1e-2
    """Rate of the small networks."""
    sky: float = 3e-2
    """Rate of the sky's texels."""
    alignment: float = 5e-3
    """Rate of what `--align learn` learns of a prior."""
    appearance: float = 5e-3
    """Rate of what is learned of each training frame's colours."""
    warm_up: int = 20
    """Steps over which the rates rise from nothing."""
    final: float = 1 / 30
    """What is left of the rates at the end; they fall along half a cosine."""

    def __post_init__(self) -> None:
        for name in ("grid", "network", "sky", "alignment", "appearance"):
            rate = getattr(self, name)
            expect(0 <= rate < math.inf, f"rate {name}", rate, "0 or more")
        expect(self.warm_up >= 0, "warm_up", self.warm_up, "0 steps or more")
        expect(0 <= self.final <= 1, "final", self.final, "a share from 0 to 1")

    def top(self, name: str) -> float:
        """Return the largest rate of a parameter: "sky.b" has the sky's, "a.grid" the grids', else the networks'."""
        for part in ("sky", "alignment", "appearance"):
            if name.startswith(f"{part}."):
                rate: float = getattr(self, part)
                return rate
        return self.grid if name.endswith("grid") else self.network

    def share(self, step: int, progress: float) -> float:
        """Return the share of the largest rates that the step-th step (from 1) takes, `progress` of the fit done."""
        warm = min(1.0, step / max(self.warm_up, 1))
        wave = 0.5 * (1 + math.cos(math.pi * min(max(progress, 0.0), 1.0)))
        return warm * (self.final + (1 - self.final) * wave)


class Optimiser:
    """Adam (Kingma and Ba 2015) on named parameters, their gradients in `.grad`."""

    def __init__(
        self,
        parameters: dict[str, Tensor],
        copies: dict[str, Tensor] | None = None,
        kernels: FieldKernels | None = None,
    ) -> None:
        """Take parameters by name, and rounded copies that a step keeps up to date.

        `kernels`: other functions than the device's own fastest.
        """
        self.steps = 0
        self._parameters = parameters
        self._copies = copies or {}
        self._kernels = kernels
        self._mean = {name: torch.zeros_like(tensor) for name, tensor in parameters.items()}
        self._square = {name: torch.zeros_like(tensor) for name, tensor in parameters.items()}

    def step(self, config: OptimiserConfig, progress: float, still: Collection[str] = ()) -> None:
        """Move parameters along their gradients, but for those that stand `still`; `progress` of the fit in [0, 1]."""
        self.steps += 1
        share = config.share(self.steps, progress)
        for name, tensor in self._parameters.items():
            if name in still:
                continue
            copy = self._copies.get(name)
            moments = self._mean[name], self._square[name]
            kernels = self._kernels or kernels_for(tensor.device).field
            kernels.adam(tensor, *moments, copy, share * config.top(name), self.steps)
            if copy is None:
                torch.autograd.graph.increment_version(tensor)  # kernels write unseen: tell those who keep copies

    def state(self) -> dict[str, Tensor]:
        """Return "steps" and the running means by name ("a.b.mean", "a.b.square"), not copied."""
        means = {f"{name}.mean": tensor for name, tensor in self._mean.items()}
        squares = {f"{name}.square": tensor for name, tensor in self._square.items()}
        return {"steps": torch.tensor(self.steps), **means, **squares}

    def load(self, state: dict[str, Tensor]) -> None:
        """Go on from a saved state, bit for bit; ValueError where it is of other parameters."""
        own = self.state()
        copy_into(own, state)
        self.steps = int(own["steps"])
