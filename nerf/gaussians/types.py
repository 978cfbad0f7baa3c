"""The data of Gaussian splatting: Gaussians, how they are drawn, what was drawn, and gradients.

Kernels read this file, so it lies above them. Its tensors are float32 and contiguous, on one device.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from priors.errors import expect
from priors.types import Camera, Matrix

MOST_ALPHA = 0.999
"""A Gaussian stops at most so much of the light at a pixel: what is behind it still has a gradient."""
SIDE_REACH = 1.3
"""A Gaussian's shape is that which it has at most so many half images from the middle: farther out, a perspective's
derivative says little of the perspective."""
MOST_SPREAD_PX = 1e6
"""A Gaussian that would be wider than this is drawn as a smaller one: its standard deviation in the image, pixels."""
MOST_M = 1e12
"""A Gaussian is drawn as if its standard deviation were at most so many metres: float32 holds the squares."""
LEAST_TURN = 1e-20
"""A quaternion of a smaller squared length is no rotation: it turns nothing, and has no gradient."""
SIZES = (1, 4, 9, 16)
"""How many coefficients spherical harmonics of degree 0, 1, 2 and 3 have."""


@dataclass(frozen=True, slots=True)
class Gaussians:
    """n Gaussians in the scene's metric frame, as training holds them.

    A Gaussian's covariance is R diag(exp(log_scales))^2 R^T. Its colour from a unit direction d (camera centre to mean,
    in the scene's frame) is max(0, 0.5 + sum_k harmonics_k Y_k(d)), Y those of nerf.harmonics: what the .ply files of
    3D Gaussian splatting mean (Kerbl et al., SIGGRAPH 2023).
    """

    means_m: Tensor
    """(n, 3) metres."""
    log_scales: Tensor
    """(n, 3) natural logarithm of the standard deviation along each axis, metres."""
    rotations: Tensor
    """(n, 4) quaternion w x y z from the Gaussian's axes to the scene's, of any length; 0 turns nothing."""
    opacities: Tensor
    """(n,) logits: the opacity at the mean is 1 / (1 + exp(-x))."""
    harmonics: Tensor
    """(n, k, 3) colour coefficients, k = 1, 4, 9 or 16."""

    def __len__(self) -> int:
        return len(self.means_m)

    def tensors(self) -> dict[str, Tensor]:
        """Return the parameters by name, not copied."""
        return {name: getattr(self, name) for name in NAMES}

    def zeros(self) -> "Gaussians":
        """Return zeros of the same shapes: running means, or gradients."""
        return Gaussians(*(torch.zeros_like(tensor) for tensor in self.tensors().values()))

    def rows(self, index: Tensor) -> "Gaussians":
        """Return some of the Gaussians, copied: index (v,) int64, or bool (n,)."""
        return Gaussians(*(tensor[index] for tensor in self.tensors().values()))


NAMES = ("means_m", "log_scales", "rotations", "opacities", "harmonics")
"""The parameters of Gaussians, in order."""


@dataclass(frozen=True, slots=True)
class Drawing:
    """How Gaussians are drawn."""

    degree: int = 3
    """Degree of the spherical harmonics that count, 0 to 3; at most what the Gaussians have."""
    low_pass_px2: float = 0.2
    """Variance that is added to each Gaussian in the image, square pixels: a pixel is no point."""
    compensate: bool = True
    """Take as much opacity as that variance adds (Mip-Splatting: Yu et al., CVPR 2024, eq. 9)."""
    enough: float = 1e-3
    """A pixel is finished when less of its light than this is left; 0: never."""
    cap_m: float = 100.0
    """Depth counts as at most so much in `depth_sum`, and has no gradient beyond: a far sky would outweigh surfaces."""
    near_m: float = 0.2
    """What lies nearer to the camera's plane than this is not drawn."""
    least_alpha: float = 1 / 255
    """A Gaussian that stops less of the light at a pixel is not there."""
    median: bool = True
    """Find the depth that half of the light comes from beyond; training can do without."""

    def __post_init__(self) -> None:
        expect(self.degree in range(len(SIZES)), "degree", self.degree, "0, 1, 2 or 3")
        expect(0 <= self.low_pass_px2 < math.inf, "low_pass_px2", self.low_pass_px2, "0 square pixels or more")
        expect(0 <= self.enough < 1, "enough", self.enough, "a share from 0 to less than 1")
        expect(self.cap_m > 0, "cap_m", self.cap_m, "more than 0 m")
        expect(0 < self.near_m < math.inf, "near_m", self.near_m, "more than 0 m")
        expect(0 < self.least_alpha < MOST_ALPHA, "least_alpha", self.least_alpha, "a share above 0")


class Viewpoint(NamedTuple):
    """From where Gaussians are drawn."""

    camera: Camera
    T_world_cam: Matrix
    """(4, 4) the camera's pose in the scene's frame, metres."""


@dataclass(frozen=True, slots=True)
class Rasterised:
    """What a camera sees of Gaussians."""

    rgb: Tensor
    """(height, width, 3) colour: sum w_i colour_i + (1 - opacity) background; not clamped above."""
    depth_sum: Tensor
    """(height, width) sum w_i min(z_i, cap_m), z_i the camera-z depth of a Gaussian's mean, metres."""
    opacity: Tensor
    """(height, width) sum w_i: the share of the light that Gaussians stop, [0, 1]."""
    median_m: Tensor
    """(height, width) z of the Gaussian at which half of the light is stopped, uncapped; 0 where it never is, and
    everywhere without `Drawing.median`."""
    index: Tensor
    """(v,) int64, ascending: the Gaussians that reach a pixel of the image."""
    radii_px: Tensor
    """(v,) half the distance of the first and last pixel that each reaches in the image, along its longer side."""
    kept: Any
    """What the way back needs; the kernels' own."""

    def depth_m(self, floor: float = 1e-3) -> Tensor:
        """Return the expected camera-z depth (height, width): depth_sum / max(opacity, floor)."""
        return self.depth_sum / self.opacity.clamp(min=floor)


@dataclass(frozen=True, slots=True)
class Contributions:
    """What each of r pixels is made of, packed near to far: pixel i has offsets[i] to offsets[i + 1].

    Offsets, weights and depths are as in nerf.types.Samples and Rendered: the losses of single samples take them.
    """

    pixels: Tensor
    """(r,) int64: row * width + column."""
    offsets: Tensor
    """(r + 1,) int64; the last is m."""
    gaussian: Tensor
    """(m,) int64 which Gaussian."""
    alphas: Tensor
    """(m,) share of the light that arrives at it and is stopped there; optical depth tau = -log(1 - alpha)."""
    weights: Tensor
    """(m,) share of the pixel's light that it stops: w_i = alpha_i prod_{j < i} (1 - alpha_j)."""
    depths_m: Tensor
    """(m,) camera-z depth of its mean, metres, uncapped."""
    kept: Any = None
    """What the way back needs; the kernels' own."""


@dataclass(frozen=True, slots=True)
class ViewGradients:
    """Derivatives of a loss by what was rasterised; None: 0."""

    rgb: Tensor
    """(height, width, 3)"""
    depth_sum: Tensor | None = None
    """(height, width)"""
    opacity: Tensor | None = None
    """(height, width)"""
    contributions: Contributions | None = None
    """The pixels that the next two are of."""
    weights: Tensor | None = None
    """(m,) by the contributions' weights."""
    tau: Tensor | None = None
    """(m,) by the contributions' optical depths themselves, for losses of log w."""


@dataclass(frozen=True, slots=True)
class SplatGradients:
    """Derivatives of a loss by the parameters of the v Gaussians that are in view; the others have none."""

    index: Tensor
    """(v,) int64, ascending: which Gaussians, `Rasterised.index`."""
    of: Gaussians
    """(v, ...) by each parameter; `harmonics` (v, k', 3) of the degree that was drawn, k' <= k."""
    screen: Tensor
    """(v,) length of the derivative by the mean's place in the image, 1/pixel: what densifying looks at."""
    twist: Tensor
    """(6,) by a small motion of the scene in the camera's frame, x_cam -> x_cam + v + w cross x_cam: v (1/m), w
    (1/rad). A camera moves the other way: T_world_cam exp(-twist)."""


class Rates(NamedTuple):
    """How far a step of Adam goes, at most about so much a step."""

    means: float
    """Shares of each Gaussian's unit, `SplatMoments.unit_m`."""
    log_scales: float
    rotations: float
    """Half radians."""
    opacities: float
    colours: float
    """Of harmonics of degree 0."""
    view: float
    """Of the other harmonics."""


@dataclass(frozen=True, slots=True)
class SplatMoments:
    """Adam's running means of n Gaussians; a Gaussian that is not in view keeps its own."""

    mean: Gaussians
    """Of the gradients."""
    square: Gaussians
    """Of their squares."""
    unit_m: Tensor
    """(n,) metres that the mean's rate is a share of: a pixel's footprint at the Gaussian."""


class ColourLoss(NamedTuple):
    """What unlike pictures cost."""

    absolute: float
    """Mean of |rgb - truth|."""
    dissimilarity: float
    """1 - SSIM."""
    total: float
    """(1 - share) absolute + share * dissimilarity."""
    d_rgb: Tensor
    """(height, width, 3) derivative of the total."""


class Behind(NamedTuple):
    """What lies behind Gaussians, and how a frame's colours differ from theirs."""

    texels: Tensor
    """(t, 3) of the sky's pictures, one after the other: the sigmoid of what they sum up to is its colour."""
    sizes: tuple[int, ...]
    """Texels along a side of each."""
    units: Tensor
    """(h * w, 3) unit directions through the pixels, in the camera's frame."""
    rotation: Tensor
    """(3, 3) from the camera's frame to the scene's."""
    change: Tensor | None
    """(3, 4) A - 1 and b of a frame's affine change of colour; None: there is none."""
    clear: float
    """The sky is seen where more light than this share passes, and learns there."""


class Shown(NamedTuple):
    """What a frame shows."""

    rgb: Tensor
    """(h, w, 3), not clamped."""
    behind: Behind
    kept: Any
    """What the way back needs; the kernels' own."""


class ShownGradients(NamedTuple):
    """Derivatives of a loss by what a frame's picture is made of."""

    rgb: Tensor
    """(h, w, 3) by `Rasterised.rgb`."""
    opacity: Tensor
    """(h, w) by `Rasterised.opacity`: what the sky gives."""
    texels: Tensor
    """(t, 3)"""
    change: Tensor | None
    """(3, 4); None: there is no change."""
