"""The compiled renderer and losses against their plain twin, values and gradients, in float64."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from nerf.kernels.cpu import render as cpu
from nerf.kernels.plain import render as plain
from nerf.losses import LossConfig, losses, prior_weight, trimmed
from nerf.precision import SUREST, precision
from nerf.twin import render as twin
from nerf.types import SAMPLE_BLOCK, Gradients, Rays, Rendered, Samples, Target
from priors.error_model import WITHIN, spread_of


def make(counts: list[int], seed: int = 0) -> tuple[Samples, Tensor, Tensor, Tensor, Rays]:
    """Make rays with these numbers of samples, their densities, colours and skies."""
    random = torch.Generator().manual_seed(seed)

    def rand(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=random)

    rays, used = len(counts), sum(counts)
    m = SAMPLE_BLOCK * max(1, math.ceil(used / SAMPLE_BLOCK))
    offsets = torch.tensor([0, *torch.tensor(counts).cumsum(0).tolist()] if counts else [0])
    ray = torch.full((m,), -1, dtype=torch.int32)
    ray[:used] = torch.repeat_interleave(torch.arange(rays, dtype=torch.int32), torch.tensor(counts, dtype=torch.long))
    t, dt_m, s0, s1 = (torch.zeros(m) for _ in range(4))
    for first, last in zip(offsets[:-1].tolist(), offsets[1:].tolist(), strict=True):
        edges = torch.sort(rand(last - first + 1)).values
        s0[first:last], s1[first:last] = edges[:-1], edges[1:]
        t[first:last], dt_m[first:last] = 2 + 40 * (edges[:-1] + edges[1:]) / 2, 44 * (edges[1:] - edges[:-1])
    samples = Samples(offsets, ray, t, dt_m, s0, s1, torch.zeros(m, 3), torch.zeros(m, dtype=torch.int32), used)
    sigma = torch.exp(6 * rand(m) - 4)
    directions = torch.nn.functional.pad(rand(rays, 2) - 0.5, (0, 1), value=1.0)
    depth_m = 44 * rand(rays) * (rand(rays) > 0.3)
    bundle = Rays(rand(rays, 3), directions, rand(rays, 3), depth_m, rand(rays))
    return samples, sigma, rand(m, 3), rand(rays, 3), bundle


CASES = [[5, 3, 0, 17, 1], [1], [0, 0], [30] * 100, [700, 2, 1500]]
FIELDS = ("rgb", "depth_m", "median_m", "transmittance", "weights")


@pytest.mark.parametrize("counts", CASES)
def test_values_equal_the_twin(counts: list[int]) -> None:
    samples, sigma, rgb, sky, _ = make(counts)
    fast = cpu.forward(samples, sigma, rgb, sky)
    slow = twin.render(samples, sigma.double(), rgb.double(), sky.double())
    for name in FIELDS:
        torch.testing.assert_close(getattr(fast, name), getattr(slow, name).float(), atol=2e-6, rtol=2e-5)


@pytest.mark.parametrize("counts", CASES)
def test_gradients_equal_autograd(counts: list[int]) -> None:
    samples, sigma, rgb, sky, _ = make(counts)
    fast = cpu.forward(samples, sigma, rgb, sky)
    random = torch.Generator().manual_seed(1)
    given_ = Gradients(*(torch.randn(x.shape, generator=random) for x in (fast.rgb, *[fast.depth_m] * 2, *[sigma] * 2)))
    found = cpu.backward(samples, sigma, rgb, sky, fast, given_)
    doubled = [x.double() for x in (sigma, rgb, sky)]
    slow = Rendered(*(getattr(fast, name).double() for name in FIELDS))
    wide = Gradients(
        *(x.double() for x in (given_.rgb, given_.depth_m, given_.transmittance, given_.weights, given_.tau))
    )
    expected = plain.backward(samples, *doubled, slow, wide)
    for ours, theirs in zip(found, expected, strict=True):
        torch.testing.assert_close(ours, theirs.float(), atol=2e-5, rtol=2e-4)


@pytest.mark.parametrize("counts", CASES)
@pytest.mark.parametrize("kind", ["kl", "sight", "distortion"])
def test_losses_equal_the_twin(counts: list[int], kind: str) -> None:
    samples, sigma, rgb, sky, rays = make(counts, seed=3)
    assert rays.depth_m is not None
    weights = cpu.forward(samples, sigma, rgb, sky).weights
    deviation_m = 0.05 * rays.depth_m + 0.1
    scale = torch.rand(len(rays), generator=torch.Generator().manual_seed(4))
    target = Target(rays.norms, rays.depth_m, deviation_m)
    wide_target = Target(*(x.double() for x in target))
    value, aims, wide_aims = {
        "kl": (sigma, (target,), (wide_target,)),
        "sight": (weights, (target,), (wide_target,)),
        "distortion": (weights, (), ()),
    }[kind]
    ours, theirs = torch.zeros_like(sigma), torch.zeros_like(sigma).double()
    fast = getattr(cpu, kind)(samples, value, *aims, scale, ours)
    slow = getattr(plain, kind)(samples, value.double(), *wide_aims, scale.double(), theirs)
    torch.testing.assert_close(fast, slow.float(), atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(ours, theirs.float(), atol=1e-5, rtol=1e-3)


@pytest.mark.parametrize("seed", range(6))
def test_interlevel_equals_the_twin(seed: int) -> None:
    counts = [12, 0, 5, 33, 7]
    samples, sigma, rgb, sky, _ = make(counts, seed)
    coarse, thin, _, _, _ = make([9, 4, 0, 20, 7], seed + 100)
    weights = cpu.forward(samples, sigma, rgb, sky).weights
    bound = cpu.forward(coarse, thin, torch.zeros(len(thin), 3), sky).weights
    scale = torch.rand(len(counts), generator=torch.Generator().manual_seed(4))
    fast, ours = cpu.interlevel(samples, weights, coarse, bound, scale)
    slow, theirs = plain.interlevel(samples, weights.double(), coarse, bound.double(), scale.double())
    assert float(slow.sum()) > 0
    torch.testing.assert_close(fast, slow.float(), atol=1e-6, rtol=1e-4)
    torch.testing.assert_close(ours, theirs.float(), atol=1e-6, rtol=1e-4)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, 40), min_size=1, max_size=20), st.integers(0, 1000))
def test_light_is_conserved(counts: list[int], seed: int) -> None:
    samples, sigma, rgb, sky, _ = make(counts, seed)
    made = cpu.forward(samples, sigma, rgb, sky)
    stopped = torch.zeros(len(counts)).index_add(0, samples.ray[: samples.used].long(), made.weights[: samples.used])
    torch.testing.assert_close(stopped + made.transmittance, torch.ones(len(counts)), atol=1e-5, rtol=0)
    assert (made.weights >= 0).all()
    assert (made.rgb >= -1e-6).all()
    assert (made.rgb <= 1 + 1e-5).all()


def test_a_wall_is_seen_where_it_stands() -> None:
    samples, _, rgb, sky, _ = make([40])
    sigma = torch.where(samples.t > 21, 1e4, 0.0)
    made = cpu.forward(samples, sigma, rgb, sky)
    first = samples.t[: samples.used][samples.t[: samples.used] > 21][0]
    torch.testing.assert_close(made.depth_m[0], first)
    torch.testing.assert_close(made.median_m[0], first)
    assert made.transmittance[0] < 1e-6


def test_empty_space_shows_the_sky() -> None:
    samples, sigma, rgb, sky, _ = make([12, 0])
    made = cpu.forward(samples, torch.zeros_like(sigma), rgb, sky)
    torch.testing.assert_close(made.rgb, sky)
    assert (made.depth_m == 0).all()


@pytest.mark.parametrize("value", [0.0, 1e-38, 1e-12, 65504.0, 1e30])
def test_extreme_densities_stay_finite(value: float) -> None:
    samples, sigma, rgb, sky, rays = make([20] * 8)
    sigma = torch.full_like(sigma, value)
    made = cpu.forward(samples, sigma, rgb, sky)
    for kind in ("mse", "l1", "kl", "urf"):
        found = losses(LossConfig(loss=kind), samples, rays, sigma, made)
        gradients = cpu.backward(samples, sigma, rgb, sky, made, found.gradients)
        assert math.isfinite(found.total)
        assert all(torch.isfinite(x).all() for x in gradients)


@pytest.mark.parametrize("kind", ["mse", "l1", "kl", "urf"])
def test_the_whole_loss_has_its_gradient(kind: str) -> None:
    """Central differences of the reduced total against the composed backward pass."""
    samples, sigma, rgb, sky, rays = make([12, 7, 20, 3], seed=5)
    config = LossConfig(loss=kind, depth_weight=0.7, distortion=0.3, opacity=0.2, by_confidence=True)

    def total(s: Tensor) -> float:
        return losses(config, samples, rays, s, cpu.forward(samples, s, rgb, sky)).total

    made = cpu.forward(samples, sigma, rgb, sky)
    found = losses(config, samples, rays, sigma, made)
    d_sigma = cpu.backward(samples, sigma, rgb, sky, made, found.gradients)[0]
    for k in (0, 5, 13, 20, 30, 41):
        step = 1e-2 * float(sigma[k])
        up, down = sigma.clone(), sigma.clone()
        up[k] += step
        down[k] -= step
        slope = (total(up) - total(down)) / (2 * step)
        assert slope == pytest.approx(float(d_sigma[k]), rel=2e-2, abs=2e-4)


def test_kl_is_least_where_the_prior_is() -> None:
    samples, sigma, _, _, rays = make([60], seed=2)
    target = Target(rays.norms, torch.tensor([float(samples.t[30])]), torch.full((1,), 0.05))
    found = []
    for at in (15, 30, 45):
        wall = torch.full_like(sigma, 1e-6)
        wall[at] = 50.0
        d_tau = torch.zeros_like(sigma)
        found.append(float(cpu.kl(samples, wall, target, torch.ones(1), d_tau)[0]))
    assert found[1] < min(found[0], found[2])


def test_sparse_and_dense_maps_pull_equally() -> None:
    """A prior on a tenth of the rays gives the loss of a prior on all of them, if the errors are the same."""
    samples, sigma, rgb, sky, rays = make([10] * 200)
    made = cpu.forward(samples, sigma, rgb, sky)
    dense = made.depth_m + 2
    sparse = torch.where(torch.arange(200) % 10 == 0, dense, 0.0)
    found = [
        losses(LossConfig(loss="l1"), samples, Rays(rays.origins_m, rays.directions, rays.rgb, depth), sigma, made)
        for depth in (dense, sparse, torch.zeros(200))
    ]
    assert found[0].terms["depth"] == pytest.approx(2 / 16, rel=1e-4)
    assert found[1].terms["depth"] == pytest.approx(2 / 16, rel=1e-4)
    assert found[2].terms["depth"] == 0


@pytest.mark.parametrize("kind", ["mse", "l1", "kl", "urf"])
def test_in_a_mean_over_all_rays_a_sparse_map_pulls_as_much_as_it_covers(kind: str) -> None:
    samples, sigma, rgb, sky, rays = make([10] * 200)
    made = cpu.forward(samples, sigma, rgb, sky)
    depth_m = torch.where(torch.arange(200) % 10 == 0, made.depth_m + 2, 0.0)
    given = Rays(rays.origins_m, rays.directions, rays.rgb, depth_m)
    usual = LossConfig(loss=kind, trim=0.0, distortion=0.0)  # type: ignore[arg-type]
    own = losses(usual, samples, given, sigma, made)
    overall = losses(replace(usual, depth_mean="all"), samples, given, sigma, made)
    assert float(overall.terms["depth"]) == pytest.approx(float(own.terms["depth"]) / 10, rel=1e-5)
    for name in ("depth_m", "tau", "weights"):
        gradient, tenth = (getattr(each.gradients, name) for each in (overall, own))
        torch.testing.assert_close(gradient, tenth / 10)
    even = losses(
        replace(usual, depth_mean="all"), samples, replace(given, share=torch.full((200,), 1 / 200)), sigma, made
    )
    assert float(even.terms["depth"]) == pytest.approx(float(overall.terms["depth"]), rel=1e-5)


def test_nan_and_infinite_priors_do_not_count() -> None:
    rays = make([5, 5, 5])[-1]
    spoilt = Rays(rays.origins_m, rays.directions, rays.rgb, torch.tensor([math.nan, math.inf, 7.0]))
    weight = prior_weight(LossConfig(), spoilt)
    assert weight is not None
    assert weight.tolist() == [0, 0, 1]


@given(st.floats(0, 1), st.integers(1, 50), st.integers(0, 99))
def test_trimming_drops_the_largest(share: float, count: int, seed: int) -> None:
    random = torch.Generator().manual_seed(seed)
    weight = (torch.rand(count, generator=random) > 0.3).float()
    loss = torch.rand(count, generator=random)
    kept = trimmed(weight, loss, share)
    dropped = (weight > 0) & (kept == 0)
    assert int(dropped.sum()) == int(share * int(weight.sum()))
    if dropped.any() and kept.any():
        assert loss[dropped].min() >= loss[kept > 0].max()


@pytest.mark.parametrize("power", [0.0, 1.0, 2.0])
def test_opacity_counts_by_the_priors_confidence(power: float) -> None:
    samples, sigma, rgb, sky, *_, rays = make([5, 5, 5])
    drawn = cpu.forward(samples, sigma, rgb, sky)
    given = Rays(rays.origins_m, rays.directions, rays.rgb, torch.full((3,), 7.0), torch.tensor([1.0, 0.1, 0.0]))
    rules = LossConfig(loss="none", opacity=1.0, opacity_power=power)
    found = losses(rules, samples, given, sigma, drawn)
    assert found.gradients.transmittance.tolist() == pytest.approx([1 / 2, 0.1**power / 2, 0])
    blind = losses(replace(rules, by_confidence=False), samples, given, sigma, drawn)
    assert blind.gradients.transmittance.tolist() == pytest.approx([1 / 3] * 3)


@given(st.floats(0.06, SUREST), st.floats(0.06, SUREST))
def test_a_value_counts_by_the_inverse_of_the_error_to_expect(one: float, other: float) -> None:
    """Against the spreads of priors/error_model.py; what is surer than SUREST counts as that."""
    chance = torch.tensor([one, other, 1.0])
    spread = torch.from_numpy(spread_of(np.full(3, 10, np.float32), np.array([one, other, SUREST], np.float32), WITHIN))
    for loss, power in (("l1", 1), ("mse", 2), ("urf", 2)):
        found = precision(loss, chance)
        torch.testing.assert_close(found, (spread[2] / spread) ** power, rtol=1e-3, atol=0)
    assert torch.equal(precision("kl", chance), chance)


@pytest.mark.parametrize(("kind", "power"), [("l1", 1), ("mse", 2)])
def test_depth_losses_weigh_by_confidence_or_by_what_it_says_of_precision(kind: str, power: int) -> None:
    samples, sigma, rgb, sky, rays = make([10] * 4)
    made = cpu.forward(samples, sigma, rgb, sky)
    chance = torch.tensor([0.9, 0.1, 0.0, 0.5])
    given = Rays(rays.origins_m, rays.directions, rays.rgb, made.depth_m + 2, chance)
    rules = LossConfig(loss=kind, trim=0.0, depth_weight=1.0, distortion=0.0)  # type: ignore[arg-type]
    rate = torch.log(1 - chance) ** power * (-1) ** power
    for config, counts in ((replace(rules, weigh="precision"), rate), (rules, chance)):
        pull = losses(config, samples, given, sigma, made).gradients.depth_m
        torch.testing.assert_close(pull / pull.sum(), counts / counts.sum(), rtol=1e-4, atol=1e-7)
