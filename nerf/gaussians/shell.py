"""Shell: a sky as Gaussians on a far sphere, for programs that know no sky."""

import math

import torch
from torch import Tensor

from nerf.gaussians.types import Gaussians
from nerf.harmonics import Y0
from nerf.kernels import kernels_for
from nerf.sky import Sky

RADIUS_M = 1900.0
"""How far away it is: far beyond the street, but `.spz` files hold places up to 2048 m."""
COUNT = 40_000
"""Gaussians on a whole sphere: one a square degree."""
WIDTH = 0.7
"""Their deviation, as a share of the distance between neighbours."""
OPACITY = 0.99
LEAST_TOLD = 1e-4
"""Share of the largest pull at a texel from which on a direction was seen."""


def shell_of(sky: Sky, told: Tensor, middle_m: Tensor, coefficients: int) -> Gaussians:
    """Return the parts of a sky that training saw, as Gaussians with so many harmonics.

    Args:
        sky: what is behind everything.
        told: (texels, 3) how hard training pulled at each texel of the sky: Adam's mean of squares.
        middle_m: (3,) where the scene is.
        coefficients: 1, 4, 9 or 16.
    """
    units = spread_directions(COUNT).to(middle_m.device)
    units = units[_is_seen(sky, told, units)]
    rgb = sky.forward(units)
    count = len(units)
    width_m = WIDTH * RADIUS_M * math.sqrt(4 * math.pi / COUNT)
    harmonics = units.new_zeros(count, coefficients, 3)
    harmonics[:, 0] = (rgb - 0.5) / Y0
    rotations = units.new_zeros(count, 4)
    rotations[:, 0] = 1
    return Gaussians(
        middle_m + RADIUS_M * units,
        units.new_full((count, 3), math.log(width_m)),
        rotations,
        units.new_full((count,), math.log(OPACITY / (1 - OPACITY))),
        harmonics,
    )


def _is_seen(sky: Sky, told: Tensor, units: Tensor) -> Tensor:
    """Tell which directions (n, 3) training pulled at: those of the finest picture's texels."""
    finest = told.clone()
    finest[: -(sky.config.sizes[-1] ** 2)] = 0
    pulled = kernels_for(told.device).render.look(finest, units, sky.config.sizes).sum(1)
    return pulled > LEAST_TOLD * finest.sum(1).max()


def spread_directions(count: int) -> Tensor:
    """Return unit directions (count, 3), evenly spread: a Fibonacci lattice (González, Math. Geosci. 2010)."""
    number = torch.arange(count, dtype=torch.float64)
    z = 1 - (2 * number + 1) / count
    angle = number * math.pi * (3 - math.sqrt(5))
    ring = torch.sqrt(1 - z * z)
    return torch.stack([ring * torch.cos(angle), ring * torch.sin(angle), z], dim=1).float()
