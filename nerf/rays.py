"""Rays in the drive's metric frame. `t` along a ray is camera-z depth in metres, because directions have z = 1."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True)
class Rays:
    """A batch of rays and what is known about each; all tensors are float32 on one device."""

    origins_m: Tensor
    """(r, 3) camera centres, world, metres."""
    directions: Tensor
    """(r, 3) world directions whose camera-z component is 1: origin + t * direction lies at camera-z depth t."""
    rgb: Tensor | None = None
    """(r, 3) colours in [0, 1]; None when rendering new views."""
    depth_m: Tensor | None = None
    """(r,) the prior's camera-z depth, 0 = no value; None without a prior."""
    weight: Tensor | None = None
    """(r,) how much the prior's value counts, [0, 1]; None: 1 where there is a value."""

    pixel: float = 0.0
    """Width of a pixel at a camera-z depth of 1: 1 / focal length in pixels; 0: rays are lines."""

    def to(self, device: torch.device) -> "Rays":
        """Return the rays on a device."""
        rgb, depth_m, weight = (None if x is None else x.to(device) for x in (self.rgb, self.depth_m, self.weight))
        return Rays(self.origins_m.to(device), self.directions.to(device), rgb, depth_m, weight, self.pixel)

    def __len__(self) -> int:
        return self.origins_m.shape[0]

    @property
    def norms(self) -> Tensor:
        """(r,) metres along the ray per metre of camera-z depth."""
        return torch.linalg.vector_norm(self.directions, dim=-1)

    @property
    def units(self) -> Tensor:
        """(r, 3) unit directions, what colour depends on."""
        return self.directions / self.norms[:, None]
