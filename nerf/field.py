"""Radiance field: places to density and colour, with a hand-written backward pass."""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from nerf.grid import Grid
from nerf.harmonics import harmonics
from nerf.kernels import FieldKernels, kernels_for
from nerf.mlp import MLP, MLPConfig
from nerf.types import GridConfig, Samples


@dataclass(frozen=True, slots=True)
class FieldConfig:
    """What a field is made of."""

    grid: GridConfig = field(default_factory=GridConfig)
    """The hash grid."""
    mlp: MLPConfig = field(default_factory=MLPConfig)
    """The small networks behind it."""


@dataclass(frozen=True, slots=True)
class _Forward:
    """What the last forward pass was last, padded: what the backward pass needs."""

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
        self.mlp = MLP(config.mlp, config.grid.levels, self.device, generator, kernels)
        self._block = kernels.SAMPLES_MULTIPLE
        self._forward: _Forward | None = None
        self._seen: tuple[Tensor, Tensor] | None = None

    def forward(self, samples: Samples, units: Tensor, footprint: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return density (m,), 1/m, and colour (m, 3) of samples on rays with unit directions (r, 3).

        What only pads the samples is not asked for where the kernels take any whole blocks: it is 0.
        `footprint` (m,): the samples' standard deviations in units of u; None: points.
        """
        count = len(samples.u)
        asked = self._asked(count, samples.used)
        u, table, footprint = self._padded(samples.u[:asked], samples.table[:asked], _first(footprint, asked))
        ray = _pad(samples.ray[:asked], len(u))
        features = self.grid.encode(u, table, footprint)
        basis = self._basis(units)
        sigma, rgb = self.mlp.shade(features, basis, ray)
        self._forward = _Forward(u, table, footprint, features, ray, basis, count)
        return _long(sigma, count), _long(rgb, count)

    def backward(self, d_sigma: Tensor, d_rgb: Tensor, kept: Tensor | None = None) -> None:
        """Set all gradients from those of the last `forward`'s results: (m,) and (m, 3).

        `kept` (k,): places of the samples that count; None: all. The others have no gradient, and cost nothing.
        """
        last = self._last(d_sigma, kept)
        if kept is not None:
            d_sigma, d_rgb = d_sigma[kept], d_rgb[kept]
        if last.ray is None or last.harmonics is None:
            raise RuntimeError("backward after density: use density_backward")
        d_sigma, d_rgb = _pad(d_sigma, len(last.u)), _pad(d_rgb, len(last.u))
        d_features = self.mlp.shade_backward(last.features, last.harmonics, last.ray, d_sigma, d_rgb)
        self.grid.backward(last.u, last.table, last.footprint, d_features)

    def density(self, u: Tensor, table: Tensor, footprint: Tensor | None = None) -> Tensor:
        """Return density (m,), 1/m, at places u (m, 3) of tables (m,), without learning."""
        padded = self._padded(u, table, footprint)
        return self.mlp.density(self.grid.encode(*padded))[: len(u)]

    def density_forward(self, samples: Samples, footprint: Tensor | None = None) -> Tensor:
        """Return density (m,), 1/m, of samples, for `density_backward`; of those that only pad it may be 0."""
        count = len(samples.u)
        asked = self._asked(count, samples.used)
        u, table, footprint = self._padded(samples.u[:asked], samples.table[:asked], _first(footprint, asked))
        features = self.grid.encode(u, table, footprint)
        self._forward = _Forward(u, table, footprint, features, None, None, count)
        return _long(self.mlp.density(features), count)

    def density_backward(self, d_sigma: Tensor, kept: Tensor | None = None) -> None:
        """Set all gradients from that of the last `density_forward`, (m,); `kept` as in `backward`."""
        last = self._last(d_sigma, kept)
        if kept is not None:
            d_sigma = d_sigma[kept]
        d_features = self.mlp.density_backward(last.features, _pad(d_sigma, len(last.u)))
        self.grid.backward(last.u, last.table, last.footprint, d_features)

    def parameters(self) -> dict[str, Tensor]:
        """Return the trainable tensors by name; a backward pass sets (does not add to) their `.grad`."""
        return {"grid": self.grid.weights, **self.mlp.layers._asdict()}

    def copies(self) -> dict[str, Tensor]:
        """Return the rounded copies that an optimiser may keep up to date as it goes, by the parameter's name."""
        return {"grid": self.grid.copy}

    def _last(self, d_sigma: Tensor, kept: Tensor | None) -> _Forward:
        """Return what the last forward pass left: of the samples that are kept, or of all with the padding again."""
        last = self._forward
        if last is None or last.count != len(d_sigma):
            raise RuntimeError("backward without the forward pass it belongs to")
        if kept is not None:
            return self._part(last, kept)
        count = self._blocks(last.count)
        u, table, footprint = self._padded(last.u, last.table, last.footprint, count)
        ray = None if last.ray is None else _pad(last.ray, count)
        features = _pad(last.features.transpose(0, 1), count).transpose(0, 1).contiguous()
        return _Forward(u, table, footprint, features, ray, last.harmonics, last.count)

    def _asked(self, count: int, used: int) -> int:
        """Return of how many of the first samples the kernels are asked, where all others only pad.

        Those without blocks are asked of all: matrix libraries prepare themselves anew for every number.
        """
        return count if self._block == 1 else min(count, self._blocks(used))

    def _basis(self, units: Tensor) -> Tensor:
        """Return the harmonics (r, 16) of directions (r, 3); those of the last call where it had the same tensor."""
        seen = self._seen  # parts of a view are rendered side by side
        if seen is None or seen[0] is not units:
            self._seen = seen = units, harmonics(units)
        return seen[1]

    def _part(self, last: _Forward, kept: Tensor) -> _Forward:
        """Return what the backward pass needs of some samples (k,), padded."""
        count = len(kept)
        kept = _pad(kept, self._blocks(count))
        footprint = None if last.footprint is None else last.footprint[kept]
        ray = None if last.ray is None else last.ray[kept]
        u, features = last.u.T.index_select(1, kept).T, last.features.index_select(1, kept)
        return _Forward(u, last.table[kept], footprint, features, ray, last.harmonics, count)

    def _blocks(self, count: int) -> int:
        """Round a number of samples up to whole blocks of the kernels."""
        return -(-max(count, 1) // self._block) * self._block

    def _padded(
        self, u: Tensor, table: Tensor, footprint: Tensor | None, count: int = 0
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """Fill up to a multiple of the kernels' block, and to at least `count`."""
        count = self._blocks(max(len(u), count))
        return _pad(u, count), _pad(table, count), None if footprint is None else _pad(footprint, count)


def _first(x: Tensor | None, count: int) -> Tensor | None:
    return None if x is None else x[:count]


def _long(x: Tensor, count: int) -> Tensor:
    """Cut or fill up with zeros along the first axis."""
    return x[:count] if len(x) >= count else _pad(x, count)


def _pad(x: Tensor, count: int) -> Tensor:
    """Append zeros along the first axis."""
    return x if len(x) == count else torch.cat([x, x.new_zeros(count - len(x), *x.shape[1:])])
