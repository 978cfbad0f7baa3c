"""Normal consistency: its derivatives against differences and autograd; discs turn into the surface."""

import math

import numpy as np
import pytest
import torch
from splats import SMOOTH, cloud, doubled, viewpoint
from torch import Tensor

from nerf.gaussians import normals
from nerf.gaussians.normals import Surface, consistency, d_quaternions
from nerf.gaussians.types import NAMES, Drawing, Gaussians, Viewpoint
from nerf.kernels import cpu_kernels, plain_kernels
from nerf.twin import splat as twin
from nerf.types import OPACITY_FLOOR

pytestmark = pytest.mark.splats
CPU, PLAIN = cpu_kernels().splat, plain_kernels().splat


def layer(seed: int = 0, n: int = 260) -> Gaussians:
    """Discs about a slanted wall that fills the view."""
    random = torch.Generator().manual_seed(seed)
    made = cloud(n, 1, seed, 0.4)
    xy = torch.rand(n, 2, generator=random) * torch.tensor([9.0, 6.0]) - torch.tensor([4.0, 3.2])
    z = 5 + 0.3 * xy[:, :1] + 0.05 * torch.randn(n, 1, generator=random)
    log_scales = made.log_scales - torch.tensor([0.0, 0.3, 1.2])
    return Gaussians(torch.cat([xy, z], 1), log_scales, made.rotations, made.opacities + 2, made.harmonics)


def value_by_the_twin(gaussians: Gaussians, at: Viewpoint, drawing: Drawing) -> Tensor:
    """The formula, pixel by pixel, with autograd: every Gaussian is asked everywhere."""
    height, width = at.camera.size
    projected = twin.project(gaussians, at, drawing)
    order = torch.argsort(projected.z_m.detach())
    rows = torch.arange(height).repeat_interleave(width)
    pixels = torch.stack([torch.arange(width).repeat(height), rows], 1).to(projected.z_m)
    near = projected.rows(order)
    blended = twin.blend(near, pixels, drawing)
    _, depth_sum, opacity = twin.sums(near, blended, drawing)
    axes = torch.from_numpy(at.T_world_cam[:3, :3].T.copy()).to(opacity) @ twin.turned(gaussians.rotations)
    n = axes[torch.arange(len(gaussians)), :, gaussians.log_scales.argmin(1)]
    centre = torch.from_numpy(at.T_world_cam[:3, 3]).to(opacity)
    away = (gaussians.means_m - centre) @ torch.from_numpy(at.T_world_cam[:3, :3]).to(opacity)
    n = torch.where(((n * away).sum(1) > 0)[:, None], -n, n)
    depth_m = (depth_sum / opacity.clamp(min=OPACITY_FLOOR)).view(height, width)
    total, count = torch.zeros((), dtype=opacity.dtype), 0
    (fx, fy), (cx, cy) = at.camera.K[[0, 1], [0, 1]], at.camera.K[:2, 2]

    def point(row: int, col: int) -> Tensor:
        return depth_m[row, col] * torch.tensor([(col - cx) / fx, (row - cy) / fy, 1.0]).to(opacity)

    for row in range(1, height - 1):
        for col in range(1, width - 1):
            middle = float(depth_m[row, col].detach())
            around = [float(depth_m[row + i, col + j].detach()) for i, j in ((0, 1), (0, -1), (1, 0), (-1, 0))]
            edge = max(abs(d - middle) for d in around) >= normals.EDGE * middle
            box = opacity.view(height, width)[row - 1 : row + 2, col - 1 : col + 2]
            if edge or float(box.detach().min()) <= normals.SOLID:
                continue
            down, across = point(row + 1, col) - point(row - 1, col), point(row, col + 1) - point(row, col - 1)
            N = torch.linalg.cross(down, across)
            N = N / torch.linalg.vector_norm(N)
            p = row * width + col
            total = total + (blended.weights[p] * (1 - (n[order] * N).sum(1))).sum()
            count += 1
    assert count > 100
    return total / count


def whole(splat: object, gaussians: Gaussians, at: Viewpoint, drawing: Drawing) -> tuple[float, dict[str, Tensor]]:
    """The loss, and its derivatives by all Gaussians, through both drawings."""
    from nerf.gaussians.losses import ViewLosses

    seen = splat.rasterise(gaussians, at, drawing)  # type: ignore[attr-defined]
    found = consistency(splat, gaussians, seen, at, drawing, 1.0)  # type: ignore[arg-type]
    zeros = torch.zeros_like(seen.opacity)
    losses = ViewLosses(zeros, zeros.clone(), zeros.new_zeros(()))
    losses.pull_depth(seen, found.d_depth)
    gradients = splat.backward(seen, losses.gradients(torch.zeros_like(seen.rgb)))  # type: ignore[attr-defined]
    found.add_to(gradients)
    out = {name: torch.zeros_like(x) for name, x in gaussians.tensors().items() if name != "harmonics"}
    for name, tensor in out.items():
        tensor[gradients.index] = getattr(gradients.of, name)
    return float(found.value), out


def test_it_is_the_formula_and_its_derivative_is_autograds() -> None:
    at, gaussians = viewpoint(), doubled(layer())
    leaves = Gaussians(*(x.clone().requires_grad_() for x in gaussians.tensors().values()))
    wanted = value_by_the_twin(leaves, at, SMOOTH)
    by = torch.autograd.grad(wanted, [getattr(leaves, name) for name in NAMES[:4]])
    value, found = whole(PLAIN, gaussians, at, SMOOTH)
    assert value == pytest.approx(float(wanted.detach()), rel=1e-9)
    for name, gradient in zip(NAMES[:4], by, strict=True):
        scale = float(gradient.abs().max())
        assert scale > 0 and torch.allclose(found[name], gradient, rtol=1e-6, atol=1e-8 * scale), name


def test_the_kernels_equal_the_twin() -> None:
    at, gaussians = viewpoint(), layer(1)
    value, found = whole(CPU, gaussians, at, SMOOTH)
    wanted, by = whole(PLAIN, doubled(gaussians), at, SMOOTH)
    assert value == pytest.approx(wanted, rel=1e-4)
    for name, gradient in by.items():
        off = (found[name].double() - gradient).norm() / gradient.norm()
        assert off < 2e-3, name


def test_quaternions_go_back_as_differences_say() -> None:
    random = torch.Generator().manual_seed(0)
    quaternions = torch.randn(12, 4, generator=random, dtype=torch.float64) * 3
    axis, pull = torch.arange(12) % 3, torch.randn(12, 3, generator=random, dtype=torch.float64)

    def loss(q: Tensor) -> Tensor:
        return (normals.column(q, axis) * pull).sum(1)

    found = d_quaternions(quaternions, axis, pull)
    for part in range(4):
        step = torch.zeros_like(quaternions)
        step[:, part] = 1e-5
        difference = (loss(quaternions + step) - loss(quaternions - step)) / 2e-5
        assert torch.allclose(found[:, part], difference, rtol=1e-5, atol=1e-7)
    nothing = torch.zeros(1, 4, dtype=torch.float64)
    assert not d_quaternions(nothing, axis[:1], pull[:1]).any()


def test_a_plane_has_its_own_normal() -> None:
    at = viewpoint(turned=False)
    (fx, fy), (cx, cy), (h, w) = at.camera.K[[0, 1], [0, 1]], at.camera.K[:2, 2], at.camera.size
    wanted = np.array([0.3, -0.2, -1.0])
    wanted /= np.linalg.norm(wanted)
    x, y = (np.arange(w) - cx) / fx, (np.arange(h)[:, None] - cy) / fy
    depth_m = -4 / (wanted[0] * x + wanted[1] * y + wanted[2])
    surface = Surface(torch.from_numpy(depth_m), torch.ones(h, w, dtype=torch.float64), at)
    assert surface.counts[1:-1, 1:-1].all() and not surface.counts[0].any()
    assert torch.allclose(surface.normals[1:-1, 1:-1], torch.from_numpy(wanted).expand(h - 2, w - 2, 3), atol=1e-9)
    broken = torch.from_numpy(depth_m.copy())
    broken[:, w // 2 :] *= 2
    assert not Surface(broken, torch.ones(h, w, dtype=torch.float64), at).counts[:, w // 2 - 1 : w // 2 + 1].any()


def test_discs_turn_into_the_surface() -> None:
    at, gaussians = viewpoint(), layer(2)
    first, _ = whole(CPU, gaussians, at, SMOOTH)
    for _ in range(40):
        _, by = whole(CPU, gaussians, at, SMOOTH)
        gaussians.rotations.sub_(0.05 * by["rotations"].sign())
    last, _ = whole(CPU, gaussians, at, SMOOTH)
    assert last < 0.5 * first and math.isfinite(last)
