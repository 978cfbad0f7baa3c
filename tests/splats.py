"""Scenes of Gaussians for tests."""

import math

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from nerf.gaussians.types import Drawing, Gaussians, Viewpoint
from priors.types import Camera

SMOOTH = Drawing(least_alpha=1e-6, enough=0.0)
"""No Gaussian ends where rounding could matter."""


def viewpoint(height: int = 23, width: int = 38, turned: bool = True) -> Viewpoint:
    """Return a camera near the origin that looks along z."""
    K = np.array([[0.8 * width, 0, 0.45 * width], [0, 0.9 * width, 0.52 * height], [0, 0, 1.0]])
    T = np.eye(4)
    if turned:
        T[:3, :3] = Rotation.from_euler("xyz", [0.1, 0.2, -0.1]).as_matrix()
        T[:3, 3] = 0.3, -0.1, 0.2
    return Viewpoint(Camera(K, (height, width)), T)


def cloud(n: int, coefficients: int = 1, seed: int = 0, size_m: float = 0.2) -> Gaussians:
    """Return n Gaussians ahead of such a camera, beside it, and a few behind it."""
    random = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, generator=random)

    means_m = normal(n, 3) * torch.tensor([2.0, 1.0, 3.0]) + torch.tensor([0.0, 0.0, 6.0])
    log_scales = 0.5 * normal(n, 3) + math.log(size_m)
    return Gaussians(means_m, log_scales, normal(n, 4), normal(n), 0.4 * normal(n, coefficients, 3))


def sizes(largest_m: float) -> Tensor:
    """Return the log scales (1, 3) of an ellipsoid: a ball has no gradient by its rotation."""
    return math.log(largest_m) - torch.tensor([[0.0, 0.4, 0.7]])


def one(**changes: Tensor) -> Gaussians:
    """Return a Gaussian in the middle of the view, four metres away, with other parameters than usual."""
    usual = {
        "means_m": torch.tensor([[0.1, 0.05, 4.0]]),
        "log_scales": sizes(0.3),
        "rotations": torch.tensor([[1.0, 0.2, -0.1, 0.3]]),
        "opacities": torch.tensor([0.5]),
        "harmonics": torch.full((1, 4, 3), 0.3),
    }
    return Gaussians(**{**usual, **changes})


def doubled(gaussians: Gaussians) -> Gaussians:
    """Return them in float64."""
    return Gaussians(*(x.double() for x in gaussians.tensors().values()))
