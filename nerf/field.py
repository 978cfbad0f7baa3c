"""A radiance field: places to density and colour, with a hand-written backward pass."""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from nerf.grid import Grid
from nerf.harmonics import harmonics
from nerf.kernels import FieldKernels, kernels_for
from nerf.mlp import Network, NetworkConfig
from nerf.types import GridConfig, Samples


@dataclass(frozen=True, slots=True)
class FieldConfig:
    """What a field is made of."""

    grid: GridConfig = field(default_factory=GridConfig)
    """The hash grid."""
    network: NetworkConfig = field(default_factory=NetworkConfig)
    """The small networks behind it."""


@dataclass(frozen=True, slots=True)
class _Asked:
    """What the last forward pass was asked, padded: what the backward pass needs."""

    u: Tensor
    table: Tensor
    footprint: Tensor | None
    features: Tensor
    ray: Tensor | None
    harmonics: Tensor | None
    count: int


class Field:
    """Density and colour of places. For density alone: `density_forward`, `density_backward`."""

    def __init__(
        self,
        config: FieldConfig,
        device: torch.device | str = "cpu",
        seed: int = 0,
        kernels: FieldKernels | None = None,
    ) -> None:
        """Make a field that is a thin, even fog; the same weights for the same seed on every device.

        `kernels`: other functions than the device's own fastest.
        """
        self.config = config
        self.device = torch.device(device)
        generator = torch.Generator().manual_seed(seed)
        kernels = kernels or kernels_for(self.device).field
        self.grid = Grid(config.grid, self.device, generator, kernels)
        self.network = Network(config.network, config.grid.levels, self.device, generator, kernels)
        self._block = kernels.BLOCK
        self._asked: _Asked | None = None

    def forward(self, samples: Samples, units: Tensor, footprint: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return density (m,), 1/m, and colour (m, 3) of samples on rays with unit directions (r, 3).

        `footprint` (m,): the samples' standard deviations in units of u; None: points.
        """
        u, table, footprint = self._padded(samples.u, samples.table, footprint)
        ray = _pad(samples.ray, len(u))
        features = self.grid.encode(u, table, footprint)
        basis = harmonics(units)
        sigma, rgb = self.network.shade(features, basis, ray)
        self._asked = _Asked(u, table, footprint, features, ray, basis, len(samples.u))
        return sigma[: len(samples.u)], rgb[: len(samples.u)]

    def backward(self, d_sigma: Tensor, d_rgb: Tensor) -> None:
        """Set all gradients from those of the last `forward`'s results: (m,) and (m, 3)."""
        asked = self._last(d_sigma)
        if asked.ray is None or asked.harmonics is None:
            raise RuntimeError("backward after density: use density_backward")
        d_sigma, d_rgb = _pad(d_sigma, len(asked.u)), _pad(d_rgb, len(asked.u))
        d_features = self.network.shade_backward(asked.features, asked.harmonics, asked.ray, d_sigma, d_rgb)
        self.grid.backward(asked.u, asked.table, asked.footprint, d_features)

    def density(self, u: Tensor, table: Tensor, footprint: Tensor | None = None) -> Tensor:
        """Return density (m,), 1/m, at places u (m, 3) of tables (m,), without learning."""
        padded = self._padded(u, table, footprint)
        return self.network.density(self.grid.encode(*padded))[: len(u)]

    def density_forward(self, u: Tensor, table: Tensor, footprint: Tensor | None = None) -> Tensor:
        """Return density (m,), 1/m, at places u (m, 3) of tables (m,), for `density_backward`."""
        count = len(u)
        u, table, footprint = self._padded(u, table, footprint)
        features = self.grid.encode(u, table, footprint)
        self._asked = _Asked(u, table, footprint, features, None, None, count)
        return self.network.density(features)[:count]

    def density_backward(self, d_sigma: Tensor) -> None:
        """Set all gradients from that of the last `density_forward`, (m,)."""
        asked = self._last(d_sigma)
        d_features = self.network.density_backward(asked.features, _pad(d_sigma, len(asked.u)))
        self.grid.backward(asked.u, asked.table, asked.footprint, d_features)

    def parameters(self) -> dict[str, Tensor]:
        """Return the trainable tensors by name; a backward pass sets (does not add to) their `.grad`."""
        return {"grid": self.grid.weights, **self.network.layers._asdict()}

    def copies(self) -> dict[str, Tensor]:
        """Return the rounded copies that an optimiser may keep up to date as it goes, by the parameter's name."""
        return {"grid": self.grid.copy}

    def state(self) -> dict[str, Tensor]:
        """Return what `load` takes: the parameters, not copied."""
        return self.parameters()

    def load(self, state: dict[str, Tensor]) -> None:
        """Take over another field's parameters of the same shapes."""
        for name, tensor in self.parameters().items():
            if name not in state or state[name].shape != tensor.shape:
                found = tuple(state[name].shape) if name in state else "none"
                raise ValueError(f"field: expected {name} of shape {tuple(tensor.shape)}, found {found}")
        for name, tensor in self.parameters().items():
            tensor.copy_(state[name])

    def _last(self, d_sigma: Tensor) -> _Asked:
        if self._asked is None or self._asked.count != len(d_sigma):
            raise RuntimeError("backward without the forward pass it belongs to")
        return self._asked

    def _padded(self, u: Tensor, table: Tensor, footprint: Tensor | None) -> tuple[Tensor, Tensor, Tensor | None]:
        """Fill up to a multiple of the kernels' block."""
        count = -(-len(u) // self._block) * self._block
        return _pad(u, count), _pad(table, count), None if footprint is None else _pad(footprint, count)


def _pad(x: Tensor, count: int) -> Tensor:
    """Append zeros along the first axis."""
    return x if len(x) == count else torch.cat([x, x.new_zeros(count - len(x), *x.shape[1:])])
