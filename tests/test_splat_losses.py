"""Losses of whole views: their derivatives are autograd's of the formulas, kl and urf look at intervals of a ray."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.special import ndtr

from nerf.gaussians.losses import DEPTH_SHARE, geometry_losses, intervals
from nerf.gaussians.shot import Shot
from nerf.gaussians.types import Contributions, Drawing, Gaussians, Rasterised, Viewpoint
from nerf.kernels import kernels_for
from nerf.losses import LossConfig
from nerf.types import Target
from priors.types import Camera

pytestmark = pytest.mark.splats

SIZE = (6, 8)
CAMERA = Camera(np.array([[8.0, 0, 3.5], [0, 8, 2.5], [0, 0, 1]]), SIZE)


def shot() -> Shot:
    random = torch.Generator().manual_seed(0)
    depth_m = 4 + 8 * torch.rand(SIZE, generator=random)
    weight = torch.rand(SIZE, generator=random)
    depth_m[0], weight[0] = 0, 0
    sky = torch.zeros(SIZE)
    sky[0] = 1
    return Shot(0, Viewpoint(CAMERA, np.eye(4)), torch.rand(*SIZE, 3, generator=random), depth_m, weight, sky)


def seen(depth_sum: Tensor, opacity: Tensor) -> Rasterised:
    empty = torch.zeros(0)
    return Rasterised(torch.zeros(*SIZE, 3), depth_sum, opacity, torch.zeros(SIZE), empty.long(), empty, None)


@pytest.mark.parametrize("loss", ["mse", "l1"])
@pytest.mark.parametrize("mean", ["prior", "all"])
def test_derivatives_are_those_of_the_formulas(loss: Any, mean: Any) -> None:
    rules = LossConfig(loss, trim=0.0, depth_mean=mean, opacity=0.3, sky_opacity=0.2)
    one = shot()
    assert one.depth_m is not None and one.weight is not None and one.sky is not None
    opacity = (0.2 + 0.7 * torch.rand(SIZE, generator=torch.Generator().manual_seed(1))).requires_grad_()
    depth_sum = (7 * torch.rand(SIZE, generator=torch.Generator().manual_seed(2))).requires_grad_()
    off = (depth_sum / opacity - one.depth_m) / rules.unit_m
    each = off.abs() if loss == "l1" else off * off
    count = float(each.numel()) if mean == "all" else one.weight.sum()
    depth = (one.weight * each).sum() / count
    clear = (one.weight * (1 - opacity)).sum() / (one.weight > 0).sum()
    solid = -torch.log(1 - opacity + 0.05)[0].mean()
    total = DEPTH_SHARE * rules.depth_weight * depth + 0.3 * clear + 0.2 * solid
    wanted = torch.autograd.grad(total, (depth_sum, opacity))
    made = geometry_losses(rules, one, seen(depth_sum.detach(), opacity.detach()), 0, (0, 0))
    for name, value in (("depth", depth), ("opacity", clear), ("sky", solid)):
        assert float(made.terms[name]) == pytest.approx(float(value.detach()), rel=1e-5)
    assert float(made.total) == pytest.approx(float(total.detach()), rel=1e-5)
    assert torch.allclose(made.d_depth_sum, wanted[0], rtol=1e-4, atol=1e-8)
    assert torch.allclose(made.d_opacity, wanted[1], rtol=1e-4, atol=1e-8)


def test_the_largest_errors_are_trimmed() -> None:
    rules = LossConfig("l1", trim=0.1, by_confidence=False)
    one = shot()
    assert one.depth_m is not None and one.weight is not None
    found = torch.where(one.depth_m > 0, one.depth_m, 1.0)
    found[3, 3] += 50
    made = geometry_losses(rules, one, seen(found, torch.ones(SIZE)), 0, (0, 0))
    assert float(made.terms["depth"]) == 0
    assert not made.d_depth_sum[3, 3]


def test_without_a_prior_there_is_nothing_to_lose() -> None:
    one = replace(shot(), depth_m=None, weight=None, sky=None)
    made = geometry_losses(LossConfig(), one, seen(torch.ones(SIZE), torch.ones(SIZE)), 8, (0, 0))
    assert not made.terms and not float(made.total) and not made.d_opacity.any()


def made_of(depths_m: list[list[float]]) -> Contributions:
    flat = torch.tensor([depth for ray in depths_m for depth in ray])
    offsets = torch.tensor([0, *np.cumsum([len(ray) for ray in depths_m]).tolist()])
    alphas = torch.full_like(flat, 0.5)
    return Contributions(torch.arange(len(depths_m)), offsets, torch.arange(len(flat)), alphas, alphas, flat)


def test_intervals_end_half_way_to_the_neighbours() -> None:
    samples = intervals(made_of([[2.0, 4.0, 9.0], [], [5.0]]))
    low, high = samples.t - samples.dt_m / 2, samples.t + samples.dt_m / 2
    assert samples.used == 4 and samples.ray[:4].tolist() == [0, 0, 0, 2]
    assert low[:4].tolist() == pytest.approx([0.0, 3.0, 6.5, 0.0], abs=1e-3)
    assert high[:4].tolist() == pytest.approx([3.0, 6.5, 1009.0, 1005.0])
    assert not samples.dt_m[4:].any()


def test_intervals_feed_the_losses_of_single_samples() -> None:
    """kl by hand: q log w over the masses of the prior's normal distribution."""
    made = made_of([[2.0, 4.0, 9.0]])
    samples, target = intervals(made), Target(torch.ones(1), torch.tensor([4.5]), torch.tensor([1.0]))
    tau = torch.zeros_like(samples.t)
    tau[:3] = -torch.log1p(-made.alphas)
    render = kernels_for(torch.device("cpu")).render
    value = render.kl(samples, tau / samples.dt_m.clamp(min=1e-6), target, torch.ones(1), torch.zeros_like(tau))
    edges = torch.tensor([-torch.inf, 3.0 - 4.5, 6.5 - 4.5, torch.inf])
    q = ndtr(edges[1:]) - ndtr(edges[:-1])
    w = torch.tensor([0.5, 0.25, 0.125])
    assert float(value) == pytest.approx(float(-(q * torch.log(w)).sum()), rel=1e-3)


@pytest.mark.parametrize("loss", ["kl", "urf"])
def test_losses_of_rays_fall_along_their_gradient(loss: Any) -> None:
    """Of a few Gaussians in a row: a step down the gradient of opacity lowers the loss as much as it says."""
    rules, splat = LossConfig(loss, trim=0.0, opacity=0.0, sky_opacity=0.0), kernels_for(torch.device("cpu")).splat
    random = torch.Generator().manual_seed(3)
    count = 40
    means = torch.rand(count, 3, generator=random) * torch.tensor([4.0, 3.0, 10.0]) + torch.tensor([-2.0, -1.5, 3.0])
    rotations = torch.tensor([1.0, 0, 0, 0]).repeat(count, 1)
    parts = (torch.full((count, 3), -1.0), rotations, torch.zeros(count), torch.zeros(count, 1, 3))
    gaussians, one = Gaussians(means, *parts), shot()

    def look() -> tuple[float, Tensor]:
        drawn = splat.rasterise(gaussians, one.viewpoint, Drawing(degree=0, enough=0.0))
        made = geometry_losses(rules, one, drawn, 1000, (0, 0))
        back = splat.backward(drawn, made.gradients(torch.zeros_like(drawn.rgb)))
        whole = torch.zeros(count)
        whole[back.index] = back.of.opacities
        return float(made.total), whole

    value, gradient = look()
    gaussians.opacities.sub_(1e-2 * gradient / gradient.norm())
    assert look()[0] - value == pytest.approx(-1e-2 * float(gradient.norm()), rel=0.1)
