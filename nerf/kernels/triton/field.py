"""The field's functions on GPUs: tensors in, tensors out, by Triton kernels. Needs no CUDA toolkit; see docs/gpu.md.

Nothing here waits for the device, and shapes follow the arguments' alone, so that a step can be captured as a graph.
"""

import functools

import torch
from torch import Tensor

from nerf.kernels.plain import field as plain
from nerf.kernels.triton import adam as adam_kernel
from nerf.kernels.triton import encode as encode_kernels
from nerf.kernels.triton import perceptron
from nerf.kernels.words import flat, words
from nerf.twin.adam import BETA_MEAN, BETA_SQUARE
from nerf.types import GridConfig, Layers

STORAGE = torch.bfloat16
SAMPLES_MULTIPLE = 256
_FUSED = 64
"""Neurons up to which both networks are one kernel; wider ones do not fit a processor's registers and shared memory."""
_NUMBERS = 1024
"""Numbers that a program of the optimiser moves."""


def encode(u: Tensor, table: Tensor, footprint: Tensor | None, weights: Tensor, config: GridConfig) -> Tensor:
    """Return features (levels, m, 2), bfloat16; weights bfloat16, sums float32."""
    features = torch.empty(config.levels, len(u), 2, dtype=torch.bfloat16, device=u.device)
    _launch(encode_kernels.encode, u, table, footprint, words(weights), words(features), config)
    return features


def spread(
    u: Tensor, table: Tensor, footprint: Tensor | None, d_features: Tensor, config: GridConfig, d_weights: Tensor
) -> None:
    """Set d_weights to the gradient of the weights; float32 additions in no fixed order."""
    d_weights.zero_()
    _launch(encode_kernels.spread, u, table, footprint, words(flat(d_features)), d_weights, config)


def density(features: Tensor, layers: Layers, initial: float) -> Tensor:
    """Return density (m,)."""
    if not _fused(layers):
        return plain.density(features.float(), layers, initial)
    return _forward(features, None, None, layers, initial)[0]


def density_backward(features: Tensor, layers: Layers, initial: float, d_sigma: Tensor) -> tuple[Tensor, Layers]:
    """Return the gradients of the features and of the layers."""
    if not _fused(layers):
        return plain.density_backward(features.float(), layers, initial, d_sigma)
    return _backward(features, None, None, layers, initial, d_sigma, None)


def shade(features: Tensor, harmonics: Tensor, ray: Tensor, layers: Layers, initial: float) -> tuple[Tensor, Tensor]:
    """Return density (m,) and colour (m, 3)."""
    if not _fused(layers):
        return plain.shade(features.float(), harmonics, ray, layers, initial)
    return _forward(features, harmonics, ray, layers, initial)


def shade_backward(
    features: Tensor, harmonics: Tensor, ray: Tensor, layers: Layers, initial: float, d_sigma: Tensor, d_rgb: Tensor
) -> tuple[Tensor, Layers]:
    """Return the gradients of the features and of the layers."""
    if not _fused(layers):
        return plain.shade_backward(features.float(), harmonics, ray, layers, initial, d_sigma, d_rgb)
    return _backward(features, harmonics, ray, layers, initial, d_sigma, d_rgb)


def adam(weights: Tensor, mean: Tensor, square: Tensor, copy: Tensor | None, rate: float, step: int) -> None:
    """Do the step-th step of Adam."""
    count = weights.numel()
    adam_kernel.adam[-(-count // _NUMBERS),](
        weights, weights.grad, mean, square, mean if copy is None else copy, count,
        rate / (1 - BETA_MEAN**step), 1 / (1 - BETA_SQUARE**step), COPY=copy is not None, BLOCK=_NUMBERS,
    )  # fmt: skip


def _launch(  # type: ignore[no-untyped-def]
    kernel, u: Tensor, table: Tensor, footprint: Tensor | None, source: Tensor, target: Tensor, config: GridConfig
) -> None:
    """Run a kernel of the grid over all samples and levels."""
    kernel[len(u) // SAMPLES_MULTIPLE, config.levels](
        u.T.contiguous(), table, u if footprint is None else footprint, source, _shapes(config, u.device), target,
        len(u), config.rows, TABLES=config.tables, FOOTPRINT=footprint is not None, BLOCK=SAMPLES_MULTIPLE,
    )  # fmt: skip


def _forward(
    features: Tensor, harmonics: Tensor | None, ray: Tensor | None, layers: Layers, initial: float
) -> tuple[Tensor, Tensor]:
    """Return density (m,) and colour (m, 3), empty without harmonics."""
    count = features.shape[1]
    sigma = torch.empty(count, device=features.device)
    rgb = torch.empty(0 if harmonics is None else count, 3, device=features.device)
    perceptron.forward[_programs(features.device, count // 64, 4),](
        *_inputs(features, harmonics, ray, layers), initial, sigma, rgb, count, TILE=64, num_warps=4,
        **_constants(features, layers, harmonics),
    )  # fmt: skip
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
    """Return the gradients of the features (levels, m, 2), bfloat16, and of the layers, float32."""
    count = features.shape[1]
    # What ptxas reports: 94 kB and 239 registers with 128 samples on Hopper, 70 kB and few spills with 64 before it.
    tile = 128 if _capability(features.device) >= (9, 0) else 64
    programs = _programs(features.device, count // tile, 1)
    trained = layers[:2] if harmonics is None else layers
    sizes = [layer.numel() for layer in trained]
    sums = torch.empty(programs, sum(sizes), device=features.device)
    d_features = torch.empty(features.shape, dtype=torch.bfloat16, device=features.device)
    perceptron.backward[programs,](
        *_inputs(features, harmonics, ray, layers), initial, d_sigma.contiguous(),
        d_sigma if d_rgb is None else d_rgb.contiguous(), words(d_features), sums, count, TILE=tile, num_warps=8,
        num_stages=1, **_constants(features, layers, harmonics),
    )  # fmt: skip
    parts = zip(sums.sum(0).split(sizes), trained, strict=True)
    gradients = [part.view(layer.shape) for part, layer in parts]
    return d_features, Layers(*gradients, *(torch.zeros_like(layer) for layer in layers[len(trained) :]))


def _inputs(features: Tensor, harmonics: Tensor | None, ray: Tensor | None, layers: Layers) -> list[Tensor]:
    """Return the kernels' first arguments; anything stands in for what they do not read."""
    given = words(flat(features))
    seen = [given, given] if harmonics is None or ray is None else [harmonics.contiguous(), ray.contiguous()]
    return [given, *seen, *layers]


def _constants(features: Tensor, layers: Layers, harmonics: Tensor | None) -> dict[str, int | bool]:
    neurons = layers.density0.shape[0]
    width = 1 << (neurons - 1).bit_length()
    return {"LEVELS": features.shape[0], "NEURONS": neurons, "WIDTH": width, "COLOUR": harmonics is not None}


@functools.cache
def _shapes(config: GridConfig, device: torch.device) -> Tensor:
    """Keep the levels' shapes on the device."""
    return torch.from_numpy(config.shapes).to(device)


@functools.cache
def _capability(device: torch.device) -> tuple[int, int]:
    return torch.cuda.get_device_capability(device) if device.type == "cuda" else (0, 0)


@functools.cache
def _processors(device: torch.device) -> int:
    return torch.cuda.get_device_properties(device).multi_processor_count if device.type == "cuda" else 1


def _programs(device: torch.device, tiles: int, each: int) -> int:
    """Return how many programs share the tiles: `each` a processor, at least one, for its sums."""
    return max(1, min(tiles, each * _processors(device)))


def _fused(layers: Layers) -> bool:
    return layers.density0.shape[0] <= _FUSED
