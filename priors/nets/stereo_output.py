"""Stereo networks' results: what a stage finds, what the network returns, and maps on their way to the next stage."""

from dataclasses import dataclass
from typing import Self

import torch
import torch.nn.functional as F
from torch import Tensor

from priors.nets.upsample import convex


@dataclass
class Matched:
    """What one stage found: (b, h, w) maps in its own pixels, and what a loss needs of it."""

    disparity_px: Tensor
    sigma_px: Tensor
    logits: Tensor | None = None
    """(b, h, w, planes); None where the stage has no distribution."""
    position_px: Tensor | None = None
    """(b, h, w, planes), or broadcastable."""


@dataclass
class StereoOut:
    """What a stereo network returns: full-size maps (b, h, w), float32."""

    disparity_px: Tensor
    sigma_px: Tensor
    """Standard deviation of the last matching distribution, pixels of the image."""
    doubt: Tensor
    """Logit of an error above 1 px: confidence = sigmoid(-doubt)."""
    stages: list[Matched]
    """Coarse to fine; empty in eval mode."""

    @classmethod
    def whole(
        cls, maps: list[Tensor], doubt: Tensor, stages: list[Matched], size: tuple[int, int], *, training: bool
    ) -> Self:
        """Crop the padded answer to the image's (height, width).

        Args:
            maps: disparity and sigma (b, h, w).
            doubt: (b, 1, h / 2, w / 2), of any type.
            stages: what each stage found; kept in training only.
            size: the image's.
            training: whether the network is in training mode.
        """
        fine = F.interpolate(doubt.float(), scale_factor=2.0, mode="bilinear", align_corners=False)[:, 0]
        full, sigma, logit = (map_[:, : size[0], : size[1]] for map_ in (*maps, fine))
        return cls(full, sigma, logit, stages if training else [])

    @classmethod
    def unfinished(cls, stages: list[Matched], size: tuple[int, int]) -> Self:
        """Return the first stages' answer, for training them before the rest."""
        maps = torch.stack([stages[-1].disparity_px, stages[-1].sigma_px], dim=1)
        factor = size[1] / maps.shape[-1]
        full = factor * F.interpolate(maps, size, mode="nearest")
        return cls(full[:, 0], full[:, 1], torch.zeros_like(full[:, 0]), stages)


def finer(maps: list[Tensor], weights: Tensor) -> list[Tensor]:
    """Bring maps (b, h, w) in pixels to twice the size and unit; weights as `convex` has them."""
    return list((2 * convex(torch.stack(maps, dim=1), weights, 2)).unbind(1))
