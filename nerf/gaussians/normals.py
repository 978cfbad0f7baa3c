"""Normal consistency: Gaussians lie along the surface that the rendered depth shows.

After 2DGS (Huang et al., SIGGRAPH 2024, eq. 14). A Gaussian's normal n is its shortest axis, turned towards the
camera. The rendered depth, as points, has a normal N at each pixel. With the weights w of a pixel's Gaussians the loss
is the mean over the pixels of

    sum w_i (1 - n_i . N) = opacity - (sum w_i n_i) . N

The sum is rasterised as colours are: n is the colour of a second drawing of the same Gaussians, which any device's
kernels draw and go back from. Pixels at depth edges and those that are not solid do not count.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.linalg import cross

from nerf.gaussians.growth import matrices
from nerf.gaussians.types import Drawing, Gaussians, Rasterised, SplatGradients, ViewGradients, Viewpoint
from nerf.harmonics import Y0
from nerf.kernels import SplatKernels
from nerf.types import OPACITY_FLOOR
from priors.geometry import rays

EVERY = 4
"""One step in so many looks at normals, and weighs as many times more: a second drawing costs as much as a step."""
SOLID = 0.5
"""Opacity from which on a pixel has a surface."""
EDGE = 0.1
"""Between pixels whose depths differ by a larger share there is an edge."""
GREY, SPAN = 0.5, 0.4
"""A normal is drawn as the colour GREY + SPAN n: colours below 0 are not drawn."""
LEAST = 1e-12
"""Squared metres, and squared lengths of quaternions: what is shorter has no direction."""


@dataclass(frozen=True)
class Consistency:
    """The loss of a view, and its derivatives."""

    value: Tensor
    """Unweighted."""
    d_depth: Tensor
    """(h, w) by the expected depth, weighted, 1/m."""
    rows: Tensor
    """(u,) int64 which rows of the first drawing's `Rasterised.index` the next is of."""
    by: Gaussians
    """(u, ...) by the Gaussians, weighted; that by harmonics is none of theirs."""

    def add_to(self, gradients: SplatGradients) -> None:
        """Add the derivatives to those of the first drawing, in place."""
        for name in ("means_m", "log_scales", "rotations", "opacities"):
            getattr(gradients.of, name).index_add_(0, self.rows, getattr(self.by, name))


def consistency(
    splat: SplatKernels, gaussians: Gaussians, seen: Rasterised, at: Viewpoint, drawing: Drawing, weight: float
) -> Consistency:
    """Return the loss of a view that was drawn.

    Args:
        splat: the device's kernels.
        gaussians: that were drawn.
        seen: what was drawn of them.
        at: from where.
        drawing: how; its degree does not matter.
        weight: of the loss.
    """
    own = gaussians.rows(seen.index)
    away = own.means_m - torch.from_numpy(at.T_world_cam[:3, 3]).to(own.means_m)
    rotation = torch.from_numpy(at.T_world_cam[:3, :3]).to(own.means_m)
    axis, side = shortest(own, away)
    n = (side[:, None] * column(own.rotations, axis)) @ rotation  # in the camera's frame
    coloured = Gaussians(own.means_m, own.log_scales, own.rotations, own.opacities, (SPAN / Y0 * n)[:, None])
    drawn = splat.rasterise(coloured, at, replace(drawing, degree=0, median=False))
    summed = (drawn.rgb - GREY * drawn.opacity[..., None]) / SPAN
    surface = Surface(seen.depth_m(OPACITY_FLOOR), seen.opacity, at)
    share = surface.counts / surface.counts.sum().clamp(min=1)
    value = (share * (drawn.opacity - (summed * surface.normals).sum(2))).sum()
    pull = weight * share
    d_rgb = -(pull / SPAN)[..., None] * surface.normals
    d_opacity = pull * (1 + GREY / SPAN * surface.normals.sum(2))
    found = splat.backward(drawn, ViewGradients(d_rgb, None, d_opacity))
    d_n = SPAN / Y0 * found.of.harmonics[:, 0] @ rotation.T
    rows = found.index
    d_column = side[rows, None] * d_n
    found.of.rotations.add_(d_quaternions(own.rotations[rows], axis[rows], d_column))
    return Consistency(value, surface.backward(-pull[..., None] * summed), rows, found.of)


def shortest(gaussians: Gaussians, away: Tensor) -> tuple[Tensor, Tensor]:
    """Return which axis (n,) is each one's normal, and 1 or -1 (n,): it is to look back along `away` (n, 3)."""
    axis = gaussians.log_scales.argmin(1)
    towards = (column(gaussians.rotations, axis) * away).sum(1)
    return axis, torch.where(towards > 0, -1.0, 1.0).to(away)


def column(quaternions: Tensor, axis: Tensor) -> Tensor:
    """Return a column (n, 3) of each rotation matrix, those of quaternions (n, 4)."""
    return matrices(quaternions)[torch.arange(len(axis), device=axis.device), :, axis]


def d_quaternions(quaternions: Tensor, axis: Tensor, d_column: Tensor) -> Tensor:
    """Return the derivative by quaternions w x y z (n, 4) of any length, from that by a column (n, 3) of the matrices.

    With e the axis and u = (w, q) the unit quaternion, the column is e + 2 w (q x e) + 2 q x (q x e).
    """
    length = torch.linalg.vector_norm(quaternions, dim=1, keepdim=True)
    unit = quaternions / length.clamp(min=LEAST)
    w, q, g = unit[:, :1], unit[:, 1:], d_column
    e = torch.zeros_like(q).scatter_(1, axis[:, None], 1.0)

    def dot(a: Tensor, b: Tensor) -> Tensor:
        return (a * b).sum(1, keepdim=True)

    d_w = 2 * dot(g, cross(q, e))
    d_q = 2 * w * cross(e, g) + 2 * (g * dot(q, e) + dot(g, q) * e - 2 * dot(g, e) * q)
    d_unit = torch.cat([d_w, d_q], dim=1)
    d_any = (d_unit - dot(d_unit, unit) * unit) / length.clamp(min=LEAST)
    return torch.where(length > LEAST, d_any, 0.0)


class Surface:
    """The surface that a depth map shows: unit normals towards the camera, in its frame, by central differences."""

    def __init__(self, depth_m: Tensor, opacity: Tensor, at: Viewpoint) -> None:
        """Take a depth map (h, w), metres, its opacity (h, w), and the viewpoint it is seen from."""
        self._rays = torch.from_numpy(np.ascontiguousarray(rays(at.camera))).to(depth_m)
        points = self._rays * depth_m[..., None]
        self._across, self._down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
        normal = cross(self._down, self._across)
        self._length = torch.linalg.vector_norm(normal, dim=2, keepdim=True).clamp(min=LEAST)
        self._inner = normal / self._length
        self.normals = torch.zeros_like(points)
        """(h, w, 3); 0 along the rim."""
        self.normals[1:-1, 1:-1] = self._inner
        self.counts = torch.zeros_like(depth_m)
        """(h, w) 1 where it is one solid surface."""
        around = [depth_m[1:-1, 2:], depth_m[1:-1, :-2], depth_m[2:, 1:-1], depth_m[:-2, 1:-1]]
        middle, stacked = depth_m[1:-1, 1:-1], torch.stack(around)
        even = (stacked - middle).abs().amax(0) < EDGE * middle
        solid = -torch.nn.functional.max_pool2d(-opacity[None, None], 3, 1)[0, 0] > SOLID
        self.counts[1:-1, 1:-1] = (even & solid).to(depth_m)

    def backward(self, d_normals: Tensor) -> Tensor:
        """Return the derivative by the depth (h, w), from that by the normals (h, w, 3)."""
        g = d_normals[1:-1, 1:-1]
        d_cross = (g - (g * self._inner).sum(2, keepdim=True) * self._inner) / self._length
        d_down, d_across = cross(self._across, d_cross), cross(d_cross, self._down)
        d_points = torch.zeros_like(d_normals)
        d_points[1:-1, 2:] += d_across
        d_points[1:-1, :-2] -= d_across
        d_points[2:, 1:-1] += d_down
        d_points[:-2, 1:-1] -= d_down
        return (d_points * self._rays).sum(2)
