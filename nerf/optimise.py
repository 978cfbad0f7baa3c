"""Adam with a learning rate that follows the progress of the fit, whether its budget is time or steps."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True)
class OptimiserConfig:
    """Learning rates and their course."""

    grid: float = 1e-2
    """Rate of the grids' features."""
    network: float = 1e-2
    """Rate of the small networks."""
    sky: float = 3e-2
    """Rate of the sky's texels."""
    warm_up: int = 20
    """Steps over which the rates rise from nothing."""
    final: float = 1 / 30
    """What is left of the rates at the end; they fall along half a cosine."""


class Optimiser:
    """Adam (Kingma and Ba 2015) on named parameters, their gradients in `.grad`: torch's fused step, one pass."""

    def __init__(self, config: OptimiserConfig, parameters: dict[str, Tensor]) -> None:
        """Take parameters by name; the rate of "a.b" is that of `grid` if b is "grid", of `sky` if a is "sky"."""
        self.config = config
        self.steps = 0
        self._parameters = parameters
        self._adam = torch.optim.Adam(
            [{"params": [tensor], "lr": 0.0, "rate": self._rate(name)} for name, tensor in parameters.items()],
            betas=(0.9, 0.99),
            eps=1e-15,
            fused=True,
        )

    def step(self, progress: float) -> None:
        """Move every parameter along its gradient; `progress` of the fit in [0, 1]."""
        warm = min(1.0, (self.steps + 1) / max(self.config.warm_up, 1))
        left = self.config.final + (1 - self.config.final) * 0.5 * (
            1 + math.cos(math.pi * min(max(progress, 0.0), 1.0))
        )
        for group in self._adam.param_groups:
            group["lr"] = group["rate"] * warm * left
        self._adam.step()
        torch.autograd.graph.increment_version(list(self._parameters.values()))  # the fused step does not; copies ask
        self.steps += 1

    def state(self) -> dict[str, Tensor]:
        """Return the running means by name ("a.b.mean", "a.b.square"), and "steps"."""
        state = {"steps": torch.tensor(self.steps)}
        for name, tensor in self._parameters.items():
            if found := self._adam.state.get(tensor):
                state[f"{name}.mean"], state[f"{name}.square"] = found["exp_avg"], found["exp_avg_sq"]
        return state

    def load(self, state: dict[str, Tensor]) -> None:
        """Go on from a saved state, bit for bit."""
        self.steps = int(state["steps"])
        for name, tensor in self._parameters.items():
            if self.steps:
                self._adam.state[tensor] = {
                    "step": torch.tensor(float(self.steps), device=tensor.device),
                    "exp_avg": state[f"{name}.mean"].to(tensor.device, copy=True),
                    "exp_avg_sq": state[f"{name}.square"].to(tensor.device, copy=True),
                }

    def _rate(self, name: str) -> float:
        if name.startswith("sky."):
            return self.config.sky
        return self.config.grid if name.endswith("grid") else self.config.network
