"""Occupancy grid: which cells of a space may hold something, so that samplers skip the others.

Carving, before the first step, from what the training views know:

1. A view votes for the cells within `reach` of its prior values, along their rays, and against those that it looks
   through. Cells with at least AGREED of the votes for them are kept, and so are their neighbours: one view's outlier
   does not fill the air that all others look through.
2. A ray without a value and not among values in its image (above the scanner) says nothing: cells it passes stay
   open, unless a view voted on them. A ray into the sky, where that is known, votes against all cells it passes.
3. Everything else is empty, for good. A hole between values (LiDAR lines) opens nothing: neighbours and other views
   fill it.

So a dense prior leaves a shell around the surfaces; a LiDAR cuts away nothing of what is above it; and without any
prior, what the cameras see is open. While training, cells that the field finds thin are pruned, and come back when it
finds something there.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nerf.kernels import kernels_for
from nerf.kernels.cpu import sample as compiled
from nerf.scene import Scene
from nerf.space import Space
from nerf.state import copy_into
from nerf.twin.sample import cells
from nerf.types import Key, Samples
from nerf.world import here
from priors.geometry import rays as pixel_rays

Density = Callable[[Tensor, Tensor], Tensor]
Bytes = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]
Pixels = npt.NDArray[np.int64]

AGREED = 0.1
"""Share of the votes for a cell above which it is kept; a tenth: thin things are mostly looked past."""
RAYS_PER_RADIAN = 96
"""How densely views are traced; a cell of the ball with 128 of them an axis is about three times as wide."""
THIN = 0.03
"""Optical thickness of a cell below which it is taken to be empty."""
DECAY = 0.7
"""What a cell's thickness is multiplied with each time it is looked at, before the new one is compared."""
WARM_UP = 64
"""Steps before anything is pruned."""
_STREAM = 3


class Occupancy:
    """Which cells are kept, for each table of a space; (tables, n, n, n) grids, z first, x last."""

    def __init__(self, space: Space, resolution: int = 128, device: torch.device | str = "cpu") -> None:
        """Make a grid in which every cell is kept."""
        self.space = space
        self.resolution = resolution
        shape = (space.tables, resolution, resolution, resolution)
        self.kept = torch.ones(shape, dtype=torch.uint8, device=device)
        """uint8, 1: samples are taken here."""
        self.allowed = torch.ones_like(self.kept)
        """uint8, 1: may be kept; the others are carved away for good."""
        self.thickness = torch.full(shape, -1.0, device=device)
        """float32, optical thickness of a cell as last seen, decaying; -1: never looked at."""
        self._kernels = kernels_for(self.kept.device).sample
        self._known: tuple[int, Tensor] | None = None

    @classmethod
    def carve(
        cls,
        space: Space,
        scene: Scene,
        resolution: int = 128,
        reach: float = 0.1,
        trust: float = 0.0,
        device: torch.device | str = "cpu",
    ) -> "Occupancy":
        """Carve a grid from the training views' prior.

        `reach` is relative to the depth; values of less confidence than `trust` count as none.
        """
        self = cls(space, resolution, device)
        count = self.kept.numel()
        votes_for, votes_against = np.zeros(count, np.uint16), np.zeros(count, np.uint16)
        blindly = np.zeros(count, np.uint8)
        for position in scene.train:
            with_value, blind, sky = _thinned(scene, position, trust)
            votes_for += self._trace(scene, position, with_value, 1 - reach, 1 + reach)
            votes_against += self._trace(scene, position, with_value, 0, 1 - reach)
            votes_against += self._trace(scene, position, sky, 0, np.inf)
            blindly |= self._trace(scene, position, blind, 0, np.inf)
        votes = votes_for + votes_against
        band = _dilated((votes_for >= np.float32(AGREED) * votes) & (votes_for > 0), resolution)
        unknown = _dilated((blindly > 0) & (votes == 0), resolution)
        self.allowed.copy_(torch.from_numpy((band | unknown).reshape(self.kept.shape)))
        self.kept.copy_(self.allowed)
        return self

    @property
    def share(self) -> float:
        """Share of the cells that are kept, [0, 1]."""
        return float(self.kept.float().mean())

    def holds(self, points_m: Tensor) -> Tensor:
        """Tell which world points (n, 3) lie in kept cells: (n,) bool."""
        u, table = self.space.warp(points_m)
        return self.kept.reshape(-1)[cells(u, table, self.resolution)] > 0

    def observe(self, samples: Samples, sigma: Tensor) -> None:
        """Note the density (m,), 1/m, that a training step found at its samples, and those of the other processes."""
        found = (samples.u[: samples.used], samples.table[: samples.used], sigma[: samples.used])
        self._note(*map(here().joined, found))

    def update(self, density: Density, key: Key, probes: int = 16_384) -> None:
        """Look at `probes` cells, half of them kept ones, and after WARM_UP steps prune what is thin.

        Args:
            density: u (m, 3), table (m,) -> density (m,), 1/m; of the field.
            key: seed and step: they choose the cells and the places in them.
            probes: how many cells; m is always this.
        """
        candidates = self._candidates()
        if not len(candidates):
            return
        generator = np.random.Generator(np.random.Philox(key=list(key), counter=[0, 0, 0, _STREAM]))
        kept = _places_of(self.kept)
        half = probes // 2 if len(kept) else 0
        chosen = [_draw(generator, kept, half), _draw(generator, candidates, probes - half)]
        u, table = self._inside(torch.cat(chosen), generator)
        self._note(u, table, density(u, table))
        if key[1] >= WARM_UP:
            self._kernels.prune(self.thickness, self.allowed, THIN, self.kept)

    def state(self) -> dict[str, Tensor]:
        """Return what `load` needs to go on bit for bit."""
        return {"kept": self.kept, "allowed": self.allowed, "thickness": self.thickness}

    def load(self, state: dict[str, Tensor]) -> None:
        """Take over the state of a grid of the same space and resolution; ValueError where it is of another."""
        copy_into(self.state(), state)

    def _trace(self, scene: Scene, position: int, pixels: npt.NDArray[np.int64], begin: float, end: float) -> Bytes:
        """Mark (flat, 1) the cells along a view's pixels from `begin` to `end` times the depth; near to far where 0."""
        grid = np.zeros(self.kept.numel(), np.uint8)
        if not len(pixels):
            return grid
        pose = scene.T_world_cam[position]
        directions = pixel_rays(scene.camera).reshape(-1, 3)[pixels] @ pose[:3, :3].T
        directions = self.space.turn(torch.from_numpy(directions.astype(np.float32))).contiguous()
        origin = self.space.places(torch.from_numpy(pose[None, :3, 3].astype(np.float32)))
        near, far = np.float32(self.space.near_m), np.float32(self.space.far_m)
        depth_m = np.zeros(len(pixels), np.float32)
        if scene.depth_m is not None:
            depth_m = np.nan_to_num(scene.depth_m[position].reshape(-1)[pixels], posinf=0, neginf=0)
        first_m = np.where(depth_m > 0, np.clip(depth_m * np.float32(begin), near, far), near)
        last_m = np.where(depth_m > 0, np.clip(depth_m * np.float32(min(end, 1e3)), near, far), far)
        origins = origin.expand_as(directions).contiguous()
        segments = (origins.numpy(), directions.numpy(), first_m, last_m)
        compiled.trace(segments, self.space.code, self.resolution, grid)
        return grid

    def _inside(self, cell: Tensor, generator: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return random places u (m, 3) in cells (m,) and their tables."""
        n = self.resolution
        jitter = torch.from_numpy(generator.random((len(cell), 3), dtype=np.float32)).to(cell.device)
        corner = torch.stack([cell % n, cell // n % n, cell // n**2 % n], dim=1)
        return torch.clamp((corner + jitter) / n, max=1), (cell // n**3).to(torch.int32)

    def _note(self, u: Tensor, table: Tensor, sigma: Tensor) -> None:
        """Let the cells at u (m, 3) decay once and rise to the thickness found there."""
        self._kernels.note(self.thickness, u, table, sigma, self.space.extent, DECAY)

    def _candidates(self) -> Tensor:
        """Return the flat places of the allowed cells, ascending; they change when `allowed` is set, and only then."""
        version = self.allowed._version
        if self._known is None or self._known[0] != version:
            self._known = version, _places_of(self.allowed)
        return self._known[1]


def _thinned(scene: Scene, position: int, trust: float) -> tuple[Pixels, Pixels, Pixels]:
    """Return a view's pixels (flat) with a prior value, those beyond the prior's reach, and the sky's; all thinned.

    A hole between values is neither: it is within the closing of the values' mask.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    height, width = scene.camera.size
    stride = max(1, round(scene.camera.fx / RAYS_PER_RADIAN))
    blind = np.zeros((height, width), bool)
    blind[::stride, ::stride] = True
    sky = np.zeros_like(blind) if scene.sky is None else blind & (scene.sky[position] > 0)
    blind &= ~sky
    if scene.depth_m is None:
        return np.zeros(0, np.int64), np.flatnonzero(blind), np.flatnonzero(sky)
    valid = (scene.depth_m[position] > 0) & np.isfinite(scene.depth_m[position])
    if scene.weight is not None:
        valid &= scene.weight[position] >= np.float32(255 * trust)
    with_value = np.flatnonzero(valid)
    if len(with_value):
        # The window holds about a dozen values where they are spread evenly.
        window = 2 * int(np.clip(np.ceil(2 / np.sqrt(valid.mean())), 2, 16)) + 1
        grown = maximum_filter(valid, window, mode="constant", cval=0)
        blind &= ~minimum_filter(grown, window, mode="constant", cval=1)
    thinned = with_value[:: max(1, len(with_value) * stride**2 // valid.size)]
    return thinned, np.flatnonzero(blind), np.flatnonzero(sky)


def _dilated(grid: Mask, resolution: int) -> Mask:
    """Set the 26 neighbours of every set cell as well, within each table."""
    from scipy.ndimage import maximum_filter

    tables = grid.reshape(-1, resolution, resolution, resolution)
    return np.stack([maximum_filter(table, 3) for table in tables]).reshape(-1)


def _places_of(marked: Tensor) -> Tensor:
    """Return the flat places (n,) of the cells, uint8, that are 1, ascending."""
    return torch.nonzero(marked.view(torch.bool).view(-1)).view(-1)


def _draw(generator: np.random.Generator, candidates: Tensor, count: int) -> Tensor:
    """Draw `count` of the candidates, with repetition."""
    drawn: npt.NDArray[Any] = generator.integers(0, max(len(candidates), 1), count)
    return candidates[torch.from_numpy(drawn).to(candidates.device)]
