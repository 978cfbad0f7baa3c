"""The field's functions on CPUs: tensors in, tensors out, by compiled kernels on views of the same memory.

Features, weights, activations and their gradients are rounded to bfloat16 where the twin with `half` rounds them, on
every kind of CPU; products add up in float32. Each call is tasks of one pool; results do not depend on their order.
"""

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nerf.kernels.words import flat, words
from nerf.twin.adam import BETA_MEAN, BETA_SQUARE, EPSILON
from nerf.types import GridConfig, Layers
from priors.machine import threads

STORAGE = torch.bfloat16
SAMPLES_MULTIPLE = 64
_NONE = np.zeros(0, dtype=np.float32)


def encode(u: Tensor, table: Tensor, footprint: Tensor | None, weights: Tensor, config: GridConfig) -> Tensor:
    """Return features (levels, m, 2), bfloat16; weights bfloat16, sums float32."""
    from nerf.kernels.cpu import encode as kernel

    features = torch.empty(config.levels, len(u), 2, dtype=torch.bfloat16)
    places, rows, out = _places(u, table, footprint, config), _words(weights).reshape(-1), _words(features)
    # A level at a time, so that its rows stay in a core's cache; cut where there are fewer levels than threads want.
    parts = max(1, -(-2 * threads.count() // config.levels))
    ends = threads.stretches(len(u), 16, parts)

    def work(task: int) -> None:
        level, part = divmod(task, len(ends))
        kernel.encode(*places, rows, config.shapes[level], out[level], *ends[part])

    threads.run(config.levels * len(ends), work)
    return features


def spread(
    u: Tensor, table: Tensor, footprint: Tensor | None, d_features: Tensor, config: GridConfig, d_weights: Tensor
) -> None:
    """Set d_weights to the gradient of the weights; a level is one task: its sums are in the samples' order."""
    from nerf.kernels.cpu import encode as kernel

    places, gradients = _places(u, table, footprint, config), _words(flat(d_features))
    shapes, out = config.shapes, d_weights.numpy().reshape(-1)

    def work(level: int) -> None:
        last = shapes[level + 1, 5] if level + 1 < config.levels else config.rows
        kernel.spread(*places, gradients[level], shapes[level], int(last), config.rows, out)

    threads.run(config.levels, work)


def density(features: Tensor, layers: Layers, initial: float) -> Tensor:
    """Return density (m,)."""
    return _forward(features, None, None, layers, initial)[0]


def density_backward(features: Tensor, layers: Layers, initial: float, d_sigma: Tensor) -> tuple[Tensor, Layers]:
    """Return the gradients of the features and of the layers."""
    return _backward(features, None, None, layers, initial, d_sigma, None)


def shade(features: Tensor, harmonics: Tensor, ray: Tensor, layers: Layers, initial: float) -> tuple[Tensor, Tensor]:
    """Return density (m,) and colour (m, 3)."""
    return _forward(features, harmonics, ray, layers, initial)


def shade_backward(
    features: Tensor, harmonics: Tensor, ray: Tensor, layers: Layers, initial: float, d_sigma: Tensor, d_rgb: Tensor
) -> tuple[Tensor, Layers]:
    """Return the gradients of the features and of the layers."""
    return _backward(features, harmonics, ray, layers, initial, d_sigma, d_rgb)


def adam(weights: Tensor, mean: Tensor, square: Tensor, copy: Tensor | None, rate: float, step: int) -> None:
    """Do the step-th step of Adam."""
    from nerf.kernels.cpu import adam as kernel

    assert weights.grad is not None
    arrays = [tensor.view(-1).numpy() for tensor in (weights, weights.grad, mean, square)]
    halves = _NONE.view(np.int16) if copy is None else copy.view(-1).view(torch.int16).numpy()
    moving = rate / (1 - BETA_MEAN**step), 1 / (1 - BETA_SQUARE**step)
    settings = tuple(np.float32(x) for x in (BETA_MEAN, BETA_SQUARE, *moving, EPSILON))
    threads.over(weights.numel(), lambda first, last: kernel.adam(*arrays, halves, settings, first, last), 4096)


def _forward(
    features: Tensor, harmonics: Tensor | None, ray: Tensor | None, layers: Layers, initial: float
) -> tuple[Tensor, Tensor]:
    from nerf.kernels.cpu import perceptron

    count = features.shape[1]
    sigma, rgb = torch.empty(count), torch.empty(0 if ray is None else count, 3)
    net, inputs, outputs = _net(layers), _inputs(features, harmonics, ray), (sigma.numpy(), rgb.numpy().reshape(-1))

    def work(first: int, last: int) -> None:
        perceptron.forward(net, inputs, initial, *outputs, first, last)

    threads.over(count, work, SAMPLES_MULTIPLE)
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
    from nerf.kernels.cpu import layers as kernel
    from nerf.kernels.cpu import perceptron

    d_features = torch.empty(features.shape, dtype=torch.bfloat16)
    count = features.shape[1]
    stretch = max(1, -(-count // (SAMPLES_MULTIPLE * perceptron.PARTS))) * SAMPLES_MULTIPLE
    parts = -(-count // stretch)
    totals = kernel.Totals(*(np.empty((parts, math.prod(kernel.padded(*layer.shape))), np.float32) for layer in layers))
    d_outputs = d_sigma.contiguous().numpy(), _NONE if d_rgb is None else d_rgb.contiguous().numpy().reshape(-1)
    nets, inputs, out = (_net(layers), _net(layers, across=True)), _inputs(features, harmonics, ray), _words(d_features)

    def work(first: int, last: int) -> None:
        perceptron.backward(*nets, inputs, initial, d_outputs, out, totals, stretch, first, last)

    threads.over(parts, work)
    gradients = Layers(*(torch.zeros(layer.shape) for layer in layers))
    if parts:
        for total, gradient in zip(totals, gradients, strict=True):
            kernel.join(total, *gradient.shape, gradient.view(-1).numpy())
    return d_features, gradients


def _inputs(features: Tensor, harmonics: Tensor | None, ray: Tensor | None) -> Any:
    from nerf.kernels.cpu import perceptron

    if harmonics is None or ray is None:
        return perceptron.Inputs(_words(features), _NONE.view(np.int32), _NONE.view(np.int32))
    basis = _words(flat(harmonics).view(-1, 2))
    return perceptron.Inputs(_words(features), basis, ray.contiguous().numpy())


def _net(layers: Layers, across: bool = False) -> Any:
    """Round the layers and cut them, or where `across` their transposes, into tiles as the products take them."""
    from nerf.kernels.cpu import layers as kernel
    from nerf.kernels.cpu.products import OPERAND

    tiled: list[Any] = []
    for layer in layers:
        steps, shape = (layer.shape[1], 1), tuple(layer.shape)
        if across:
            steps, shape = steps[::-1], shape[::-1]
        tiles = np.empty(math.prod(kernel.padded(*shape)) // (2 if kernel.PAIRED else 1), OPERAND)
        kernel.cut(layer.view(-1).numpy().view(np.int32), *shape, *steps, tiles.view(np.int32))
        tiled.append(tiles)
    return kernel.Net(layers.colour1.shape[0] // 16, *tiled)


def _words(pairs: Tensor) -> Any:
    return words(pairs).numpy()


def _places(u: Tensor, table: Tensor, footprint: Tensor | None, config: GridConfig) -> tuple[Any, Any, Any]:
    """Return coordinates (3, m), first rows (m,) or empty, footprints (m,) or empty."""
    base = (table * config.rows).to(torch.int32).numpy() if config.tables > 1 else _NONE.view(np.int32)
    return u.T.contiguous().numpy(), base, _NONE if footprint is None else footprint.contiguous().numpy()
