"""The field's functions by the twin and its autograd: any device, no compiler."""

import torch
from torch import Tensor

from nerf.twin import adam as twin_adam
from nerf.twin import encode as twin_encode
from nerf.twin import field as twin_field
from nerf.types import GridConfig, Layers

STORAGE = torch.float32
SAMPLES_MULTIPLE = 1


def encode(u: Tensor, table: Tensor, footprint: Tensor | None, weights: Tensor, config: GridConfig) -> Tensor:
    """Return features (levels, m, 2)."""
    return twin_encode.encode(u, table, footprint, weights, config)


def spread(
    u: Tensor, table: Tensor, footprint: Tensor | None, d_features: Tensor, config: GridConfig, d_weights: Tensor
) -> None:
    """Set d_weights to the gradient of the weights."""
    with torch.enable_grad():
        weights = torch.zeros_like(d_weights).requires_grad_()  # the features are linear in them
        features = twin_encode.encode(u, table, footprint, weights, config)
        d_weights.copy_(torch.autograd.grad(features, weights, d_features)[0])


def density(features: Tensor, layers: Layers, initial: float) -> Tensor:
    """Return density (m,)."""
    return twin_field.density(features, layers, initial)[0]


def density_backward(features: Tensor, layers: Layers, initial: float, d_sigma: Tensor) -> tuple[Tensor, Layers]:
    """Return the gradients of the features and of the layers."""
    with torch.enable_grad():
        features = features.detach().requires_grad_()
        leaves = Layers(*(layer.detach().requires_grad_() for layer in layers))
        sigma = twin_field.density(features, leaves, initial)[0]
        gradients = torch.autograd.grad(sigma, [features, *leaves], d_sigma, materialize_grads=True)
    return gradients[0], Layers(*gradients[1:])


def shade(features: Tensor, harmonics: Tensor, ray: Tensor, layers: Layers, initial: float) -> tuple[Tensor, Tensor]:
    """Return density (m,) and colour (m, 3)."""
    return twin_field.shade(features, harmonics, ray, layers, initial)


def shade_backward(
    features: Tensor, harmonics: Tensor, ray: Tensor, layers: Layers, initial: float, d_sigma: Tensor, d_rgb: Tensor
) -> tuple[Tensor, Layers]:
    """Return the gradients of the features and of the layers."""
    with torch.enable_grad():
        features = features.detach().requires_grad_()
        leaves = Layers(*(layer.detach().requires_grad_() for layer in layers))
        outputs = twin_field.shade(features, harmonics, ray, leaves, initial)
        gradients = torch.autograd.grad(outputs, [features, *leaves], [d_sigma, d_rgb])
    return gradients[0], Layers(*gradients[1:])


def adam(weights: Tensor, mean: Tensor, square: Tensor, copy: Tensor | None, rate: float, step: int) -> None:
    """Do the step-th step of Adam."""
    twin_adam.adam(weights, mean, square, rate, step)
    if copy is not None:
        copy.copy_(weights)
