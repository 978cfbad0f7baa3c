"""Data of a radiance field: rays, samples, what was rendered, a hash grid's size, the networks' weights.

All of `nerf` may import this file, and it imports nothing of `nerf`: what works on the data lies above it.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from priors.errors import DataError
from priors.types import Camera, Depth, FloatMap, Matrix

BOX, BALL, SPHERES, CUBE = 0, 1, 2, 3
"""The kinds of a space as the kernels know them: nerf.space."""
FEATURES = 2
"""Features of a grid's row: two bfloat16 are one 32-bit word in the kernels."""
HASH_PRIME_Y, HASH_PRIME_Z = 2654435761, 805459861
"""Instant-NGP's primes (Müller et al. 2022, section 3)."""
SAMPLE_BLOCK = 2048
"""The number of samples is padded to a multiple of this: matrix libraries prepare themselves anew for every shape."""
OPACITY_FLOOR = 1e-3
"""Expected depth is divided by the opacity, or by this where a ray is clearer."""
SIGHT_DEVIATIONS = 3.0
"""How many standard deviations around the prior URF's line-of-sight loss reaches."""
LEAST_OPACITY = 1e-12
"""Smallest opacity whose logarithm is taken."""
LEAST_MASS = 1e-6
"""A ray with less of the prior's mass than this in its samples has no target: its KL loss is 0."""
INTERLEVEL_SOFT = 1e-7
"""Added to the weights that the interlevel loss divides by."""
STEEPEST = 1e18
"""Adam holds gradients within this: float32 does not hold a steeper one's square, and the weight would stand still."""
OPAQUE = 0.5
"""Least opacity of a pixel whose depth is kept: below it, most of the light is the sky's."""

Key: TypeAlias = tuple[int, int]
"""Seed and step: what random numbers are drawn from."""


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
            raise DataError(f"hash grid: expected 1 to 16 levels of 2^4 to 2^24 rows and a table, found {self}")
        if not 1 <= self.coarsest <= self.finest <= 1 << 20:
            raise DataError(f"hash grid: expected 1 <= coarsest <= finest <= 2^20 cells, found {self}")

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
            shapes.append((resolution, HASH_PRIME_Y, HASH_PRIME_Z, 32 - config.log2_size, size - 1, start))
            start += size
    return np.array(shapes, dtype=np.int64).astype(np.uint32).view(np.int32), start


class Layers(NamedTuple):
    """The weights of a field's two networks, (out, in) each; no biases."""

    density0: Tensor
    density1: Tensor
    colour0: Tensor
    colour1: Tensor
    colour2: Tensor


@dataclass(frozen=True, slots=True)
class Rays:
    """A batch of rays in the scene's metric frame and what is known about each; float32 tensors on one device.

    `t` along a ray is camera-z depth in metres, because directions have camera-z 1.
    """

    origins_m: Tensor
    """(r, 3) camera centres, metres."""
    directions: Tensor
    """(r, 3) world directions whose camera-z component is 1: origin + t * direction lies at camera-z depth t."""
    rgb: Tensor | None = None
    """(r, 3) colours in [0, 1]; None when rendering new views."""
    depth_m: Tensor | None = None
    """(r,) the prior's camera-z depth, 0 = no value; None without a prior."""
    weight: Tensor | None = None
    """(r,) how much the prior's value counts, [0, 1]; None: 1 where there is a value."""
    pixel: float = 0.0
    """Width of a pixel at a camera-z depth of 1: 1 / focal length in pixels; 0: rays are lines."""
    share: Tensor | None = None
    """(r,) share of each ray in a mean over the batch; None: 1 / r."""
    sky: Tensor | None = None
    """(r,) 1 where the ray goes to the sky, else 0; None: nobody knows."""

    def to(self, device: torch.device) -> "Rays":
        """Return the rays on a device."""
        rest = (self.rgb, self.depth_m, self.weight, self.share, self.sky)
        rgb, depth_m, weight, share, sky = (None if x is None else x.to(device) for x in rest)
        origins_m, directions = self.origins_m.to(device), self.directions.to(device)
        return Rays(origins_m, directions, rgb, depth_m, weight, self.pixel, share, sky)

    def __len__(self) -> int:
        return self.origins_m.shape[0]

    @property
    def norms(self) -> Tensor:
        """(r,) metres along the ray per metre of camera-z depth."""
        return torch.linalg.vector_norm(self.directions, dim=-1)

    @property
    def units(self) -> Tensor:
        """(r, 3) unit directions, what colour depends on."""
        return self.directions / self.norms[:, None]


class Target(NamedTuple):
    """Where a batch's prior expects surfaces: a normal distribution of depth on each ray; (r,) tensors."""

    norms: Tensor
    """Metres along the ray per metre of camera-z depth."""
    prior_m: Tensor
    """Camera-z depth, metres; 0 = no value."""
    deviation_m: Tensor
    """Standard deviation, metres."""


class Extent(NamedTuple):
    """How large a space and its cells are: what nerf.twin.space, `stretch`, and nerf.twin.occupancy need."""

    kind: int
    """BOX, BALL, SPHERES or CUBE."""
    mean_m: float
    """Geometric mean of the half extents, metres."""
    farthest: float
    """|place| beyond which places are pulled back."""
    air_m: float = 0.0
    """An occupancy grid's cell is as thick as so much of its density, metres, where it is smaller than that."""


class Spacing(NamedTuple):
    """How depth along each ray is spaced: nerf.twin.space, `spacing` and `depth`, map it to s in [0, 1] and back."""

    knee_m: Tensor
    """(r,) depth up to which spacing is linear; beyond it is linear in 1 / depth."""
    low: Tensor
    """(r,) ramp of the near depth."""
    span: Tensor
    """(r,) ramp of the far depth, less low."""
    near_m: float
    """Camera-z depth of s = 0."""
    far_m: float
    """Camera-z depth of s = 1."""


@dataclass(frozen=True, slots=True)
class Course:
    """Along what each ray's candidates lie: a stretch even in s, then a band even in depth; (r,) or (r, 3) tensors."""

    origins: Tensor
    """(r, 3) places of the camera centres."""
    directions: Tensor
    """(r, 3) change of place per metre of depth."""
    norms: Tensor
    """(r,) metres along the ray per metre of depth."""
    spacing: Spacing
    """Depth to s and back."""
    start: Tensor
    """(r,) s where the stretch begins."""
    stop: Tensor
    """(r,) s where it ends; not beyond start: no stretch."""
    count: Tensor
    """(r,) int32 candidates in the stretch."""
    band0_m: Tensor
    """(r,) depth where the band begins."""
    band1_m: Tensor
    """(r,) depth where it ends; not beyond band0_m: no band."""
    shift: Tensor
    """(r,) in (0, 1]: the candidates' edges move by this share of an interval; 1: whole intervals only."""
    ends: Tensor | None
    """(2, r, slots) the candidates' ends in s, given instead of a stretch and a band; equal ends: none."""
    band_count: int
    """Candidates in each band."""
    slots: int
    """Columns that hold any ray's candidates."""
    kind: int
    """The space's kind: BOX, BALL, SPHERES or CUBE."""


@dataclass(frozen=True, slots=True)
class Samples:
    """Packed samples of r rays, near to far: ray i has offsets[i] to offsets[i + 1]; from `used` on is padding."""

    offsets: Tensor
    """(r + 1,) int64; the last is `used`."""
    ray: Tensor
    """(m,) int32 index of the sample's ray; -1 in the padding."""
    t: Tensor
    """(m,) camera-z depth of the interval's middle, metres."""
    dt_m: Tensor
    """(m,) the interval's length along the ray, metres; 0 in the padding."""
    s0: Tensor
    """(m,) start of the interval in the space's spacing coordinate, [0, 1]."""
    s1: Tensor
    """(m,) end of the interval in that coordinate."""
    u: Tensor
    """(m, 3) place in the field's grid, [0, 1]."""
    table: Tensor
    """(m,) int32: which of the field's tables holds it (0 inner, 1 outer)."""
    used: int
    """How many samples are real."""


class Histogram(NamedTuple):
    """Where the next round of samples goes: the samples of a round and the weights that it gave them."""

    samples: Samples
    weights: Tensor
    """(m,) share of the ray's light that each sample stops."""
    margin: float = 0.0
    """By how much each sample's interval is widened, in s."""
    anneal: float = 1.0
    """Power to which the intervals' masses are raised (MipNeRF-360, appendix C)."""


def padded_count(used: int) -> int:
    """Round a number of samples up to whole blocks, at least one: nothing has to think of empty arrays."""
    return max(1, -(-used // SAMPLE_BLOCK)) * SAMPLE_BLOCK


@dataclass(frozen=True, slots=True)
class Rendered:
    """What r rays see."""

    rgb: Tensor
    """(r, 3) colour, the sky behind everything."""
    depth_m: Tensor
    """(r,) expected camera-z depth of what is not sky, metres: sum(w t) / max(opacity, OPACITY_FLOOR)."""
    median_m: Tensor
    """(r,) camera-z depth at which half of the light is stopped; 0 where it never is."""
    transmittance: Tensor
    """(r,) share of the light that comes from the sky."""
    weights: Tensor
    """(m,) share of the ray's light that each sample stops."""


@dataclass(frozen=True, slots=True)
class Gradients:
    """Derivatives of the loss by what was rendered."""

    rgb: Tensor
    """(r, 3)"""
    depth_m: Tensor
    """(r,)"""
    transmittance: Tensor
    """(r,)"""
    weights: Tensor
    """(m,)"""
    tau: Tensor
    """(m,) by the optical depths themselves, for losses of log w (exact where w underflows)."""

    @classmethod
    def zeros(cls, rendered: Rendered) -> "Gradients":
        """Return gradients of zero."""
        like = torch.zeros_like
        flat = like(rendered.weights)
        return cls(like(rendered.rgb), like(rendered.depth_m), like(rendered.depth_m), flat, flat.clone())


@dataclass(frozen=True, slots=True)
class RenderedView:
    """What a field shows from one place."""

    rgb: FloatMap
    """(height, width, 3) in [0, 1]."""
    depth_m: FloatMap
    """(height, width) expected camera-z depth of what is not sky, metres."""
    median_m: FloatMap
    """(height, width) camera-z depth that half of the light comes from beyond; 0 where it never is."""
    opacity: FloatMap
    """(height, width) share of the light that is not the sky's, [0, 1]."""

    def solid(self, opacity: float = OPAQUE) -> Depth:
        """Return the expected depth where the field is at least so opaque."""
        sure = (self.opacity >= opacity) & np.isfinite(self.depth_m) & (self.depth_m > 0)
        return Depth(np.where(sure, self.depth_m, 0).astype(np.float32))


Render: TypeAlias = Callable[[Matrix, Camera], RenderedView]
"""Renders a field from T_world_cam (4, 4), metres, through a camera."""
