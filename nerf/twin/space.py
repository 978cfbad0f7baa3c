"""Scene contraction and ray spacing in plain torch: what the kernels must equal. Any dtype, any device.

`place` is a point in the space's own axes, divided by its half extents: the inner region is |place| <= 1. Sums and
products are spelt out in the kernels' order, so that float32 gives the same bits.
"""

import torch
from torch import Tensor

from nerf.types import BOX, CUBE, SPHERES, Extent, Spacing

_LARGEST = 1e15
"""Beyond it only the direction of a place counts: its square must not overflow float32."""


def length(place: Tensor) -> Tensor:
    """Return |place| (n,) of (n, 3), each no larger than 1e18."""
    x, y, z = place.unbind(-1)
    # PyTorch's float32 root on the CPU is not always the nearest one; a rounded float64 one is.
    return torch.sqrt((x * x + y * y + z * z).double()).to(place.dtype)


def size(place: Tensor, kind: int) -> Tensor:
    """Return how far out places (n, 3) lie, (n,): 1 on the inner region's border, a cube's or a ball's."""
    return place.abs().amax(dim=-1) if kind == CUBE else length(place)


def warp(place: Tensor, kind: int) -> tuple[Tensor, Tensor]:
    """Map places (n, 3) to u (n, 3) in [0, 1] and the table (n,) int32 that holds them.

    box: u = (x + 1) / 2, clipped. ball: u = z / 4 + 1/2 with z = x inside the unit ball and (2 - 1/|x|) x/|x| outside
    (MipNeRF-360, equation 10). cube: the same, |x| being the largest coordinate, as in nerfstudio's contraction of
    order infinity: a box, and all that is outside of it in a shell. spheres: the unit ball fills table 0, the shell
    outside is table 1 of the same z: (x/|x|, 1/|x|) of NeRF++ is what z holds.
    """
    inner = torch.zeros(place.shape[:-1], dtype=torch.int32, device=place.device)
    if kind == BOX:
        return torch.clamp(place * 0.5 + 0.5, 0, 1), inner
    largest = place.abs().amax(dim=-1, keepdim=True)
    place = place * torch.clamp(torch.reciprocal(largest) * _LARGEST, max=1)
    inverse = 1 / torch.clamp(size(place, kind), min=1)
    shrunk = place * ((2 - inverse) * inverse)[..., None]
    if kind != SPHERES:
        return shrunk * 0.25 + 0.5, inner
    outside = inverse < 1
    u = torch.where(outside[..., None], shrunk * 0.25 + 0.5, place * 0.5 + 0.5)
    return u, outside.to(torch.int32)


def unwarp(u: Tensor, table: Tensor, kind: int, farthest: float) -> Tensor:
    """Map u (n, 3) back to places (n, 3); what lies beyond |place| = farthest is pulled back to it."""
    if kind == BOX:
        return u * 2 - 1
    z = u * 4 - 2
    radius = size(z, kind)
    outer = 1 / torch.clamp(2 - radius, min=1 / farthest)
    place = torch.where((radius > 1)[..., None], z * (outer / torch.clamp(radius, min=1))[..., None], z)
    return place if kind != SPHERES else torch.where((table > 0)[..., None], place, u * 2 - 1)


def stretch(u: Tensor, table: Tensor, extent: Extent) -> Tensor:
    """Return the metres (n,) that one unit of u spans, away from the centre, at u (n, 3); half extents averaged."""
    if extent.kind == BOX:
        return torch.full_like(u[:, 0], 2 * extent.mean_m)
    radius = torch.clamp(size(unwarp(u, table, extent.kind, extent.farthest), extent.kind), min=1)
    outer = 4 * extent.mean_m * (radius * radius)
    return outer if extent.kind != SPHERES else torch.where(table > 0, outer, 2 * extent.mean_m)


def ramp(t: Tensor, knee: Tensor) -> Tensor:
    """Squeeze depths [0, inf) into [0, 1): linear up to the knee, at 1/2, then linear in 1/t."""
    return torch.where(t < knee, t / (2 * knee), 1 - knee / (2 * torch.maximum(t, knee)))


def unramp(g: Tensor, knee: Tensor) -> Tensor:
    """Undo `ramp`."""
    return torch.where(g < 0.5, 2 * knee * g, knee / (2 * (1 - torch.clamp(g, min=0.5))))


def spacing(t: Tensor, ramps: Spacing) -> Tensor:
    """Map camera-z depths t, metres, to s in [0, 1]: linear up to the knee, then linear in 1/t."""
    return torch.clamp((ramp(t, ramps.knee_m) - ramps.low) / ramps.span, 0, 1)


def depth(s: Tensor, ramps: Spacing) -> Tensor:
    """Map s in [0, 1] to camera-z depths, metres: `spacing` undone."""
    return torch.clamp(unramp(ramps.low + s * ramps.span, ramps.knee_m), ramps.near_m, ramps.far_m)


def exits(origin: Tensor, direction: Tensor) -> Tensor:
    """Return the depths (r,) where rays (places) leave the unit ball; 0 where they miss it or it lies behind."""
    a = (direction * direction).sum(-1)
    b = (origin * direction).sum(-1)
    # |origin|^2 - (b^2 / a) by the closest point: no difference of large squares far from the centre.
    closest = origin - direction * (b / a)[..., None]
    inside = 1 - (closest * closest).sum(-1)
    return torch.clamp((torch.sqrt(torch.clamp(inside, min=0) * a) - b) / a, min=0) * (inside > 0)


def clip(origin: Tensor, direction: Tensor, near: Tensor, far: Tensor) -> tuple[Tensor, Tensor]:
    """Cut depths [near, far] (r,) to the box |place| <= 1; far = near where the ray misses it."""
    slope = torch.where(direction.abs() < 1e-12, torch.full_like(direction, 1e-12), direction)
    one, other = (-1 - origin) / slope, (1 - origin) / slope
    enter = torch.maximum(near, torch.minimum(one, other).amax(-1))
    leave = torch.minimum(far, torch.maximum(one, other).amin(-1))
    return torch.minimum(enter, far), torch.maximum(leave, torch.minimum(enter, far))
