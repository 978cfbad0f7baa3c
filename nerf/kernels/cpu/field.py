"""The field's functions on CPUs: tensors in, tensors out, by compiled kernels on views of the same memory.

Features, weights, activations and their gradients are rounded to bfloat16 where the twin with `half` rounds them, on
every kind of CPU; products add up in float32. Each call is tasks of one pool; results do not depend on their order.
"""

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
    from nerf.kernels.cpu import perceptron

    d_features = torch.empty(features.shape, dtype=torch.bfloat16)
    shapes = [_padded_shape(layer) for layer in layers]
    totals = [np.zeros((perceptron.PARTS, rows * columns), np.float32) for rows, columns in shapes]
    d_outputs = d_sigma.contiguous().numpy(), _NONE if d_rgb is None else d_rgb.contiguous().numpy().reshape(-1)
    nets = _net(layers), _net(Layers(*(layer.T for layer in layers)))
    inputs, out, count = _inputs(features, harmonics, ray), _words(d_features), features.shape[1]
    stretch = -(-count // (SAMPLES_MULTIPLE * perceptron.PARTS)) * SAMPLES_MULTIPLE

    def work(part: int) -> None:
        total = perceptron.Totals(*(each[part] for each in totals))
        ends = part * stretch, min(count, (part + 1) * stretch)
        perceptron.backward(*nets, inputs, initial, *d_outputs, out, total, *ends)

    threads.run(-(-count // stretch) if count else 0, work)
    gradients = []
    for layer, total, (rows, columns) in zip(layers, totals, shapes, strict=True):
        tiled = torch.from_numpy(total.sum(0)).view(rows // 16, columns // 16, 16, 16)
        whole = tiled.permute(0, 2, 1, 3).reshape(rows, columns)
        gradients.append(whole[: layer.shape[0], : layer.shape[1]].contiguous())
    return d_features, Layers(*gradients)


def _inputs(features: Tensor, harmonics: Tensor | None, ray: Tensor | None) -> Any:
    from nerf.kernels.cpu import perceptron

    if harmonics is None or ray is None:
        return perceptron.Inputs(_words(features), _NONE.view(np.int32), _NONE.view(np.int32))
    basis = _words(flat(harmonics).view(-1, 2))
    return perceptron.Inputs(_words(features), basis, ray.contiguous().numpy())


def _net(layers: Layers) -> Any:
    """Round the layers and cut them into tiles of 16 outputs and 32 inputs, as the products take them."""
    from nerf.kernels.cpu import perceptron, products

    width = layers.colour1.shape[0]
    tiled = []
    for layer in layers:
        rows, columns = _padded_shape(layer)
        full = torch.zeros(rows, columns, dtype=torch.bfloat16)
        full[: layer.shape[0], : layer.shape[1]] = layer
        parts = full.view(rows // 16, 16, columns // 32, 32).permute(0, 2, 1, 3).reshape(-1, 2)
        tiled.append(_words(parts) if products.OPERAND is np.int32 else parts.float().numpy().reshape(-1))
    return perceptron.Net(width // 16, *tiled)


def _padded_shape(layer: Tensor) -> tuple[int, int]:
    return -(-layer.shape[0] // 16) * 16, -(-layer.shape[1] // 32) * 32


def _words(pairs: Tensor) -> Any:
    return words(pairs).numpy()


def _places(u: Tensor, table: Tensor, footprint: Tensor | None, config: GridConfig) -> tuple[Any, Any, Any]:
    """Return coordinates (3, m), first rows (m,) or empty, footprints (m,) or empty."""
    base = (table * config.rows).to(torch.int32).numpy() if config.tables > 1 else _NONE.view(np.int32)
    return u.T.contiguous().numpy(), base, _NONE if footprint is None else footprint.contiguous().numpy()
