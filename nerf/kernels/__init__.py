"""Fast versions of the field's functions, one module a kind of device; the trainer never asks which.

Each module offers what `Kernels` lists. On any device without one, `plain` answers: the twin and its autograd.
"""

import functools
from importlib.util import find_spec
from typing import TYPE_CHECKING, Protocol

import torch
from torch import Tensor

if TYPE_CHECKING:
    from nerf.grid import GridConfig
    from nerf.render import Gradients, Rendered
    from nerf.samples import Samples
    from nerf.twin.field import Layers


class Kernels(Protocol):
    """The functions of the field; shapes as in the twin. m is a multiple of BLOCK."""

    STORAGE: torch.dtype
    """The type in which the grid's weights are read."""
    BLOCK: int
    """The numbers of samples that the functions take are multiples of this."""

    def encode(
        self, u: Tensor, table: Tensor, footprint: Tensor | None, weights: Tensor, config: "GridConfig"
    ) -> Tensor:
        """Return features (levels, m, 2) of places u (m, 3)."""

    def spread(
        self,
        u: Tensor,
        table: Tensor,
        footprint: Tensor | None,
        d_features: Tensor,
        config: "GridConfig",
        d_weights: Tensor,
    ) -> None:
        """Set d_weights (tables, rows, 2) to the gradient of the weights."""

    def density(self, features: Tensor, layers: "Layers", initial: float) -> Tensor:
        """Return density (m,)."""

    def density_backward(
        self, features: Tensor, layers: "Layers", initial: float, d_sigma: Tensor
    ) -> tuple[Tensor, "Layers"]:
        """Return the gradients of the features and of the layers (zero for the colour's)."""

    def shade(
        self, features: Tensor, harmonics: Tensor, ray: Tensor, layers: "Layers", initial: float
    ) -> tuple[Tensor, Tensor]:
        """Return density (m,) and colour (m, 3)."""

    def shade_backward(
        self,
        features: Tensor,
        harmonics: Tensor,
        ray: Tensor,
        layers: "Layers",
        initial: float,
        d_sigma: Tensor,
        d_rgb: Tensor,
    ) -> tuple[Tensor, "Layers"]:
        """Return the gradients of the features (levels, m, 2) and of the layers."""

    def adam(self, weights: Tensor, mean: Tensor, square: Tensor, copy: Tensor | None, rate: float, step: int) -> None:
        """Do the step-th (from 1) step of Adam with the gradient in `.grad`; round the weights to `copy`."""


def kernels_for(device: torch.device) -> Kernels:
    """Return the fastest functions for a device."""
    if device.type == "cpu":
        from nerf.kernels import cpu

        return cpu
    if _runs_triton(device):
        from nerf.kernels import triton_field

        return triton_field
    from nerf.kernels import plain

    return plain


class Renderer(Protocol):
    """The functions of the renderer and of the losses that look at samples; shapes as nerf.render and nerf.losses."""

    def render(self, samples: "Samples", sigma: Tensor, rgb: Tensor, sky: Tensor) -> "Rendered":
        """Composite."""

    def backward(
        self,
        samples: "Samples",
        sigma: Tensor,
        rgb: Tensor,
        sky: Tensor,
        rendered: "Rendered",
        gradients: "Gradients",
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the derivatives by sigma, rgb and sky."""

    def kl(
        self,
        samples: "Samples",
        sigma: Tensor,
        norms: Tensor,
        prior_m: Tensor,
        deviation_m: Tensor,
        scale: Tensor,
        d_tau: Tensor,
    ) -> Tensor:
        """Return the KL loss (r,), add its gradient to d_tau (m,)."""

    def sight(
        self,
        samples: "Samples",
        weights: Tensor,
        norms: Tensor,
        prior_m: Tensor,
        deviation_m: Tensor,
        scale: Tensor,
        d_weights: Tensor,
    ) -> Tensor:
        """Return URF's line-of-sight loss (r,), add its gradient to d_weights (m,)."""

    def distortion(self, samples: "Samples", weights: Tensor, scale: Tensor, d_weights: Tensor) -> Tensor:
        """Return the distortion (r,), add its gradient to d_weights (m,)."""

    def interlevel(
        self, samples: "Samples", weights: Tensor, coarse: "Samples", coarse_weights: Tensor, scale: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the interlevel loss (r,) and its gradient by the coarse weights (m,)."""


def renderer_for(device: torch.device) -> Renderer:
    """Return the fastest renderer for a device."""
    if device.type == "cpu":
        from nerf.kernels import render_cpu

        return render_cpu
    if _runs_triton(device):
        from nerf.kernels import triton_render

        return triton_render
    from nerf.kernels import render_plain

    return render_plain


@functools.cache
def _runs_triton(device: torch.device) -> bool:
    """Say whether it is a GPU with bfloat16 products, and torch came with Triton (not so on Windows)."""
    if device.type != "cuda" or find_spec("triton") is None:
        return False
    return torch.cuda.get_device_capability(device) >= (8, 0)
