"""Samplers: the compiled ones equal the plain twin bit for bit, and what any sampler's result must look like."""

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from nerf import sample
from nerf.kernels import Kernels, cpu_kernels, plain_kernels
from nerf.occupancy import Occupancy
from nerf.proposals import Proposals
from nerf.sample import Sampler, SamplerConfig
from nerf.space import Kind, Space
from nerf.twin import sample as twin
from nerf.types import SAMPLE_BLOCK, Histogram, Rays, Samples

KINDS: list[Kind] = ["box", "ball", "spheres", "cube"]
SPACE = Space("ball", (0.0, 0.0, 20.0), (12.0, 5.0, 25.0), 0.5, 200.0)


def rays(count: int, seed: int = 0, depth: bool = True) -> Rays:
    rng = np.random.default_rng(seed)
    direction = np.concatenate([rng.uniform(-1, 1, (count, 2)), np.ones((count, 1))], axis=1)
    depth_m = np.where(rng.random(count) < 0.7, rng.uniform(1, 90, count), 0)
    tensor = [torch.from_numpy(x.astype(np.float32)) for x in (rng.normal(size=(count, 3)) * 3, direction, depth_m)]
    return Rays(tensor[0], tensor[1], None, tensor[2] if depth else None)


def grid(space: Space, share: float = 0.4, resolution: int = 32) -> Occupancy:
    made = Occupancy(space, resolution)
    made.kept.copy_(torch.rand(made.kept.shape, generator=torch.Generator().manual_seed(1)) < share)
    return made


def assert_equal(one: Samples, other: Samples) -> None:
    assert one.used == other.used
    for name in ("offsets", "ray", "t", "dt_m", "s0", "s1", "u", "table"):
        a, b = getattr(one, name), getattr(other, name)
        assert a.dtype == b.dtype and a.shape == b.shape, name
        assert torch.equal(a, b), (name, (a - b).abs().max())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("how", ["march", "uniform", "guided", "resample"])
@pytest.mark.parametrize("key", [None, (3, 7)])
def test_compiled_equals_plain_to_the_bit(kind: Kind, how: str, key) -> None:
    space = dataclasses.replace(SPACE, kind=kind)
    batch, occupancy = rays(300), grid(space)

    def run(kernels: Kernels) -> Samples:
        sampler = Sampler(space, None if how == "uniform" else occupancy, kernels.sample)
        if how in ("march", "uniform"):
            return sampler.march(batch, 48, key)
        if how == "guided":
            return sampler.guided(batch, SamplerConfig(count=24, free=40, unguided=0.2), key)
        first = sampler.march(batch, 16, key)
        weights = torch.rand(len(first.t), generator=torch.Generator().manual_seed(2))
        return sampler.resample(batch, Histogram(first, weights, margin=0.01), 8, key)

    compiled = run(cpu_kernels())
    assert compiled.used > 500
    assert_equal(compiled, run(plain_kernels()))


@settings(max_examples=40, deadline=None)
@given(
    kind=st.sampled_from(KINDS),
    count=st.integers(1, 80),
    seed=st.integers(0, 10),
    jitter=st.booleans(),
    kept=st.sampled_from([None, 0.0, 0.3, 1.0]),
    guide=st.booleans(),
)
def test_samples_are_well_formed(kind: Kind, count: int, seed: int, jitter: bool, kept: float | None, guide) -> None:
    space = dataclasses.replace(SPACE, kind=kind)
    batch = rays(30, seed)
    occupancy = None if kept is None else grid(space, kept, 16)
    key = (seed, count) if jitter else None
    sampler = Sampler(space, occupancy)
    config = SamplerConfig(count=count + 1, free=count)
    found = sampler.guided(batch, config, key) if guide else sampler.march(batch, count, key)
    used = found.used
    assert found.offsets[0] == 0 and found.offsets[-1] == used and (found.offsets.diff() >= 0).all()
    assert len(found.t) % SAMPLE_BLOCK == 0 and len(found.t) >= max(used, 1)
    expected = torch.repeat_interleave(torch.arange(30, dtype=torch.int32), found.offsets.diff())
    assert torch.equal(found.ray[:used], expected)
    assert (found.ray[used:] == -1).all() and (found.dt_m[used:] == 0).all() and (found.u[used:] == 0).all()
    assert (found.dt_m[:used] > 0).all() and (found.s1 >= found.s0).all()
    assert found.u.min() >= 0 and found.u.max() <= 1
    if not used:
        return
    norms = batch.norms[found.ray[:used].long()]
    half = found.dt_m[:used] / norms / 2
    assert (found.t[:used] - half >= space.near_m * (1 - 1e-4)).all()
    assert (found.t[:used] + half <= space.far_m * (1 + 1e-4)).all()
    same = expected[1:] == expected[:-1]
    assert (found.t[:used].diff()[same] > 0).all()  # near to far
    assert (found.s0[1:used] >= found.s1[: used - 1] - 1e-5)[same].all()  # no overlap
    along = found.t[:used, None] * batch.directions[expected.long()]
    where, table = space.warp(batch.origins_m[expected.long()] + along)
    np.testing.assert_allclose(found.u[:used], where, atol=1e-5)
    assert (found.table[:used] == table).float().mean() > 0.99


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("key", [None, (1, 2)])
def test_lengths_without_a_grid_sum_to_the_way_through_the_space(kind: Kind, key) -> None:
    space, batch = dataclasses.replace(SPACE, kind=kind), rays(200)
    found = Sampler(space).march(batch, 40, key)
    aim = space.aim(batch)
    sums = torch.zeros(200).index_add_(0, found.ray[: found.used].long(), found.dt_m[: found.used])
    way = torch.clamp(aim.last_m - aim.first_m, min=0) * batch.norms
    torch.testing.assert_close(sums, way, rtol=1e-3, atol=1e-3)


def test_only_occupied_cells_and_all_of_them() -> None:
    batch, occupancy = rays(100), grid(SPACE)
    every, some = Sampler(SPACE).march(batch, 64), Sampler(SPACE, occupancy).march(batch, 64)
    points = batch.origins_m[every.ray.long()] + every.t[:, None] * batch.directions[every.ray.long()]
    held = occupancy.holds(points[: every.used])
    assert abs(int(held.sum()) - some.used) <= 2  # `holds` rounds elsewhere
    assert 0.2 < some.used / every.used < 0.6


def test_guided_rays_have_their_band_the_front_and_nothing_behind() -> None:
    batch = rays(500)
    found = Sampler(SPACE).guided(batch, SamplerConfig(count=32, free=64, reach=0.12, unguided=0.0), (0, 0))
    counts = found.offsets.diff()
    led = batch.depth_m > 0
    assert (counts[~led] >= 64).all() and (counts[~led] <= 65).all()
    assert (counts[led] <= 34).all()
    ray = found.ray[: found.used].long()
    relative = found.t[: found.used] / batch.depth_m[ray]
    of_led = led[ray]
    assert (relative[of_led] < 1.12 + 1e-4).all()
    band = of_led & (relative > 0.88)
    per_ray = torch.bincount(ray[band], minlength=500)[led]
    assert (per_ray >= 15).all() and (per_ray <= 19).all()
    front = torch.bincount(ray[of_led & (relative < 0.88)], minlength=500)[led]
    assert front.float().mean() > 14
    # The band is even in depth and centred on the prior.
    first = int(torch.nonzero(led)[0])
    own = found.t[found.offsets[first] : found.offsets[first + 1]]
    own = own[own > 0.885 * batch.depth_m[first]]
    torch.testing.assert_close(own.diff()[1:-1], own.diff()[1:-1].mean().expand(len(own) - 3), rtol=1e-3, atol=0)


def test_a_share_of_the_guided_rays_stays_unguided() -> None:
    batch = dataclasses.replace(rays(4000), depth_m=torch.full((4000,), 10.0))
    found = Sampler(SPACE).guided(batch, SamplerConfig(count=16, free=64, unguided=0.1), (5, 1))
    assert 0.07 < (found.offsets.diff() > 30).float().mean() < 0.13


@pytest.mark.parametrize(
    ("config", "shares"),
    [
        (SamplerConfig(unguided=0.1, unguided_later=0.5), [0.1, 0.3, 0.5, 0.5]),
        (SamplerConfig(unguided=0.7, unguided_later=0.5), [0.7] * 4),
        (SamplerConfig(unguided=0.03, unguided_later=0.0), [0.03] * 4),  # earlier versions
    ],
)
def test_more_and_more_rays_are_freed_until_the_middle_of_a_fit(config: SamplerConfig, shares: list[float]) -> None:
    assert [config.at(progress).unguided for progress in (0.0, 0.25, 0.5, 1.0)] == pytest.approx(shares)
    assert dataclasses.replace(config.at(0.3), unguided=config.unguided) == config, "nothing else changes"


def test_without_a_prior_guided_is_march() -> None:
    batch = rays(50, depth=False)
    one = Sampler(SPACE, grid(SPACE)).guided(batch, SamplerConfig(free=64), (1, 1))
    assert_equal(one, Sampler(SPACE, grid(SPACE)).march(batch, 64, (1, 1)))


@pytest.mark.parametrize("depth_m", [1e-3, 0.5, 200.0, 1e4, 3e38])
def test_depths_at_and_beyond_the_ends_are_sampled_within(depth_m: float) -> None:
    batch = dataclasses.replace(rays(20), depth_m=torch.full((20,), depth_m))
    found = Sampler(SPACE).guided(batch, SamplerConfig(unguided=0.0), (1, 1))
    assert found.used > 0 and torch.isfinite(found.t).all()
    assert found.t[: found.used].min() >= 0.5 and found.t.max() <= 200


def test_the_key_decides_and_every_step_differs() -> None:
    batch, occupancy = rays(100), grid(SPACE)
    sampler, config = Sampler(SPACE, occupancy), SamplerConfig()
    same = [sampler.guided(batch, config, (3, 4)) for _ in range(2)]
    assert_equal(*same)
    for key in ((3, 5), (4, 4)):
        assert not torch.equal(sampler.guided(batch, config, key).t[:50], same[0].t[:50])
    still = [sampler.march(batch, 64) for _ in range(2)]
    assert_equal(*still)


def test_shifts_cover_the_interval_evenly() -> None:
    shifts = torch.stack([sample._random(1000, (0, step), 1, torch.zeros(1)) for step in range(5)])
    assert shifts.min() >= 0 and shifts.max() < 1
    assert torch.histc(shifts, 10, 0, 1).sub(500).abs().max() < 100


def test_nothing_to_sample() -> None:
    none = rays(0)
    sampler = Sampler(SPACE)
    assert sampler.march(none, 64).used == 0 and len(sampler.march(none, 64).t) == SAMPLE_BLOCK
    assert sampler.guided(none, SamplerConfig()).offsets.tolist() == [0]
    empty = grid(SPACE, 0.0)
    found = Sampler(SPACE, empty).march(rays(10), 64)
    assert found.used == 0 and found.offsets.tolist() == [0] * 11 and (found.ray == -1).all()
    again = sampler.resample(rays(10), Histogram(found, torch.zeros(len(found.t))), 8)
    assert again.used == 0


def test_no_candidates_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        Sampler(SPACE).march(rays(3), 0)


def packed(offsets: list[int], s0: torch.Tensor, s1: torch.Tensor) -> Samples:
    """Samples of which only their intervals in s count."""
    none = torch.zeros_like(s0)
    ray = torch.repeat_interleave(torch.tensor(offsets).diff()).to(torch.int32)
    return Samples(torch.tensor(offsets), ray, none, none, s0, s1, none, ray, len(s0))


def histogram(seed: int, gaps: bool) -> Histogram:
    """Three rays' bins, packed: 5, 0 and 9 of them."""
    rng = np.random.default_rng(seed)
    bins = []
    for count in (5, 0, 9):
        edges = np.sort(rng.random(2 * count if gaps else count + 1))
        bins.append((edges[::2], edges[1::2]) if gaps else (edges[:-1], edges[1:]))
    s0, s1 = (torch.from_numpy(np.concatenate([b[i] for b in bins]).astype(np.float32)) for i in (0, 1))
    weights = torch.from_numpy(rng.random(14).astype(np.float32) ** 4)
    return Histogram(packed([0, 5, 5, 14], s0, s1), weights)


KERNELS = {"plain": plain_kernels, "compiled": cpu_kernels}


@pytest.mark.parametrize("kind", KERNELS)
def test_resampling_inverts_the_cumulated_mass(kind: str) -> None:
    bins = histogram(0, gaps=False)
    targets = torch.linspace(0.02, 0.98, 13).expand(3, 13).contiguous()
    begin, end = KERNELS[kind]().sample.resample(bins, targets)
    for ray in (0, 2):
        own = slice(int(bins.samples.offsets[ray]), int(bins.samples.offsets[ray + 1]))
        mass = bins.weights[own].double().numpy()
        cumulated = np.concatenate([[0], np.cumsum(mass / mass.sum())])
        edges = np.append(bins.samples.s0[own].numpy(), bins.samples.s1[own][-1].item())
        expected = np.interp(targets[ray].double(), cumulated, edges)
        np.testing.assert_allclose(begin[ray], expected[:-1], atol=1e-6)
        np.testing.assert_allclose(end[ray], expected[1:], atol=1e-6)
    assert (begin[1] == 0).all() and (end[1] == 0).all()


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 1000),
    gaps=st.booleans(),
    margin=st.sampled_from([0.0, 0.003, 0.05]),
    anneal=st.sampled_from([1.0, 0.3, 0.0]),
    zeros=st.sampled_from([0.0, 0.5, 1.0]),
)
def test_compiled_resampling_equals_plain(seed: int, gaps: bool, margin: float, anneal: float, zeros: float) -> None:
    bins = histogram(seed, gaps)
    weights = bins.weights * (torch.rand(14, generator=torch.Generator().manual_seed(seed)) >= zeros)
    targets = torch.rand(3, 9, generator=torch.Generator().manual_seed(seed)).sort(dim=1)[0]
    bins = bins._replace(weights=weights, margin=margin, anneal=anneal)
    one, other = (KERNELS[kind]().sample.resample(bins, targets) for kind in ("compiled", "plain"))
    torch.testing.assert_close(one, other, atol=1e-6, rtol=0)
    assert (one[1] >= one[0]).all() and one.min() >= 0 and one.max() <= 1


@given(seed=st.integers(0, 300))
@settings(max_examples=30, deadline=None)
def test_resampled_intervals_stay_within_connected_bins(seed: int) -> None:
    bins = histogram(seed, gaps=True)
    targets = ((torch.arange(17) + 0.5) / 17).expand(3, 17).contiguous()
    begin, end = cpu_kernels().sample.resample(bins, targets)
    offsets, s0, s1 = bins.samples.offsets, bins.samples.s0, bins.samples.s1
    for ray in (0, 2):
        own = slice(int(offsets[ray]), int(offsets[ray + 1]))
        for a, b in zip(begin[ray], end[ray], strict=True):
            assert ((a >= s0[own] - 1e-7) & (b <= s1[own] + 1e-7)).any()


def test_widening_fills_between_bins_with_the_larger_density() -> None:
    bins = packed([0, 2], torch.tensor([0.2, 0.5]), torch.tensor([0.3, 0.7]))
    weights = torch.tensor([0.1, 0.6])  # densities 1 and 3
    edges, mass, gap = twin._widened(Histogram(bins, weights, margin=0.15))
    torch.testing.assert_close(edges[0], torch.tensor([0.05, 0.35, 0.45, 0.85]).double(), atol=1e-6, rtol=0)
    torch.testing.assert_close(mass[0] / edges[0].diff(), torch.tensor([1.0, 3.0, 3.0]).double(), atol=1e-5, rtol=0)
    assert not gap.any()


@pytest.mark.parametrize("key", [None, (0, 1)])
def test_rays_are_resampled_as_often_as_each_is_asked(key) -> None:
    batch, sampler = rays(60), Sampler(SPACE, grid(SPACE))
    first = sampler.march(batch, 24, key)
    bins = Histogram(first, torch.rand(len(first.t), generator=torch.Generator().manual_seed(3)), 0.01)
    few, many = (sampler.resample(batch, bins, count, key) for count in (5, 12))
    each = torch.where(torch.arange(60) % 3 == 0, 5, 12)
    mixed = sampler.resample(batch, bins, 12, key, each)
    for ray in range(60):
        whole = few if each[ray] == 5 else many
        for name in ("t", "dt_m", "s0", "s1", "u"):
            mine, own = (getattr(x, name)[x.offsets[ray] : x.offsets[ray + 1]] for x in (mixed, whole))
            assert torch.equal(mine, own)


def test_the_prior_spares_samples_of_the_rays_that_it_guides() -> None:
    batch = dataclasses.replace(rays(200), depth_m=torch.where(torch.arange(200) < 120, 12.0, 0.0))
    proposals = Proposals((48,), Sampler(SPACE), torch.device("cpu"), 0, False)

    def counts(key, **settings) -> torch.Tensor:
        config = SamplerConfig(count=10, unguided=0.0, **settings)
        return proposals.sample(batch, config, key, 1.0)[0].offsets.diff()

    assert counts((0, 1), proposed=30)[:120].max() == 10 and counts((0, 1), proposed=30)[120:].max() == 30
    assert counts((0, 1), proposed=30, guide=False).max() == 30
    assert counts(None, proposed=30, render_proposed=12).max() == 12  # a rendered view knows no prior
    assert counts((0, 1), proposed=None).max() == counts(None, proposed=None, render_proposed=None).max() == 10


def test_resampling_goes_where_the_weight_is() -> None:
    batch = rays(50)
    first = Sampler(SPACE).march(batch, 64)
    surface = 12.0
    weights = torch.exp(-(((first.t - surface) / 1.0) ** 2)) * (first.ray >= 0)
    found = Sampler(SPACE).resample(batch, Histogram(first, weights), 32, (0, 1))
    assert (found.offsets.diff() == 32).all()
    t = found.t[: found.used]
    assert ((t > 8) & (t < 16)).float().mean() > 0.95
    assert_equal(found, Sampler(SPACE).resample(batch, Histogram(first, weights), 32, (0, 1)))
