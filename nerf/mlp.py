"""MLPs: the two small networks of a field, features to density and geometry, geometry and direction to colour."""

from dataclasses import dataclass

import torch
from torch import Tensor

from nerf.harmonics import COUNT
from nerf.kernels import FieldKernels
from nerf.types import FEATURES, Layers
from priors.errors import DataError

GEOMETRY = 16
"""Outputs of the first network: the density's logit, and 15 numbers for the colour."""


@dataclass(frozen=True, slots=True)
class MLPConfig:
    """The size of the two networks and the density they start from."""

    width: int = 64
    """Hidden neurons, a multiple of 16 up to 128; 16 costs a third of 64 and loses little."""
    initial_density: float = 0.02
    """1/m: the density everywhere before training; 50 m of it let a third of the light through."""

    def __post_init__(self) -> None:
        if self.width % 16 or not 16 <= self.width <= 128:
            raise DataError(f"network: expected a width of 16, 32, ..., 128, found {self.width}")
        if not self.initial_density > 0:
            raise DataError(f"network: expected an initial density above 0, found {self.initial_density}")


class MLP:
    """Both networks: their float32 weights with gradients, forward and backward."""

    def __init__(
        self,
        config: MLPConfig,
        levels: int,
        device: torch.device,
        generator: torch.Generator,
        kernels: FieldKernels,
    ) -> None:
        self.config = config
        width = config.width
        shapes = [(width, FEATURES * levels), (GEOMETRY, width), (width, COUNT + GEOMETRY), (width, width), (3, width)]
        self.layers = Layers(*(_glorot(shape, generator).to(device) for shape in shapes))
        for layer in self.layers:
            layer.grad = torch.zeros_like(layer)
        self._kernels = kernels

    def density(self, features: Tensor) -> Tensor:
        """Return density (m,), 1/m, of features (levels, m, 2)."""
        return self._kernels.density(features, self.layers, self.config.initial_density)

    def density_backward(self, features: Tensor, d_sigma: Tensor) -> Tensor:
        """Set the layers' gradients and return the features', (levels, m, 2)."""
        initial = self.config.initial_density
        return self._keep(*self._kernels.density_backward(features, self.layers, initial, d_sigma))

    def shade(self, features: Tensor, harmonics: Tensor, ray: Tensor) -> tuple[Tensor, Tensor]:
        """Return density (m,) and colour (m, 3) in [0, 1] of features (levels, m, 2); harmonics (r, 16), ray (m,)."""
        return self._kernels.shade(features, harmonics, ray, self.layers, self.config.initial_density)

    def shade_backward(
        self, features: Tensor, harmonics: Tensor, ray: Tensor, d_sigma: Tensor, d_rgb: Tensor
    ) -> Tensor:
        """Set the layers' gradients and return the features', (levels, m, 2)."""
        initial = self.config.initial_density
        forward = features, harmonics, ray, self.layers, initial
        return self._keep(*self._kernels.shade_backward(*forward, d_sigma, d_rgb))

    def _keep(self, d_features: Tensor, gradients: Layers) -> Tensor:
        for layer, gradient in zip(self.layers, gradients, strict=True):
            layer.grad = gradient
        return d_features


def _glorot(shape: tuple[int, int], generator: torch.Generator) -> Tensor:
    """Return uniform weights of variance 2 / (in + out)."""
    limit = (6 / sum(shape)) ** 0.5
    return torch.empty(shape).uniform_(-limit, limit, generator=generator)
