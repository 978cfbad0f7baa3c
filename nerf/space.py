"""Scene contraction and ray spacing: what the field's grid covers, how depth is spaced. The families differ here.

    box      Instant-NGP: a box; rays end where they leave it
    ball     MipNeRF-360: everything, what is outside the inner ellipsoid contracted into a shell
    spheres  NeRF++: the same, the inside and the outside in a table each; spacing in 1/r outside

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
from nerf.types import BALL, BOX, SPHERES, Extent, Rays, Samples, Spacing

Kind: TypeAlias = Literal["box", "ball", "spheres"]
Triple: TypeAlias = tuple[float, float, float]
Points = npt.NDArray[np.floating[Any]]

CODES: dict[str, int] = {"box": BOX, "ball": BALL, "spheres": SPHERES}
NEAR_M, FAR_M = 0.5, 250.0
"""Depths in which surfaces are looked for where no prior tells, metres."""
AROUND_PATH_M = {"box": 64.0, "ball": 16.0, "spheres": 16.0}
"""How far around the path the region reaches where no prior tells, metres; outside a box is nothing."""
LEAST_HALF_M, MOST_STRETCH = 4.0, 3.0
"""The inner region's half extents: at least this, and this many times the smallest, at most."""
INNER_SHARE = {"box": 0.01, "ball": 0.10, "spheres": 0.10}
"""Share of the prior's points left out on either side of each axis."""


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

    @classmethod
    def around(
        cls,
        positions_m: Points,
        points_m: Points,
        kind: Kind,
        near_m: float | None = None,
        far_m: float | None = None,
    ) -> "Space":
        """Choose centre, axes and extents for camera positions (f, 3) and the prior's points (n, 3), n may be 0.

        The first axis follows the path, the last is the one along which the points are spread least: a street is
        long, narrow and low, and a grid stretched like it resolves all three. Extents hold the path and all but
        INNER_SHARE of the points on either side; without points, AROUND_PATH_M around the path.
        """
        points_m = points_m[np.isfinite(points_m).all(axis=1)]
        axes = _axes(positions_m, points_m)
        path, points = positions_m @ axes.T, points_m @ axes.T
        low, high = path.min(axis=0) - AROUND_PATH_M[kind], path.max(axis=0) + AROUND_PATH_M[kind]
        if len(points):
            share = INNER_SHARE[kind]
            low = np.minimum(np.quantile(points, share, axis=0), path.min(axis=0) - 1)
            high = np.maximum(np.quantile(points, 1 - share, axis=0), path.max(axis=0) + 1)
        half = np.maximum((high - low) / 2, LEAST_HALF_M)
        half = np.maximum(half, half.max() / MOST_STRETCH)
        near, far = _reach(positions_m, points_m)
        return cls(
            kind,
            _triple(((low + high) / 2) @ axes),
            _triple(half),
            near if near_m is None else near_m,
            far if far_m is None else far_m,
            (_triple(axes[0]), _triple(axes[1]), _triple(axes[2])),
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
        """Depth up to which spacing is linear, box and ball: the middle one of the half extents."""
        return sorted(self.half_m)[1]

    @property
    def extent(self) -> Extent:
        """How large it is."""
        return Extent(self.code, float(np.prod(self.half_m) ** (1 / 3)), self.farthest)

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
            knee = torch.clamp(twin.exits(origins, directions), min=min(self.half_m) / 2, max=self.far_m)
        if self.kind == "box":
            near, far = twin.clip(origins, directions, near, far)
        return Aim(origins.contiguous(), directions.contiguous(), self.spacing(knee), near, far)

    def spacing(self, knee_m: Tensor) -> Spacing:
        """Return how depth is spaced with knees (r,)."""
        low = twin.ramp(torch.full_like(knee_m, self.near_m), knee_m)
        span = twin.ramp(torch.full_like(knee_m, self.far_m), knee_m) - low
        return Spacing(knee_m, low, span, self.near_m, self.far_m)


def _axes(positions_m: Points, points_m: Points) -> npt.NDArray[np.float64]:
    """Choose orthonormal axes, (3, 3), one a row, each near the world axis of its row."""
    _, path_spread, path = np.linalg.svd(positions_m - positions_m.mean(axis=0), full_matrices=True)
    spread = np.diag([1.0, 1.0, 1.0])
    if len(points_m) > 2:
        near = points_m[:: max(1, len(points_m) // 20_000)].astype(np.float64)
        near = near - np.median(near, axis=0)
        near = near[np.linalg.norm(near, axis=1) <= np.quantile(np.linalg.norm(near, axis=1), 0.8)]
        spread = near.T @ near / len(near)
    elif path_spread[0] < 1:
        return np.eye(3)
    if path_spread[0] / np.sqrt(len(positions_m)) < 1:
        axes = np.linalg.eigh(spread)[1].T
    else:
        # Across the path: the directions in which the points are spread most and least.
        across = np.eye(3) - np.outer(path[0], path[0])
        axes = np.linalg.eigh(across @ (spread + 1e-6 * np.diag([1.0, 2.0, 3.0])) @ across)[1].T
        axes[0] = path[0]
    return _nearest_order(axes)


def _nearest_order(axes: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Order and sign axes (3, 3) so that each row lies near its world axis."""
    from scipy.optimize import linear_sum_assignment

    _, order = linear_sum_assignment(-np.abs(axes.T))
    axes = axes[order]
    return axes * np.where(np.diag(axes) < 0, -1.0, 1.0)[:, None]


def _reach(positions_m: Points, points_m: Points) -> tuple[float, float]:
    """Choose near and far, metres, from the points' distances to the nearest camera."""
    if not len(points_m):
        return NEAR_M, FAR_M
    from scipy.spatial import cKDTree

    some = points_m[:: max(1, len(points_m) // 100_000)]
    distance_m = cKDTree(positions_m).query(some)[0]
    path_m = float(np.linalg.norm(np.ptp(positions_m, axis=0)))
    farthest_m = float(np.quantile(distance_m, 0.999))
    near_m = float(np.clip(0.5 * np.quantile(distance_m, 0.001), 0.05, NEAR_M))
    return near_m, float(np.clip(1.25 * (farthest_m + min(path_m, farthest_m)), 40.0, 1000.0))


def _triple(values: npt.NDArray[np.floating[Any]]) -> Triple:
    return float(values[0]), float(values[1]), float(values[2])
