"""Upkeep of an occupancy grid in plain torch: what the field's density says of cells, and which ones stay."""

import torch
from torch import Tensor

from nerf.twin.sample import cells
from nerf.twin.space import stretch
from nerf.types import Extent


def note(thickness: Tensor, u: Tensor, table: Tensor, sigma: Tensor, extent: Extent, decay: float) -> None:
    """Let the cells at u (m, 3) of tables (m,) decay once, and rise to what the densities (m,), 1/m, make of them.

    thickness: (tables, n, n, n), the cells' optical thickness: density times the width of a cell, metres, or times
    the extent's air_m where that is more.
    """
    sigma = sigma.to(torch.float32)
    found = torch.maximum(sigma * stretch(u, table, extent) / thickness.shape[-1], sigma * extent.air_m)
    cell = cells(u, table, thickness.shape[-1])
    flat = thickness.view(-1)
    flat[cell] = flat[cell] * decay
    flat.scatter_reduce_(0, cell, found, "amax")


def prune(thickness: Tensor, allowed: Tensor, thin: float, kept: Tensor) -> None:
    """Keep (uint8) the allowed cells that were never looked at (below 0), or are thicker than `thin` or than the mean.

    The smaller of the two limits counts.
    """
    measured = thickness >= 0
    limit = min(thin, float(thickness[measured].double().mean())) if measured.any() else thin
    kept.copy_(((thickness > limit) | ~measured).to(torch.uint8) & allowed)
