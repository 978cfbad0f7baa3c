"""Settings of a field of Gaussians: how it starts, what it minimises beside the shared losses, how it grows."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeAlias

from priors.errors import expect, expect_between, expect_choices

MOST = 20_000_000
"""More Gaussians than any machine of this kind holds."""

Rasteriser: TypeAlias = Literal["auto", "ours", "gsplat"]


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
    virtual_until: float = 0.7
    """From this share of the fit on, 0 to 1, only training frames are learned from: what the warp shows is softer."""
    normal_weight: float = 0.0
    """Weight of the loss that lays Gaussians along the surface that the rendered depth shows; 0: none."""
    appearance: bool = True
    """Learn an affine change of colour for each training frame: exposure and white balance differ."""
    low_pass_px2: float = 0.1
    """Variance that each Gaussian is widened by in the image, square pixels: more shows less noise and less detail."""
    rasteriser: Rasteriser = "auto"
    """What draws the views that are learned from. auto, ours: ours. gsplat: the package of that name, on a GPU; the
    trained field is rendered by ours in any case."""

    BEFORE: ClassVar[Mapping[str, Any]] = {
        "virtual_views": 0.0, "virtual_until": 0.8, "appearance": False, "low_pass_px2": 0.2,
    }  # fmt: skip
    GONE: ClassVar[Mapping[str, Any]] = {"robust": False}

    def __post_init__(self) -> None:
        expect_choices(self, "")
        expect_between(1, self.most_gaussians, MOST, "--most-gaussians")
        expect_between(0, self.start_step, 64, "--start-step")
        expect_between(0, self.degree, 3, "--degree")
        expect(0 <= self.dssim <= 1, "--dssim", self.dssim, "a share from 0 to 1")
        expect(0 <= self.low_pass_px2 <= 4, "--low-pass-px2", self.low_pass_px2, "0 to 4 square pixels")
        weight = self.normal_weight
        expect(0 <= weight < math.inf, "--normal-weight", weight, "0 or more")
        both = weight > 0 and self.rasteriser == "gsplat"
        expect(not both, "--normal-weight", weight, "0 with --rasteriser gsplat, which lays nothing along surfaces")
        expect(0 <= self.virtual_until <= 1, "--virtual-until", self.virtual_until, "a share from 0 to 1")
        expect(0 <= self.virtual_views < 1, "--virtual-views", self.virtual_views, "a share from 0 to below 1")
