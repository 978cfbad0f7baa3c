"""The field's functions on CPUs: tensors in, tensors out, by compiled kernels on views of the same memory."""

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from nerf.kernels import plain
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
    return plain.density(features.float(), layers, initial)


def density_backward(features: Tensor, layers: Layers, initial: float, d_sigma: Tensor) -> tuple[Tensor, Layers]:
    """Return the gradients of the features and of the layers."""
    return plain.density_backward(features.float(), layers, initial, d_sigma)


def shade(features: Tensor, harmonics: Tensor, ray: Tensor, layers: Layers, initial: float) -> tuple[Tensor, Tensor]:
    """Return density (m,) and colour (m, 3)."""
    return plain.shade(features.float(), harmonics, ray, layers, initial)


def shade_backward(
    features: Tensor, harmonics: Tensor, ray: Tensor, layers: Layers, initial: float, d_sigma: Tensor, d_rgb: Tensor
) -> tuple[Tensor, Layers]:
    """Return the gradients of the features and of the layers."""
    return plain.shade_backward(features.float(), harmonics, ray, layers, initial, d_sigma, d_rgb)


def _words(pairs: Tensor) -> Any:
    """View pairs of bfloat16, (..., 2), as 32-bit words (...)."""
    return pairs.view(torch.int32).squeeze(-1).numpy()


def _places(u: Tensor, table: Tensor, footprint: Tensor | None, config: "GridConfig") -> tuple[Any, Any, Any]:
    """Return coordinates (3, m), first rows (m,) or empty, footprints (m,) or empty."""
    base = (table * config.rows).to(torch.int32).numpy() if config.tables > 1 else _NONE.view(np.int32)
    return u.T.contiguous().numpy(), base, _NONE if footprint is None else footprint.numpy()
