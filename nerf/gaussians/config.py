"""Settings of a field of Gaussians: how it starts, what it minimises beside the shared losses, how it grows."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from priors.errors import expect, expect_between

MOST = 20_000_000
"""More Gaussians than any machine of this kind holds."""


@dataclass(frozen=True)
class GaussianConfig:
    """What a field of Gaussians is trained by; hash fields read `appearance` alone."""

    most_gaussians: int = 400_000
    """How many Gaussians there are at most."""
    start_step: int = 0
    """At the start every so many-th pixel along rows and columns may become a Gaussian; 0: as most_gaussians allows."""
    degree: int = 1
    """Degree of the spherical harmonics of the colour, 0 to 3; 0: a place has one colour from all sides."""
    dssim: float = 0.2
    """Share of 1 - SSIM in the colour loss; the rest is the mean absolute difference."""
    densify: bool = True
    """Split Gaussians where the image asks for more of them, and delete those that show nothing."""
    virtual_views: float = 0.5
    """Share of the steps that learn from a view between two distant training frames, as the warp shows it, once each
    frame was drawn eight times; 0: none."""
    normal_weight: float = 0.0
    """Weight of the loss that lays Gaussians along the surface that the rendered depth shows; 0: none."""
    appearance: bool = True
    """Learn an affine change of colour for each training frame: exposure and white balance differ."""

    BEFORE: ClassVar[Mapping[str, Any]] = {"virtual_views": 0.0, "appearance": False}
    GONE: ClassVar[Mapping[str, Any]] = {"robust": False}

    def __post_init__(self) -> None:
        expect_between(1, self.most_gaussians, MOST, "--most-gaussians")
        expect_between(0, self.start_step, 64, "--start-step")
        expect_between(0, self.degree, 3, "--degree")
        expect(0 <= self.dssim <= 1, "--dssim", self.dssim, "a share from 0 to 1")
        weight = self.normal_weight
        expect(0 <= weight < math.inf, "--normal-weight", weight, "0 or more")
        expect(0 <= self.virtual_views < 1, "--virtual-views", self.virtual_views, "a share from 0 to below 1")
