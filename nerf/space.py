"""Scene contraction and ray spacing: what the field's grid covers, how depth is spaced. The families differ here.

    cube     Instant-NGP: a box, and everything outside of it contracted into a shell around it
    ball     MipNeRF-360: everything, what is outside the inner ellipsoid contracted into a shell
    spheres  NeRF++: the same, the inside and the outside in a table each; spacing in 1/r outside
    box      a box and nothing else: runs of earlier versions; rays end where they leave it

The path alone says where the inner region lies and how large it is: a prior fills a space and never moves it.
Metres end here: `place` is a point in the space's axes divided by its half extents, |place| <= 1 inside.
"""

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nerf.kernels import kernels_for
from nerf.twin import space as twin
from nerf.types import BALL, BOX, CUBE, SPHERES, Extent, Rays, Samples, Spacing

Kind: TypeAlias = Literal["cube", "ball", "spheres", "box"]
Triple: TypeAlias = tuple[float, float, float]
Poses = npt.NDArray[np.floating[Any]]

CODES: dict[str, int] = {"box": BOX, "ball": BALL, "spheres": SPHERES, "cube": CUBE}
NEAR_M, FAR_M = 0.5, 250.0
"""Camera-z depths where samples begin and end, metres; what is farther is as good as sky."""
AROUND_PATH_M = 16.0
"""How far around the path the inner region reaches, metres."""
MOST_STRETCH = 3.0
"""The inner region's half extents: this many times the smallest, at most."""
KNEE_M = 16.0
"""Camera-z depth up to which spacing is linear, at most: steps follow what a camera sees near it, not the path."""
DETAILED_M = 200.0
"""Length of an axis that has as many cells as a field's config says; a longer one has more, so that they stay small."""
AIR_M = 3.0
"""Length over which a cell's density must be thin before the cell counts as empty, metres. Where a cell's own width
decided, half of the space near the cameras was taken for empty before colours alone had learned anything there."""
SHORT_M, STRAIGHT = 1.0, 0.02
"""A path with less spread than this, metres, has no direction; axes with a sine below this are taken as parallel."""


@dataclass(frozen=True, slots=True)
class Aim:
    """Rays in the space: everything that samplers need; (r,) or (r, 3)."""

    origins: Tensor
    """(r, 3) places of the camera centres."""
    directions: Tensor
    """(r, 3) change of place per metre of depth."""
    spacing: Spacing
    """Depth to s and back."""
    first_m: Tensor
    """(r,) depth where the space begins for this ray."""
    last_m: Tensor
    """(r,) depth where it ends; not beyond first_m where the ray misses it."""


@dataclass(frozen=True)
class Space:
    """Centre, axes and extent of a field's space; a place's map to u in [0, 1]^3 and a depth's to s in [0, 1]."""

    kind: Kind
    """box, ball or spheres."""
    centre_m: Triple
    """World position of the centre."""
    half_m: Triple
    """Half extents along the axes: of the box, or the semi-axes of the inner ellipsoid."""
    near_m: float
    """Camera-z depth where samples begin."""
    far_m: float
    """Camera-z depth where they end."""
    axes: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    """The space's axes in the world, one a row, orthonormal."""
    knee_most_m: float | None = None
    """Camera-z depth up to which spacing is linear, at most; None, in earlier runs: the middle one of half_m."""
    detail: float = 1.0
    """How many times as many cells an axis of the field's finest level has as the model's config says."""
    air_m: float = 0.0
    """Cells are taken to be at least so wide where their density says whether they are empty; 0 in earlier runs."""

    @classmethod
    def along(cls, T_world_cam: Poses, kind: Kind) -> "Space":
        """Lay a space along the path of cameras (f, 4, 4).

        The first axis follows the path, another the cameras' down: a street is long, narrow and low, and a grid
        stretched like it resolves all three. The extents hold the path and AROUND_PATH_M around it.
        """
        axes = _axes(T_world_cam)
        path = T_world_cam[:, :3, 3] @ axes.T
        low, high = path.min(axis=0), path.max(axis=0)
        half = (high - low) / 2 + AROUND_PATH_M
        half = np.maximum(half, half.max() / MOST_STRETCH)
        side_m = float(half.max()) * (2 if kind == "box" else 4)
        return cls(
            kind,
            _triple(((low + high) / 2) @ axes),
            _triple(half),
            NEAR_M,
            FAR_M,
            (_triple(axes[0]), _triple(axes[1]), _triple(axes[2])),
            KNEE_M,
            max(1.0, side_m / DETAILED_M),
            AIR_M,
        )

    @property
    def code(self) -> int:
        """The kind as the kernels know it."""
        return CODES[self.kind]

    @property
    def tables(self) -> int:
        """How many tables a field of this space has."""
        return 2 if self.kind == "spheres" else 1

    @property
    def knee_m(self) -> float:
        """Depth up to which spacing is linear: the middle one of the half extents, or less where they are large."""
        return self._bent(sorted(self.half_m)[1])

    @property
    def extent(self) -> Extent:
        """How large it is."""
        return Extent(self.code, float(np.prod(self.half_m) ** (1 / 3)), self.farthest, self.air_m)

    @property
    def farthest(self) -> float:
        """|place| of what lies about far_m away."""
        return self.far_m / min(self.half_m)

    def places(self, points_m: Tensor) -> Tensor:
        """Map world points (n, 3), metres, to places."""
        return self.turn(torch.clamp(points_m - points_m.new_tensor(self.centre_m), -1e30, 1e30))

    def turn(self, vectors_m: Tensor) -> Tensor:
        """Map world vectors (n, 3), metres, to changes of place."""
        scale = np.array(self.axes) / np.array(self.half_m)[:, None]
        return vectors_m @ torch.tensor(scale, dtype=vectors_m.dtype, device=vectors_m.device).T

    def warp(self, points_m: Tensor) -> tuple[Tensor, Tensor]:
        """Map world points (n, 3), metres, to u (n, 3) in [0, 1] and table (n,) int32."""
        return twin.warp(self.places(points_m), self.code)

    def unwarp(self, u: Tensor, table: Tensor) -> Tensor:
        """Map u (n, 3) and table (n,) to world points (n, 3), metres; at most about far_m away."""
        place = twin.unwarp(u, table, self.code, self.farthest)
        axes = u.new_tensor(self.axes)
        return (place * u.new_tensor(self.half_m)) @ axes + u.new_tensor(self.centre_m)

    def stretch_m(self, u: Tensor, table: Tensor) -> Tensor:
        """Return the metres (n,) that one unit of u spans, away from the centre, at u (n, 3); extents averaged."""
        return kernels_for(u.device).sample.stretch(u, table, self.extent)

    def footprint(self, samples: Samples, pixel: float) -> Tensor:
        """Return the samples' standard deviations across the ray, (m,) in units of u; pixel: 1 / focal length.

        A pixel is as wide as a cone of standard deviation t pixel / sqrt(12) (Barron et al., ICCV 2021, eq. 8).
        """
        return samples.t * (pixel / 12**0.5) / self.stretch_m(samples.u, samples.table)

    def aim(self, rays: Rays) -> Aim:
        """Bring rays into the space: places, spacing, and the depths between which they are in it."""
        origins, directions = self.places(rays.origins_m), self.turn(rays.directions)
        near, far = torch.full_like(origins[:, 0], self.near_m), torch.full_like(origins[:, 0], self.far_m)
        knee = torch.full_like(near, self.knee_m)
        if self.kind == "spheres":
            least, most = self._bent(min(self.half_m) / 2), self._bent(self.far_m)
            knee = torch.clamp(twin.exits(origins, directions), min=least, max=most)
        if self.kind == "box":
            near, far = twin.clip(origins, directions, near, far)
        return Aim(origins.contiguous(), directions.contiguous(), self.spacing(knee), near, far)

    def _bent(self, knee_m: float) -> float:
        """Return a knee, metres, or the largest that this space has."""
        return knee_m if self.knee_most_m is None else min(knee_m, self.knee_most_m)

    def spacing(self, knee_m: Tensor) -> Spacing:
        """Return how depth is spaced with knees (r,)."""
        low = twin.ramp(torch.full_like(knee_m, self.near_m), knee_m)
        span = twin.ramp(torch.full_like(knee_m, self.far_m), knee_m) - low
        return Spacing(knee_m, low, span, self.near_m, self.far_m)


def _axes(T_world_cam: Poses) -> npt.NDArray[np.float64]:
    """Choose orthonormal axes, (3, 3), one a row, each near the world axis of its row.

    The path comes first, then the cameras' mean down; where one says nothing, where they look and their right do.
    """
    positions_m = T_world_cam[:, :3, 3]
    _, spread, ways = np.linalg.svd(positions_m - positions_m.mean(axis=0), full_matrices=False)
    right, down, ahead = T_world_cam[:, :3, :3].mean(axis=0).T
    moves = spread[0] / np.sqrt(len(positions_m)) >= SHORT_M
    axes: list[npt.NDArray[np.float64]] = []
    for way in (*([ways[0]] if moves else []), down, ahead, right, *np.eye(3)):
        rest = way - sum((axis * (axis @ way) for axis in axes), np.zeros(3))
        if len(axes) < 3 and np.linalg.norm(rest) > STRAIGHT:
            axes.append(rest / np.linalg.norm(rest))
    return _nearest_order(np.stack(axes))


def _nearest_order(axes: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Order and sign axes (3, 3) so that each row lies near its world axis."""
    from scipy.optimize import linear_sum_assignment

    _, order = linear_sum_assignment(-np.abs(axes.T))
    axes = axes[order]
    return axes * np.where(np.diag(axes) < 0, -1.0, 1.0)[:, None]


def _triple(values: npt.NDArray[np.floating[Any]]) -> Triple:
    return float(values[0]), float(values[1]), float(values[2])
