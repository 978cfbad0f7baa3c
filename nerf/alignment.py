"""Alignment: a scale and a shift a frame, learned with the field, that bring a prior's depth to it (`--align learn`).

A frame's depth d becomes 1 / (exp(-s) / d + SHIFT b): scale and shift of the inverse depth, as a network's depth has
them (Ranftl et al., "Towards Robust Monocular Depth Estimation", TPAMI 2022). Each training step moves s and b to where
field and prior agree, by the gradient of

    mean over the frame's rays of x^2 / 2 / (1 + (x / REACH)^2), x = log(median depth of the field / aligned depth)
    + PULL / 2 ((s - median of all s)^2 + b^2)

with the prior's weights: the loss of Geman and McClure (1987), for which gross errors pull at nothing. The field in
turn is asked by the depth loss to agree with the aligned prior. The median of all s is taken off: the scale of the
drive is what the images say before the fit (nerf/evidence); field and prior could drift together.
"""

from dataclasses import replace

import torch
from torch import Tensor

from nerf.types import OPAQUE, Rays, Rendered
from nerf.world import here

SHIFT = 0.05
"""Unit of b, 1/m: at 20 m, b and s move the depth alike."""
REACH = 0.2
"""Relative errors above this pull less and less."""
PULL = 0.02
"""How firmly a frame is held to the drive."""
FARTHEST_M = 1000.0
"""No aligned depth is farther."""


class Alignment:
    """The scales and shifts of a scene's frames."""

    def __init__(self, frames: int, train: list[int], device: torch.device | str) -> None:
        """Leave the prior of so many frames as it is; `train`: which of them are learned."""
        self.log_scale, self.shift = (torch.zeros(frames, device=device) for _ in range(2))
        self._train = torch.tensor(train, device=device)

    def parameters(self) -> dict[str, Tensor]:
        """Return the trainable tensors by name: s and b, (frames,) each."""
        return {"log_scale": self.log_scale, "shift": self.shift}

    @classmethod
    def like(cls, state: dict[str, Tensor]) -> "Alignment | None":
        """Make one that can load a saved state; None where nothing was learned of a prior."""
        return cls(len(state["shift"]), list(range(len(state["shift"]))), "cpu") if "shift" in state else None

    def applied(self, frame: Tensor, rays: Rays) -> Rays:
        """Return rays (r,) of frames (r,) with the aligned depth; what is no depth is none."""
        assert rays.depth_m is not None
        known = (rays.depth_m > 0) & torch.isfinite(rays.depth_m)
        inverse = self._scaled(frame, rays.depth_m) + SHIFT * self.shift[frame]
        return replace(rays, depth_m=torch.where(known, 1 / inverse.clamp(min=1 / FARTHEST_M), 0.0))

    def learn(self, frame: Tensor, rays: Rays, weight: Tensor | None, rendered: Rendered) -> None:
        """Set the gradients.

        Args:
            frame: (r,) the rays' frames.
            rays: with the prior's own depth.
            weight: (r,) how much it counts.
            rendered: what the field shows of them.
        """
        aligned_m = self.applied(frame, rays).depth_m
        assert aligned_m is not None and rays.depth_m is not None and weight is not None
        tells = (aligned_m > 0) & (rendered.median_m > 0) & (rendered.transmittance < 1 - OPAQUE)
        weight = torch.where(tells, weight, 0.0)
        off = torch.where(tells, torch.log(rendered.median_m / aligned_m), 0.0)
        slope = weight * off / (1 + (off / REACH) ** 2) ** 2
        by_scale = torch.where(tells, aligned_m * self._scaled(frame, rays.depth_m), 0.0)  # d log(aligned) / ds
        total, size = here().total(self._summed(frame, weight)).clamp(min=1e-6), here().size
        away = self.log_scale - self.log_scale[self._train].median()
        self.log_scale.grad = self._summed(frame, -slope * by_scale) / total + PULL / size * away
        self.shift.grad = self._summed(frame, slope * SHIFT * aligned_m) / total + PULL / size * self.shift

    def _scaled(self, frame: Tensor, depth_m: Tensor) -> Tensor:
        """Return the inverse of the depth (r,) times its frame's scale, 1/m."""
        return torch.exp(self.log_scale[self._train].median() - self.log_scale[frame]) / depth_m

    def _summed(self, frame: Tensor, each: Tensor) -> Tensor:
        """Sum what rays (r,) have by their frames: (frames,)."""
        return torch.zeros_like(self.shift).index_add_(0, frame, each)
