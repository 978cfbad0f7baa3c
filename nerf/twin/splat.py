"""Gaussian splatting in plain torch: the readable twin, with autograd, in any precision, on any device.

Every Gaussian in view is asked at every pixel: slow, and memory-hungry.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from nerf.gaussians.types import (
    LEAST_TURN,
    MOST_ALPHA,
    MOST_M,
    MOST_SPREAD_PX,
    SIDE_REACH,
    SIZES,
    Drawing,
    Gaussians,
    Viewpoint,
)
from nerf.harmonics import harmonics
from priors.types import Camera

BOX_MARGIN_PX = 1e-3
"""Boxes are so much wider than the Gaussian's edge: rounding must not lose a pixel."""


class Projected(NamedTuple):
    """What the image needs of each of n Gaussians."""

    mean_px: Tensor
    """(n, 2) x and y."""
    conic: Tensor
    """(n, 3) inverse covariance in the image xx, xy, yy, 1/square pixels."""
    opacity: Tensor
    """(n,) at the mean, with what the low pass took; 0: not in view."""
    rgb: Tensor
    """(n, 3)"""
    z_m: Tensor
    """(n,) camera-z depth of the mean."""
    half_px: Tensor
    """(n, 2) half the sides of the box in which it stops light, pixels; no gradient."""

    def rows(self, index: Tensor) -> "Projected":
        """Return some of the Gaussians."""
        return Projected(*(tensor[index] for tensor in self))


class Blended(NamedTuple):
    """What p pixels see of v Gaussians, near to far."""

    alphas: Tensor
    """(p, v) share of the light that arrives and is stopped; 0 from where the pixel is finished."""
    weights: Tensor
    """(p, v)"""
    before: Tensor
    """(p, v) the light that arrives."""


def turned(quaternions: Tensor) -> Tensor:
    """Return rotation matrices (n, 3, 3) of quaternions w x y z (n, 4) of any length; 0 turns nothing."""
    longest = quaternions.detach().abs().amax(1).clamp(min=LEAST_TURN)
    short = quaternions / longest[:, None]  # float32 holds no square of 1e20
    squared = (short * short).sum(1)
    usable = squared * longest * longest > LEAST_TURN
    w, x, y, z = (short * torch.where(usable, torch.where(usable, squared, 1.0).rsqrt(), 0.0)[:, None]).unbind(1)
    first = torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], 1)
    second = torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], 1)
    third = torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1)
    return torch.stack([first, second, third], 1)


def moved(viewpoint: Viewpoint, twist: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return R_cam_world (3, 3), t_cam_world (3,) and the camera's centre (3,), the scene moved by a small twist."""
    T = torch.linalg.inv(torch.as_tensor(viewpoint.T_world_cam, dtype=torch.float64)).to(twist)
    v, w = twist[:3], twist[3:]
    zero = torch.zeros_like(w[0])
    cross = torch.stack([zero, -w[2], w[1], w[2], zero, -w[0], -w[1], w[0], zero]).reshape(3, 3)
    R, t = T[:3, :3] + cross @ T[:3, :3], T[:3, 3] + v + cross @ T[:3, 3]
    return R, t, -torch.linalg.solve(R, t)


def affine(p: Tensor, axes: Tensor, camera: Camera) -> tuple[Tensor, Tensor]:
    """Return the rows (n, 3) of J V: a Gaussian's axes V (n, 3, 3) in the image, pixels.

    J is the perspective's derivative at the mean p (n, 3) in the camera's frame (Zwicker et al., EWA splatting, 2001),
    of which x / z and y / z are held to SIDE_REACH.
    """
    (fx, fy), (cx, cy), (h, w) = camera.K[[0, 1], [0, 1]], camera.K[:2, 2], camera.size
    x, y, z = p.unbind(1)
    reach_x, reach_y = (SIDE_REACH - 1) * 0.5 * w / fx, (SIDE_REACH - 1) * 0.5 * h / fy
    tx = (x / z).clamp(-cx / fx - reach_x, (w - cx) / fx + reach_x)
    ty = (y / z).clamp(-cy / fy - reach_y, (h - cy) / fy + reach_y)
    first = fx * (axes[:, 0] - tx[:, None] * axes[:, 2]) / z[:, None]
    second = fy * (axes[:, 1] - ty[:, None] * axes[:, 2]) / z[:, None]
    spread = torch.maximum((first * first).sum(1), (second * second).sum(1)).detach().sqrt()
    shrink = (MOST_SPREAD_PX / spread).clamp(max=1.0)[:, None]
    return first * shrink, second * shrink


def project(gaussians: Gaussians, viewpoint: Viewpoint, drawing: Drawing, twist: Tensor | None = None) -> Projected:
    """Project Gaussians into an image; `twist` (6,): SplatGradients.twist, zeros to be differentiated by."""
    camera = viewpoint.camera
    R, t, centre = moved(viewpoint, gaussians.means_m.new_zeros(6) if twist is None else twist)
    p = gaussians.means_m @ R.T + t
    ahead = p[:, 2] >= drawing.near_m
    p = torch.where(ahead[:, None], p, torch.ones_like(p))
    axes = R @ turned(gaussians.rotations) * gaussians.log_scales.exp().clamp(max=MOST_M)[:, None, :]
    first, second = affine(p, axes, camera)
    low = drawing.low_pass_px2
    a, b, c = (first * first).sum(1), (first * second).sum(1), (second * second).sum(1)
    normal = torch.linalg.cross(first, second)
    area = (normal * normal).sum(1)  # Cauchy-Binet: a c - b^2 without cancellation
    det = area + low * (a + c) + low * low
    some = det > 0
    det = torch.where(some, det, 1.0)
    opacity = torch.sigmoid(gaussians.opacities)
    if drawing.compensate:
        kept = some & (area > 0)
        opacity = opacity * torch.where(kept, torch.where(kept, area / det, 1.0).sqrt(), 0.0)
    seen = ahead & some & (opacity >= drawing.least_alpha)
    opacity = torch.where(seen, opacity, 0.0)
    conic = torch.stack([c + low, -b, a + low], 1) / det[:, None]
    f, middle = p.new_tensor([camera.K[0, 0], camera.K[1, 1]]), p.new_tensor(camera.K[:2, 2])
    mean_px = p[:, :2] / p[:, 2:] * f + middle
    with torch.no_grad():
        reach = (2 * torch.log((opacity / drawing.least_alpha).clamp(min=1.0))).sqrt()
        half_px = reach[:, None] * torch.stack([a + low, c + low], 1).sqrt() + BOX_MARGIN_PX
    return Projected(mean_px, conic, opacity, colours(gaussians, centre, drawing.degree), p[:, 2], half_px)


def colours(gaussians: Gaussians, centre_m: Tensor, degree: int) -> Tensor:
    """Return the colours (n, 3) of Gaussians as seen from a camera's centre (3,)."""
    used = min(SIZES[degree], gaussians.harmonics.shape[1])
    away = gaussians.means_m - centre_m
    units = away / torch.linalg.vector_norm(away, dim=1, keepdim=True).clamp(min=1e-12)
    basis = harmonics(units)[:, :used]
    return (0.5 + (basis[:, :, None] * gaussians.harmonics[:, :used]).sum(1)).clamp(min=0)


def in_view(projected: Projected, size: tuple[int, int]) -> Tensor:
    """Return which Gaussians (n,) bool have a pixel of the image in their box."""
    low, high = boxes(projected, size)
    return (projected.opacity > 0) & (low <= high).all(1)


def boxes(projected: Projected, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Return the first and last pixel (n, 2) x and y of each box, within the image."""
    edge = projected.mean_px.new_tensor([size[1] - 1, size[0] - 1])
    low = (projected.mean_px - projected.half_px).ceil().clamp(min=0)
    high = torch.minimum((projected.mean_px + projected.half_px).floor(), edge)
    return low, high


def blend(projected: Projected, pixels: Tensor, drawing: Drawing) -> Blended:
    """Blend v Gaussians, near to far, at pixels (p, 2) x and y."""
    off = pixels[:, None] - projected.mean_px
    a, b, c = projected.conic.unbind(1)
    dx, dy = off.unbind(2)
    power = -0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy
    alphas = projected.opacity * power.exp()
    alphas = torch.where(alphas >= drawing.least_alpha, alphas.clamp(max=MOST_ALPHA), 0.0)
    before = pad(torch.cumprod(1 - alphas, 1)[:, :-1], (1, 0), value=1.0)[:, : alphas.shape[1]]
    alphas = torch.where(before >= drawing.enough, alphas, 0.0)
    return Blended(alphas, before * alphas, before)


def sums(projected: Projected, blended: Blended, drawing: Drawing) -> tuple[Tensor, Tensor, Tensor]:
    """Return rgb (p, 3) before a black background, depth_sum (p,) and opacity (p,)."""
    z = torch.where(projected.z_m > drawing.cap_m, drawing.cap_m, projected.z_m)
    return blended.weights @ projected.rgb, blended.weights @ z, blended.weights.sum(1)


def median(projected: Projected, blended: Blended) -> Tensor:
    """Return the depth (p,) at which half of the light is stopped; 0: never."""
    crosses = (blended.before > 0.5) & (blended.before - blended.weights <= 0.5)
    return torch.where(crosses, projected.z_m, 0.0).sum(1)
