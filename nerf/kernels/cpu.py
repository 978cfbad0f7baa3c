"""The field's functions on CPUs: tensors in, tensors out, by compiled kernels on views of the same memory."""

import functools
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from nerf.kernels import plain
from nerf.twin.adam import BETA_MEAN, BETA_SQUARE, EPSILON
from nerf.twin.field import Layers

if TYPE_CHECKING:
    from nerf.grid import GridConfig

STORAGE = torch.bfloat16
BLOCK = 64
_NONE = np.zeros(0, dtype=np.float32)


def encode(u: Tensor, table: Tensor, footprint: Tensor | None, weights: Tensor, config: "GridConfig") -> Tensor:
    """Return features (levels, m, 2), bfloat16; weights bfloat16, sums float32."""
    from nerf.kernels import encode as kernel

    features = torch.empty(config.levels, len(u), 2, dtype=torch.bfloat16)
    threads = torch.get_num_threads()
    parts = 1 if threads <= config.levels // 2 else -(-4 * threads // config.levels)
    words = _words(weights).reshape(-1)
    kernel.encode(*_places(u, table, footprint, config), words, config.shapes, _words(features), threads, parts)
    return features


def spread(
    u: Tensor, table: Tensor, footprint: Tensor | None, d_features: Tensor, config: "GridConfig", d_weights: Tensor
) -> None:
    """Set d_weights to the gradient of the weights."""
    from nerf.kernels import encode as kernel

    places = _places(u, table, footprint, config)
    words = _words(d_features.to(torch.bfloat16))
    kernel.spread(*places, words, config.shapes, config.rows, d_weights.numpy().reshape(-1), torch.get_num_threads())


def density(features: Tensor, layers: Layers, initial: float) -> Tensor:
    """Return density (m,)."""
    if not _tiled():
        return plain.density(features.float(), layers, initial)
    return _forward(features, None, None, layers, initial)[0]


def density_backward(features: Tensor, layers: Layers, initial: float, d_sigma: Tensor) -> tuple[Tensor, Layers]:
    """Return the gradients of the features and of the layers."""
    if not _tiled():
        return plain.density_backward(features.float(), layers, initial, d_sigma)
    return _backward(features, None, None, layers, initial, d_sigma, None)


def shade(features: Tensor, harmonics: Tensor, ray: Tensor, layers: Layers, initial: float) -> tuple[Tensor, Tensor]:
    """Return density (m,) and colour (m, 3)."""
    if not _tiled():
        return plain.shade(features.float(), harmonics, ray, layers, initial)
    return _forward(features, harmonics, ray, layers, initial)


def shade_backward(
    features: Tensor, harmonics: Tensor, ray: Tensor, layers: Layers, initial: float, d_sigma: Tensor, d_rgb: Tensor
) -> tuple[Tensor, Layers]:
    """Return the gradients of the features and of the layers."""
    if not _tiled():
        return plain.shade_backward(features.float(), harmonics, ray, layers, initial, d_sigma, d_rgb)
    return _backward(features, harmonics, ray, layers, initial, d_sigma, d_rgb)


def adam(weights: Tensor, mean: Tensor, square: Tensor, copy: Tensor | None, rate: float, step: int) -> None:
    """Do the step-th step of Adam."""
    from nerf.kernels import adam as kernel

    assert weights.grad is not None
    arrays = [tensor.view(-1).numpy() for tensor in (weights, weights.grad, mean, square)]
    halves = _NONE.view(np.int16) if copy is None else copy.view(-1).view(torch.int16).numpy()
    moving = rate / (1 - BETA_MEAN**step), 1 / (1 - BETA_SQUARE**step)
    kernel.adam(*arrays, halves, tuple(np.float32(x) for x in (BETA_MEAN, BETA_SQUARE, *moving, EPSILON)))


@functools.cache
def _tiled() -> bool:
    """Say whether the networks run on matrix tiles, in bfloat16; else they are the twin, in float32."""
    from nerf.kernels import tiles

    return tiles.available()


def _forward(
    features: Tensor, harmonics: Tensor | None, ray: Tensor | None, layers: Layers, initial: float
) -> tuple[Tensor, Tensor]:
    from nerf.kernels import perceptron, tiles

    count = features.shape[1]
    sigma, rgb = torch.empty(count), torch.empty(0 if ray is None else count, 3)
    asked = _asked(features, harmonics, ray)
    outputs = sigma.numpy(), rgb.numpy().reshape(-1)
    perceptron.forward(_net(layers), asked, initial, tiles.configuration(), *outputs, torch.get_num_threads())
    return sigma, rgb


def _backward(
    features: Tensor,
    harmonics: Tensor | None,
    ray: Tensor | None,
    layers: Layers,
    initial: float,
    d_sigma: Tensor,
    d_rgb: Tensor | None,
) -> tuple[Tensor, Layers]:
    from nerf.kernels import perceptron, tiles

    d_features = torch.empty_like(features)
    shapes = [_padded_shape(layer) for layer in layers]
    totals = perceptron.Totals(*(np.zeros((perceptron.PARTS, rows * columns), np.float32) for rows, columns in shapes))
    given = d_sigma.contiguous().numpy(), _NONE if d_rgb is None else d_rgb.contiguous().numpy().reshape(-1)
    perceptron.backward(
        _net(layers),
        _net(Layers(*(layer.T for layer in layers))),
        _asked(features, harmonics, ray),
        initial,
        tiles.configuration(),
        *given,
        _words(d_features),
        totals,
        torch.get_num_threads(),
    )
    gradients = []
    for layer, total, (rows, columns) in zip(layers, totals, shapes, strict=True):
        tiled = torch.from_numpy(total.sum(0)).view(rows // 16, columns // 16, 16, 16)
        whole = tiled.permute(0, 2, 1, 3).reshape(rows, columns)
        gradients.append(whole[: layer.shape[0], : layer.shape[1]].contiguous())
    return d_features, Layers(*gradients)


def _asked(features: Tensor, harmonics: Tensor | None, ray: Tensor | None) -> Any:
    from nerf.kernels import perceptron

    if harmonics is None or ray is None:
        return perceptron.Asked(_words(features), _NONE.view(np.int32), _NONE.view(np.int32))
    basis = harmonics.to(torch.bfloat16).view(torch.int32).numpy().reshape(-1)
    return perceptron.Asked(_words(features), basis, ray.numpy())


def _net(layers: Layers) -> Any:
    """Round the layers and cut them into tiles of 16 outputs and 32 inputs."""
    from nerf.kernels import perceptron

    width = layers.colour1.shape[0]
    tiled = []
    for layer in layers:
        rows, columns = _padded_shape(layer)
        full = torch.zeros(rows, columns, dtype=torch.bfloat16)
        full[: layer.shape[0], : layer.shape[1]] = layer
        parts = full.view(rows // 16, 16, columns // 32, 32).permute(0, 2, 1, 3).contiguous()
        tiled.append(parts.view(torch.int32).numpy().reshape(-1))
    return perceptron.Net(width // 16, *tiled)


def _padded_shape(layer: Tensor) -> tuple[int, int]:
    return -(-layer.shape[0] // 16) * 16, -(-layer.shape[1] // 32) * 32


def _words(pairs: Tensor) -> Any:
    """View pairs of bfloat16, (..., 2), as 32-bit words (...)."""
    return pairs.view(torch.int32).squeeze(-1).numpy()


def _places(u: Tensor, table: Tensor, footprint: Tensor | None, config: "GridConfig") -> tuple[Any, Any, Any]:
    """Return coordinates (3, m), first rows (m,) or empty, footprints (m,) or empty."""
    base = (table * config.rows).to(torch.int32).numpy() if config.tables > 1 else _NONE.view(np.int32)
    return u.T.contiguous().numpy(), base, _NONE if footprint is None else footprint.numpy()
