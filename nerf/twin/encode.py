"""Hash-grid lookup in plain PyTorch."""

import torch
from torch import Tensor

from nerf.types import GridConfig


def encode(u: Tensor, table: Tensor, footprint: Tensor | None, weights: Tensor, config: GridConfig) -> Tensor:
    """Return features (levels, m, 2) of u (m, 3) in [0, 1], table (m,), footprint (m,); weights (tables, rows, 2)."""
    features = []
    for shape in config.shapes.tolist():
        resolution, stride_y, stride_z, shift, mask, start = shape
        place = u * resolution
        cell = place.detach().floor().clamp(0, resolution - 1)
        within = (place - cell).to(weights.dtype)
        total = weights.new_zeros(len(u), weights.shape[-1])
        for corner in range(8):
            step = torch.tensor([corner & 1, corner >> 1 & 1, corner >> 2 & 1], device=u.device)
            x, y, z = (cell.to(torch.int64) + step).unbind(-1)
            n = (x + stride_y * y + stride_z * z) & 0xFFFFFFFF
            row = start + ((n ^ (n >> shift)) & (mask & 0xFFFFFFFF))
            share = torch.where(step == 1, within, 1 - within).prod(-1)
            total = total + share[:, None] * weights[table.long(), row]
        if footprint is not None:
            total = total * level_weight(footprint, resolution).to(weights.dtype)[:, None]
        features.append(total)
    return torch.stack(features)


def level_weight(footprint: Tensor, resolution: int) -> Tensor:
    """Return how much of a level a sample of this size sees: the mean over a Gaussian, in effect, (m,)."""
    return torch.erf(1 / torch.sqrt(8 * (footprint.clamp(min=1e-6 / resolution) * resolution) ** 2))
