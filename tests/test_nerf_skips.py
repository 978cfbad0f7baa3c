"""Samples and rays that cannot matter: what is skipped changes nothing that is kept, and sums stay right on average."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from nerf import fields, roulette
from nerf.config import FitConfig, ModelConfig
from nerf.converged import MEMORY, Converged
from nerf.field import Field, FieldConfig
from nerf.kernels import cpu_kernels
from nerf.losses import SOFT, LossConfig, losses
from nerf.mlp import MLPConfig
from nerf.occupancy import Occupancy
from nerf.sample import SamplerConfig
from nerf.scene import Pixels
from nerf.types import GridConfig, Samples
from nerf.volumetric import VolumetricFamily
from nerf.walk import WAVE, in_front, walk
from tests.test_nerf_fit import corridor
from tests.test_nerf_occupancy import DENSE, scene, space
from tests.test_nerf_render import make

SMALL = FieldConfig(GridConfig(levels=4, log2_size=10, coarsest=4, finest=64), MLPConfig(width=16))
COUNTS = [40, 0, 3, 70, 16]


def lit(thick: float) -> tuple[Field, Samples, torch.Tensor]:
    """A field whose density is about `thick`, samples of five rays, and their directions."""
    samples, *_, rays = make(COUNTS, seed=4)
    samples.u.copy_(torch.rand(samples.u.shape, generator=torch.Generator().manual_seed(1)))
    field = Field(replace(SMALL, mlp=MLPConfig(width=16, initial_density=thick)), seed=2)
    for tensor in field.parameters().values():
        tensor.mul_(1.5)
    return field, samples, rays.units


@pytest.mark.parametrize("thick", [1e-6, 0.1, 2.0, 100.0])
@pytest.mark.parametrize("cones", [False, True])
def test_a_walk_sees_what_the_whole_rays_show(thick: float, cones: bool) -> None:
    field, samples, units = lit(thick)
    footprint = 0.01 + 0.001 * samples.t if cones else None
    sky, limit = torch.full((len(units), 3), 0.5), 1e-3
    whole = cpu_kernels().render.forward(samples, *field.forward(samples, units, footprint), sky)
    found = walk(field, samples, units, footprint, limit)
    seen = cpu_kernels().render.forward(samples, *found, sky)
    assert (seen.rgb - whole.rgb).abs().max() <= limit
    assert (seen.transmittance - whole.transmittance).abs().max() <= limit
    torch.testing.assert_close(seen.median_m, whole.median_m)
    lights = whole.transmittance > limit  # such a ray is walked to its end
    assert torch.equal(seen.rgb[lights], whole.rgb[lights])


def test_nothing_behind_a_wall_is_asked() -> None:
    field, samples, units = lit(1e4)
    sigma, rgb = walk(field, samples, units, None, 1e-3)
    place = torch.arange(samples.used) - samples.offsets[samples.ray[: samples.used].long()]
    assert (sigma[: samples.used][place < WAVE] > 0).all()
    assert (sigma[: samples.used][place >= WAVE] == 0).all() and (rgb[: samples.used][place >= WAVE] == 0).all()


def test_the_depth_in_front_is_summed_along_each_ray() -> None:
    samples, sigma, *_ = make(COUNTS, seed=3)
    found = in_front(samples, sigma)
    for first, last in zip(samples.offsets[:-1].tolist(), samples.offsets[1:].tolist(), strict=True):
        total = 0.0
        for k in range(first, last):
            assert float(found[k]) == pytest.approx(total, rel=1e-6, abs=1e-6)
            total += float(sigma[k]) * float(samples.dt_m[k])


def test_gradients_are_those_of_what_is_kept() -> None:
    field, samples, units = lit(0.1)
    g = torch.Generator().manual_seed(0)
    d_sigma, d_rgb = torch.randn(len(samples.t), generator=g), torch.randn(len(samples.t), 3, generator=g)
    kept = torch.nonzero(torch.rand(samples.used, generator=g) < 0.3).view(-1)
    rest = torch.ones(len(samples.t), dtype=torch.bool)
    rest[kept] = False
    for thrown in (kept, kept[:0]):
        field.forward(samples, units)
        field.backward(d_sigma, d_rgb, thrown)
        ours = {name: tensor.grad.clone() for name, tensor in field.parameters().items()}  # type: ignore[union-attr]
        field.forward(samples, units)
        zeros = rest if len(thrown) else torch.ones_like(rest)
        field.backward(d_sigma.masked_fill(zeros, 0), d_rgb.masked_fill(zeros[:, None], 0))
        for name, tensor in field.parameters().items():
            torch.testing.assert_close(ours[name], tensor.grad, rtol=2e-3, atol=1e-5)


@settings(deadline=None)
@given(st.lists(st.floats(0, 1e3, width=32), min_size=1, max_size=50), st.floats(0.01, 1))
@example([171.38760375976562] * 3, 0.5)  # their mean is rounded up
def test_chances_are_chances_and_something_is_always_kept(weights: list[float], least: float) -> None:
    chance = roulette.chances(torch.tensor(weights), least)
    assert (chance >= np.float32(least)).all() and (chance <= 1).all()
    assert chance.max() == 1
    assert len(roulette.spin(chance, (3, 4), roulette.SAMPLES)) >= 1


def test_sums_are_right_on_average() -> None:
    weight = torch.rand(200, generator=torch.Generator().manual_seed(0)) ** 4
    chance = roulette.chances(weight, 0.1)
    sums = []
    for step in range(400):
        kept = roulette.spin(chance, (0, step), roulette.SAMPLES)
        sums.append(float((weight[kept] / chance[kept]).sum()))
    assert len(kept) < 150
    error = np.std(sums) / np.sqrt(len(sums))
    assert abs(np.mean(sums) - float(weight.sum())) < 4 * error
    assert torch.equal(kept, roulette.spin(chance, (0, 399), roulette.SAMPLES))


def test_a_wheel_keeps_what_has_a_gradient_and_sums_on_average() -> None:
    values = torch.randn(300, generator=torch.Generator().manual_seed(0)) ** 5
    values[::3] = 0
    sums = []
    for step in range(400):
        grown, kept = roulette.Wheel(0.1, (0, step), roulette.PROPOSED).thinned(values, values.abs())
        assert kept is not None and len(kept) < 120 and (values[kept] != 0).all()
        sums.append(float(grown[kept].sum()))
    assert abs(np.mean(sums) - float(values.sum())) < 4 * np.std(sums) / np.sqrt(len(sums))
    same, none = roulette.Wheel(1.0, (0, 0), roulette.PROPOSED).thinned(values, values.abs())
    assert none is None and same is values, "off: nothing is changed"
    _, kept = roulette.Wheel(0.1, (0, 0), roulette.PROPOSED).thinned(values, torch.zeros(300))
    assert kept is not None and not len(kept), "a batch without a gradient"


def test_proposals_learn_on_average_what_they_learn_of_all_samples() -> None:
    drive = corridor()
    family = VolumetricFamily("ball", proposals=(24,), anti_aliased=True)
    config = FitConfig(ModelConfig(log2_size=10, width=16), steps=30, seconds=None, rays=256)
    model = family.start(drive, config, "cpu")
    for step in range(12):
        model.train(drive, config, step, step / 30)
    rays = drive.draw(256, 0, 99)
    samples, rounds = model.proposals.sample(rays, config.model.sampler, (0, 99), 0.5)
    rendered = model._renderer.forward(
        samples, *model.field.forward(samples, rays.units), model.sky.forward(rays.units)
    )

    def gradient(least: float, step: int) -> torch.Tensor:
        wheel = roulette.Wheel(least, (0, step), roulette.PROPOSED)
        model.proposals.backward(rounds, samples, rendered, None, wheel)
        grad = model.proposals.fields[0].mlp.layers.density1.grad
        assert grad is not None
        return grad.clone()

    whole, thinned = gradient(1.0, 0), torch.stack([gradient(0.1, step) for step in range(60)])
    assert whole.abs().max() > 0
    error = thinned.std(0) / 60**0.5 + 0.01 * whole.abs().max()
    assert ((thinned.mean(0) - whole).abs() < 5 * error).float().mean() > 0.98
    assert not torch.equal(thinned[0], whole)


@pytest.mark.parametrize(("proposed", "shown", "most"), [(32, 16, 16), (32, None, 32), (None, None, 8), (None, 12, 12)])
def test_rendered_rays_have_samples_of_their_own(proposed: int | None, shown: int | None, most: int) -> None:
    drive = corridor()
    family = VolumetricFamily("ball", proposals=(24,), anti_aliased=True)
    sampler = SamplerConfig(count=8, proposed=proposed, render_proposed=shown, carve=False)
    config = FitConfig(ModelConfig(log2_size=10, width=16, sampler=sampler))
    model = family.start(drive, config, "cpu")
    rays = replace(drive.draw(64, 0, 0), rgb=None, depth_m=None, weight=None)
    samples, _ = model.proposals.sample(rays, sampler, None, 1.0)
    assert int(samples.offsets.diff().max()) == most
    trained, _ = model.proposals.sample(rays, sampler, (0, 0), 1.0)
    assert int(trained.offsets.diff().max()) == (proposed or 8)


def pixels(count: int, seed: int) -> Pixels:
    random = np.random.default_rng(seed)
    return Pixels(*(random.integers(0, n, count) for n in (3, 16, 24)))


def test_learned_tiles_are_drawn_less_often_and_count_for_more() -> None:
    known = Converged((3, 2, 3), 8)
    drawn = pixels(600, 0)
    kept, share = known.spin(drawn, 0.2, (0, 0))
    assert len(kept.row) == 600, "nothing is known: all are drawn"
    torch.testing.assert_close(share, torch.full((600,), 1 / 600))
    easy = torch.from_numpy(drawn.column < 8)
    known.learn(drawn, torch.where(easy, 1e-6, 0.04))
    totals, part = [], []
    for step in range(200):
        kept, share = known.spin(drawn, 0.2, (0, step))
        part.append((kept.column < 8).mean())
        totals.append(float(share.sum()))
    assert np.mean(part) < 0.5 * float(easy.float().mean())
    assert np.mean(totals) == pytest.approx(1, abs=4 * np.std(totals) / np.sqrt(200))


def test_a_tile_keeps_a_running_mean() -> None:
    known = Converged((1, 1, 2), 4)
    same = Pixels(np.zeros(3, int), np.array([0, 3, 1]), np.array([0, 3, 5]))
    known.learn(same, torch.tensor([1.0, 3.0, 7.0]))
    assert known.loss.tolist() == [[[2.0, 7.0]]]
    known.learn(Pixels(*(x[:1] for x in same)), torch.tensor([10.0]))
    assert known.loss[0, 0].tolist() == pytest.approx([MEMORY * 2 + (1 - MEMORY) * 10, 7.0])
    again = Converged((1, 1, 2), 4)
    again.load(known.state())
    assert torch.equal(again.loss, known.loss)
    assert Converged.of(corridor()).loss.shape == (20, 3, 8)


@pytest.mark.parametrize("kind", ["l1", "kl", "urf"])
def test_even_shares_are_the_plain_mean(kind: str) -> None:
    samples, sigma, rgb, sky, rays = make([12, 7, 20, 3], seed=5)
    made = cpu_kernels().render.forward(samples, sigma, rgb, sky)
    rays = replace(rays, sky=torch.tensor([0.0, 1.0, 0.0, 1.0]))
    plain = losses(LossConfig(loss=kind), samples, rays, sigma, made)  # type: ignore[arg-type]
    shared = losses(LossConfig(loss=kind), samples, replace(rays, share=torch.full((4,), 0.25)), sigma, made)  # type: ignore[arg-type]
    torch.testing.assert_close(plain.total, shared.total)
    for name in ("rgb", "depth_m", "transmittance", "weights", "tau"):
        torch.testing.assert_close(getattr(plain.gradients, name), getattr(shared.gradients, name))


def test_the_sky_asks_for_clear_rays() -> None:
    samples, sigma, rgb, sky, rays = make([12, 7, 20, 3], seed=5)
    made = cpu_kernels().render.forward(samples, sigma, rgb, sky)
    given_ = replace(rays, depth_m=None, weight=None, sky=torch.tensor([0.0, 1.0, 0.0, 0.0]))
    rule = LossConfig(loss="none", opacity=0, distortion=0, sky_opacity=0.3)
    found = losses(rule, samples, given_, sigma, made)
    passed = made.transmittance[1] + SOFT
    torch.testing.assert_close(found.terms["sky"], -torch.log(passed))
    wanted = torch.zeros(4)
    wanted[1] = -0.3 / passed
    torch.testing.assert_close(found.gradients.transmittance, wanted)
    off = losses(replace(rule, sky_opacity=0.0), samples, given_, sigma, made)
    assert "sky" not in off.terms and (off.gradients.transmittance == 0).all()


def test_rays_into_the_sky_empty_what_they_pass() -> None:
    drive = scene(DENSE)
    blind = DENSE.copy()
    blind[:, :6] = 0  # the prior has no value in the upper rows
    shown = np.zeros(DENSE.shape, np.uint8)
    shown[:, :6] = 1
    without = Occupancy.carve(space("ball"), replace(drive, depth_m=blind), 48)
    with_sky = Occupancy.carve(space("ball"), replace(drive, depth_m=blind, sky=shown), 48)
    assert (with_sky.kept <= without.kept).all()
    assert with_sky.share < 0.8 * without.share
    carved = Occupancy.carve(space("ball"), replace(drive, sky=np.zeros_like(shown)), 48)
    assert torch.equal(carved.kept, Occupancy.carve(space("ball"), drive, 48).kept)


@pytest.mark.parametrize(
    ("step", "progress", "learns"), [(1, 0.1, True), (2, 0.1, True), (40, 0.5, False), (43, 0.5, True)]
)
def test_proposals_learn_at_some_steps_once_they_follow_the_field(step: int, progress: float, learns: bool) -> None:
    around = corridor("4")
    model = ModelConfig("mip360", log2_size=12, finest=128, width=16, sampler=SamplerConfig(proposals_every=4))
    fit = FitConfig(model, rays=64, steps=100, seconds=None)
    field = fields.family("mip360").start(around, fit, "cpu")
    field.train(around, fit, 0, 0.0)
    before = {name: tensor.clone() for name, tensor in field.state().items()}
    terms = field.train(around, fit, step, progress).terms
    changed = {name for name, tensor in field.state().items() if not torch.equal(tensor, before[name])}
    assert ("interlevel" in terms) == learns
    assert ("model.proposal0.grid" in changed) == ("optimiser.proposal0.grid.mean" in changed) == learns
    assert "model.field.grid" in changed
