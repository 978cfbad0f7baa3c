"""Kernels: the fast functions of field, renderer, sampler and splatting.

A folder a kind of device; `kernels_for` is the one door.

    cpu     compiled for one thread each by numba, run by a pool of threads
    triton  compiled for a GPU; samples are drawn by `plain`, for Triton has no sampler of ours
    plain   any other device: the twin in plain PyTorch (nerf/twin/) and its autograd

Nobody else asks which device it is. Shapes are those of the twin.
"""

import functools
from importlib.util import find_spec
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from nerf.gaussians.types import (
    Behind,
    ColourLoss,
    Contributions,
    Drawing,
    Gaussians,
    Rasterised,
    Rates,
    Shown,
    ShownGradients,
    SplatGradients,
    SplatMoments,
    ViewGradients,
    Viewpoint,
)
from nerf.types import Course, Extent, Gradients, GridConfig, Histogram, Layers, Rendered, Samples, Target


class FieldKernels(Protocol):
    """The functions of the field: a hash grid, two small networks, and their optimiser.

    The number of samples m is a multiple of SAMPLES_MULTIPLE.
    """

    STORAGE: torch.dtype
    """The type in which the grid's weights are read."""
    SAMPLES_MULTIPLE: int
    """How many samples the kernels take at a time."""

    def encode(self, u: Tensor, table: Tensor, footprint: Tensor | None, weights: Tensor, config: GridConfig) -> Tensor:
        """Return features (levels, m, 2) of places u (m, 3)."""

    def spread(
        self,
        u: Tensor,
        table: Tensor,
        footprint: Tensor | None,
        d_features: Tensor,
        config: GridConfig,
        d_weights: Tensor,
    ) -> None:
        """Set d_weights (tables, rows, 2) to the gradient of the weights."""

    def density(self, features: Tensor, layers: Layers, initial: float) -> Tensor:
        """Return density (m,)."""

    def density_backward(
        self, features: Tensor, layers: Layers, initial: float, d_sigma: Tensor
    ) -> tuple[Tensor, Layers]:
        """Return the gradients of the features and of the layers (zero for the colour's)."""

    def shade(
        self, features: Tensor, harmonics: Tensor, ray: Tensor, layers: Layers, initial: float
    ) -> tuple[Tensor, Tensor]:
        """Return density (m,) and colour (m, 3)."""

    def shade_backward(
        self,
        features: Tensor,
        harmonics: Tensor,
        ray: Tensor,
        layers: Layers,
        initial: float,
        d_sigma: Tensor,
        d_rgb: Tensor,
    ) -> tuple[Tensor, Layers]:
        """Return the gradients of the features (levels, m, 2) and of the layers."""

    def adam(self, weights: Tensor, mean: Tensor, square: Tensor, copy: Tensor | None, rate: float, step: int) -> None:
        """Do the step-th (from 1) step of Adam with the gradient in `.grad`; round the weights to `copy`."""


class RenderKernels(Protocol):
    """Volume rendering (Max, TVCG 1995) of packed samples, and the losses that look at single samples."""

    def forward(self, samples: Samples, sigma: Tensor, rgb: Tensor, sky: Tensor) -> Rendered:
        """Composite samples near to far: density (m,), 1/m, and colour (m, 3) before a sky (r, 3).

        w = T (1 - exp(-sigma dt)), T the product of exp(-sigma dt) before.
        """

    def backward(
        self, samples: Samples, sigma: Tensor, rgb: Tensor, sky: Tensor, rendered: Rendered, gradients: Gradients
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the loss's derivatives by sigma (m,), rgb (m, 3) and sky (r, 3)."""

    def kl(self, samples: Samples, sigma: Tensor, target: Target, scale: Tensor, d_tau: Tensor) -> Tensor:
        """Return the KL loss (r,), add its gradient to d_tau (m,)."""

    def sight(self, samples: Samples, weights: Tensor, target: Target, scale: Tensor, d_weights: Tensor) -> Tensor:
        """Return URF's line-of-sight loss (r,), add its gradient to d_weights (m,)."""

    def distortion(self, samples: Samples, weights: Tensor, scale: Tensor, d_weights: Tensor) -> Tensor:
        """Return the distortion (r,), add its gradient to d_weights (m,)."""

    def interlevel(
        self, samples: Samples, weights: Tensor, coarse: Samples, coarse_weights: Tensor, scale: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the interlevel loss (r,) and its gradient by the coarse weights (m,)."""

    def look(self, texels: Tensor, units: Tensor, sizes: tuple[int, ...]) -> Tensor:
        """Return what the sky's pictures (texels, 3) sum up to in unit directions (r, 3): nerf.twin.sky."""

    def paint(self, d_sums: Tensor, units: Tensor, sizes: tuple[int, ...], d_texels: Tensor) -> None:
        """Set the texels' gradient (texels, 3) from that of the sums, (r, 3)."""


class SampleKernels(Protocol):
    """The functions of the samplers."""

    def pick(self, course: Course, kept: Tensor | None, resolution: int) -> Samples:
        """Return the candidates whose middle lies in a kept cell (flat uint8 grid; None: all), padded."""

    def resample(self, histogram: Histogram, targets: Tensor) -> Tensor:
        """Return the ends (2, r, n) in s of n intervals of even mass under a histogram: nerf.twin.sample.resample.

        targets: (r, n + 1) places of the ends in the cumulated mass, ascending in [0, 1].
        """

    def stretch(self, u: Tensor, table: Tensor, extent: Extent) -> Tensor:
        """Return the metres (n,) that one unit of u spans at u (n, 3) of tables (n,): nerf.twin.space.stretch."""

    def note(self, thickness: Tensor, u: Tensor, table: Tensor, sigma: Tensor, extent: Extent, decay: float) -> None:
        """Note densities (m,), 1/m, at u (m, 3) of tables (m,) in an occupancy grid: nerf.twin.occupancy.note."""

    def prune(self, thickness: Tensor, allowed: Tensor, thin: float, kept: Tensor) -> None:
        """Decide which cells of an occupancy grid are kept: nerf.twin.occupancy.prune."""


class Rasteriser(Protocol):
    """Draws n Gaussians, v of them in view of h x w pixels (Kerbl et al., SIGGRAPH 2023), and goes back."""

    def rasterise(
        self, gaussians: Gaussians, viewpoint: Viewpoint, drawing: Drawing, background: Tensor | None = None
    ) -> Rasterised:
        """Draw Gaussians near to far; background: (h, w, 3) or (3,) colours behind them, None: black."""

    def backward(self, rasterised: Rasterised, gradients: ViewGradients) -> SplatGradients:
        """Return a loss's derivatives by the Gaussians in view; the background's is d_rgb (1 - opacity)."""


class SplatKernels(Rasteriser, Protocol):
    """Gaussian splatting: the rasteriser, and all else that a step of training takes."""

    def contributions(self, rasterised: Rasterised, pixels: Tensor) -> Contributions:
        """Return what pixels (r,) int64, row * width + column, are made of."""

    def show(self, seen: Rasterised, behind: Behind) -> Shown:
        """Return what a frame shows of what was rasterised before black: the sky behind it, in the frame's colours."""

    def unshow(self, seen: Rasterised, shown: Shown, d_rgb: Tensor) -> ShownGradients:
        """Return a loss's derivatives from those (h, w, 3) by what is shown."""

    def adam(
        self, gaussians: Gaussians, gradients: SplatGradients, moments: SplatMoments, rates: Rates, step: int
    ) -> None:
        """Do the step-th (from 1) step of Adam for the Gaussians in view, in place; rotations come out of length 1."""

    def colour_loss(self, rgb: Tensor, truth: Tensor, share: float, weight: Tensor | None = None) -> ColourLoss:
        """Return (1 - share) L1 + share (1 - SSIM) of pictures (h, w, 3) in [0, 1], and its derivative by rgb.

        SSIM has a Gaussian window of 11 x 11 pixels, deviation 1.5, and is averaged over the windows that lie inside:
        scikit-image's `structural_similarity` with gaussian_weights. weight: (h, w) of each pixel in the means of both,
        in SSIM's that of the window's middle; None: 1. ValueError for less than 11 x 11 pixels where share > 0.
        """


class Kernels(NamedTuple):
    """All functions for one kind of device."""

    field: FieldKernels
    render: RenderKernels
    sample: SampleKernels
    splat: SplatKernels


def kernels_for(device: torch.device) -> Kernels:
    """Return the fastest functions for a device."""
    if device.type == "cpu":
        return cpu_kernels()
    return triton_kernels() if _runs_triton(device) else plain_kernels()


def rasteriser_for(device: torch.device, name: str) -> Rasteriser:
    """Return what draws the views that Gaussians learn from: "gsplat", else ours.

    Raises:
        DataError: gsplat is not installed, or the device is no GPU.
    """
    if name != "gsplat":
        return kernels_for(device).splat
    from nerf.kernels import gsplat

    gsplat.expect_usable(device)
    return gsplat


@functools.cache
def cpu_kernels() -> Kernels:
    """Return what numba compiled for this CPU."""
    from nerf.kernels.cpu import field, render, sample, splat

    return Kernels(field, render, sample, splat)


@functools.cache
def triton_kernels() -> Kernels:
    """Return what Triton compiles for a GPU; the sampler is the plain one."""
    from nerf.kernels.plain import sample
    from nerf.kernels.triton import field, render, splat

    return Kernels(field, render, sample, splat)


@functools.cache
def plain_kernels() -> Kernels:
    """Return plain PyTorch."""
    from nerf.kernels.plain import field, render, sample, splat

    return Kernels(field, render, sample, splat)


@functools.cache
def _runs_triton(device: torch.device) -> bool:
    """Say whether it is a GPU with bfloat16 products, and torch came with Triton (not so on Windows)."""
    if device.type != "cuda" or find_spec("triton") is None:
        return False
    return torch.cuda.get_device_capability(device) >= (8, 0)
