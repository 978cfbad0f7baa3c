"""Multi-resolution hash grid: trainable features at the corners of cells, interpolated and laid side by side.

Müller et al. 2022, "Instant Neural Graphics Primitives", section 3. Every level has FEATURES = 2 features a row: one
32-bit word in the kernels. Features are level-major, (levels, m, 2): what the kernels write and the network reads.
"""

import torch
from torch import Tensor

from nerf.kernels import FieldKernels
from nerf.types import FEATURES, GridConfig


class Grid:
    """The features of a grid, their gradient, and the rounded copy that the kernels read."""

    def __init__(
        self, config: GridConfig, device: torch.device, generator: torch.Generator, kernels: FieldKernels
    ) -> None:
        self.config = config
        self.weights = torch.empty(config.tables, config.rows, FEATURES).uniform_(-1e-4, 1e-4, generator=generator)
        self.weights = self.weights.to(device)
        self.weights.grad = torch.zeros_like(self.weights)
        self._kernels = kernels
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
