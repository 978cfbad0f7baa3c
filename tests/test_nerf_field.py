"""The whole field: gradients of every parameter, padding, saving; the sky; the optimiser and its resumption."""

import copy

import pytest
import torch

from nerf.field import Field, FieldConfig
from nerf.harmonics import harmonics
from nerf.kernels import cpu_kernels
from nerf.kernels.cpu import field as cpu
from nerf.kernels.plain import field as plain
from nerf.mlp import MLPConfig
from nerf.optimise import Optimiser, OptimiserConfig
from nerf.sky import Sky, SkyConfig
from nerf.state import copy_into
from nerf.twin import encode as twin_encode
from nerf.twin import field as twin_field
from nerf.twin import sky as slow_sky
from nerf.twin.sky import corners
from nerf.types import GridConfig, Layers, Samples

SMALL = FieldConfig(GridConfig(levels=6, log2_size=12, coarsest=4, finest=128, tables=2), MLPConfig(width=32))


@pytest.fixture(autouse=True)
def seeded():
    torch.manual_seed(0)


def made(count, rays=5, seed=0):
    """Return samples (with padding in the last tenth), unit directions and gradients."""
    g = torch.Generator().manual_seed(seed)
    used = count - count // 10
    ray = torch.sort(torch.randint(rays, (count,), generator=g, dtype=torch.int32)).values
    ray[used:] = -1
    flat = torch.rand(count, generator=g)
    u, table = torch.rand(count, 3, generator=g), torch.randint(2, (count,), generator=g, dtype=torch.int32)
    offsets = torch.searchsorted(ray[:used].contiguous(), torch.arange(rays + 1, dtype=torch.int32))
    samples = Samples(offsets, ray, flat, flat, flat, flat, u, table, used)
    units = torch.nn.functional.normalize(torch.randn(rays, 3, generator=g), dim=-1)
    d_sigma, d_rgb = torch.randn(count, generator=g), torch.randn(count, 3, generator=g)
    d_sigma[used:], d_rgb[used:] = 0, 0
    return samples, units, d_sigma, d_rgb


def trained(config=SMALL, seed=0):
    """Return a field whose weights are not tiny."""
    field = Field(config, seed=seed)
    g = torch.Generator().manual_seed(seed)
    field.grid.weights.copy_(torch.randn(field.grid.weights.shape, generator=g))
    return field


def rounded(x):
    """Round to bfloat16 and back, gradients as they are."""
    return x + (x.bfloat16().double() - x).detach()


@pytest.mark.parametrize("count", [64, 2048])
@pytest.mark.parametrize("footprint", [None, 0.01])
def test_all_gradients_equal_the_twins(count, footprint):
    field = trained()
    samples, units, d_sigma, d_rgb = made(count)
    footprint = None if footprint is None else torch.full((count,), footprint)
    sigma, rgb = field.forward(samples, units, footprint)
    field.backward(d_sigma, d_rgb)

    leaves = {name: tensor.double().requires_grad_() for name, tensor in field.parameters().items()}
    stored = rounded(leaves["grid"])
    features = twin_encode.encode(samples.u, samples.table, footprint, stored, SMALL.grid)
    layers = Layers(*(tensor for name, tensor in leaves.items() if name != "grid"))
    basis = harmonics(units).double()
    outputs = twin_field.shade(features, basis, samples.ray, layers, SMALL.mlp.initial_density, half=True)
    torch.autograd.backward(outputs, (d_sigma.double(), d_rgb.double()))

    def far(found, wanted):
        return float((found.double() - wanted).norm() / wanted.norm())

    for found, wanted in ((sigma, outputs[0].detach()), (rgb, outputs[1].detach())):
        assert far(found[: samples.used], wanted[: samples.used]) < 2e-3
    for name, tensor in field.parameters().items():
        assert tensor.grad is not None and far(tensor.grad, leaves[name].grad) < 1e-2, name


@pytest.mark.parametrize("count", [1, 15, 100, 2047])
def test_any_number_of_samples(count):
    field = trained()
    samples, units, d_sigma, d_rgb = made(count)
    sigma, rgb = field.forward(samples, units)
    assert sigma.shape == (count,) and rgb.shape == (count, 3)
    field.backward(d_sigma, d_rgb)
    gradients = [tensor.grad.clone() for tensor in field.parameters().values()]

    def filled(x):
        return torch.cat([x, x.new_zeros(2048 - count, *x.shape[1:])])

    longer = copy.copy(samples)
    longer = Samples(
        samples.offsets,
        filled(samples.ray),
        *(filled(x) for x in (samples.t, samples.dt_m, samples.s0, samples.s1, samples.u, samples.table)),
        samples.used,
    )
    again = field.forward(longer, units)
    torch.testing.assert_close(again[0][:count], sigma, rtol=1e-6, atol=0)
    torch.testing.assert_close(again[1][:count], rgb, rtol=1e-6, atol=1e-7)
    blocks = -(-count // cpu.SAMPLES_MULTIPLE) * cpu.SAMPLES_MULTIPLE
    assert not again[0][blocks:].any() and not again[1][blocks:].any()  # nobody was asked
    field.backward(filled(d_sigma), filled(d_rgb))
    for gradient, tensor in zip(gradients, field.parameters().values(), strict=True):
        torch.testing.assert_close(tensor.grad, gradient, rtol=1e-4, atol=1e-6)


def test_density_alone_trains_and_equals_forward():
    field = trained()
    samples, units, d_sigma, d_rgb = made(300)
    sigma, _ = field.forward(samples, units)
    assert torch.equal(field.density_forward(samples), sigma)
    field.density_backward(d_sigma)
    found = field.grid.weights.grad.clone()
    field.forward(samples, units)
    field.backward(d_sigma, torch.zeros_like(d_rgb))
    assert torch.equal(field.grid.weights.grad, found) and found.any()


def test_asking_for_density_in_between_does_not_disturb():
    field = trained()
    samples, units, d_sigma, d_rgb = made(300)
    field.forward(samples, units)
    field.backward(d_sigma, d_rgb)
    wanted = field.grid.weights.grad.clone()
    field.forward(samples, units)
    field.density(torch.rand(77, 3), torch.zeros(77, dtype=torch.int32))
    field.backward(d_sigma, d_rgb)
    assert torch.equal(field.grid.weights.grad, wanted)


def test_backward_needs_its_forward():
    field = trained()
    samples, _, d_sigma, d_rgb = made(64)
    with pytest.raises(RuntimeError, match="without the forward"):
        field.backward(d_sigma, d_rgb)
    field.density_forward(samples)
    with pytest.raises(RuntimeError, match="density_backward"):
        field.backward(d_sigma, d_rgb)


def test_a_loaded_field_is_the_same_and_another_shape_is_told():
    field, other = trained(), Field(SMALL, seed=9)
    samples, units, *_ = made(64)
    other.forward(samples, units)
    copy_into(other.parameters(), {name: tensor.clone() for name, tensor in field.parameters().items()})
    assert torch.equal(other.forward(samples, units)[0], field.forward(samples, units)[0])
    with pytest.raises(ValueError, match=r"expected grid of shape"):
        copy_into(Field(FieldConfig(mlp=MLPConfig(width=32))).parameters(), field.parameters())


def test_same_seed_same_field():
    one, same, other = Field(SMALL, seed=1), Field(SMALL, seed=1), Field(SMALL, seed=2)
    assert all(torch.equal(a, b) for a, b in zip(one.parameters().values(), same.parameters().values(), strict=True))
    assert not torch.equal(one.grid.weights, other.grid.weights)


def fit(field, optimiser, steps):
    """Do some steps towards a made-up target; return the last loss."""
    samples, units, *_ = made(2048)
    target = torch.sin(9 * samples.u) / 2 + 0.5
    loss = torch.tensor(0.0)
    for _ in steps:
        sigma, rgb = field.forward(samples, units)
        loss = ((rgb - target) ** 2).mean() + ((sigma - 1) ** 2).mean()
        field.backward(2 * (sigma - 1) / len(sigma), 2 * (rgb - target) / rgb.numel())
        optimiser.step(OptimiserConfig(), 0.1)
    return float(loss)


@pytest.mark.parametrize("copies", [True, False])
def test_fits_and_resumes_bit_for_bit(copies):
    def start():
        field = Field(SMALL)
        return field, Optimiser(field.parameters(), field.copies() if copies else None)

    field, optimiser = start()
    first = fit(field, optimiser, range(1))
    assert fit(field, optimiser, range(149)) < 0.3 * first
    saved = {name: tensor.clone() for name, tensor in {**field.parameters(), **optimiser.state()}.items()}
    fit(field, optimiser, range(5))
    other, another = start()
    copy_into(other.parameters(), saved)
    another.load(saved)
    fit(other, another, range(5))
    for name, tensor in {**field.parameters(), **optimiser.state()}.items():
        assert torch.equal({**other.parameters(), **another.state()}[name], tensor), name


@pytest.mark.parametrize("kernels", [cpu, plain])
@pytest.mark.parametrize("count", [3, 64, 40_003])
def test_adam_is_torchs(kernels, count):
    g = torch.Generator().manual_seed(0)
    mine = torch.randn(count, generator=g)
    other = mine.clone()
    mean, square, half = torch.zeros(count), torch.zeros(count), torch.zeros(count, dtype=torch.bfloat16)
    adam = torch.optim.Adam([other], lr=0.01, betas=(0.9, 0.99), eps=1e-15)
    for step in range(1, 8):
        gradient = torch.randn(count, generator=g) * 10.0 ** torch.randint(-12, 3, (count,), generator=g)
        gradient[:2] = 0  # never touched: must not move
        mine.grad = other.grad = gradient
        kernels.adam(mine, mean, square, half, 0.01, step)
        adam.step()
        torch.testing.assert_close(mine, other, rtol=1e-5, atol=1e-6)
        assert torch.equal(half, mine.bfloat16())


def test_the_rate_rises_and_falls():
    config = OptimiserConfig(warm_up=10, final=0.1)
    assert config.share(5, 0.0) == pytest.approx(0.5)
    rates = [config.share(10, progress) for progress in (0.0, 0.25, 0.5, 1.0, 2.0)]
    assert rates[0] == pytest.approx(1) and rates[2] == pytest.approx(0.55)
    assert rates[3] == rates[4] == pytest.approx(0.1) and rates == sorted(rates, reverse=True)


def test_sky_gradient_equals_autograd():
    sky = Sky(SkyConfig((4, 16)))
    sky.texels.copy_(torch.randn(sky.texels.shape, generator=torch.Generator().manual_seed(0)))
    units = torch.nn.functional.normalize(torch.randn(200, 3), dim=-1)
    d_rgb = torch.randn(200, 3)
    rgb = sky.forward(units)
    sky.backward(d_rgb)
    leaf = sky.texels.double().requires_grad_()
    rows, shares = corners(units, (4, 16))
    wanted = torch.sigmoid((leaf[rows] * shares.double()[:, :, None]).sum(1))
    wanted.backward(d_rgb.double())
    torch.testing.assert_close(rgb.double(), wanted.detach(), rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(sky.texels.grad.double(), leaf.grad, rtol=1e-5, atol=1e-6)


def test_every_direction_has_texels_and_neighbours_share_them():
    axes = torch.cat([torch.eye(3), -torch.eye(3), torch.nn.functional.normalize(torch.randn(2000, 3), dim=-1)])
    sizes = (8, 32)
    rows, shares = corners(axes, sizes)
    assert rows.min() >= 0 and rows.max() < sum(size**2 for size in sizes)
    assert (rows[:, :4] < 64).all() and (rows[:, 4:] >= 64).all()
    torch.testing.assert_close(shares.sum(1), torch.full((len(axes),), 2.0))
    assert shares.min() >= -1e-6
    # a small turn in the half z > 0 moves the picture's place by a small step
    sky = Sky(SkyConfig((32,)))
    sky.texels.copy_(torch.randn(sky.texels.shape))
    front = axes[axes[:, 2] > 0]
    turned = torch.nn.functional.normalize(front + 1e-4, dim=-1)
    assert (sky.forward(front) - sky.forward(turned)).abs().max() < 0.01


def test_sky_learns_what_it_is_shown():
    sky = Sky(SkyConfig())
    optimiser = Optimiser({f"sky.{name}": tensor for name, tensor in sky.parameters().items()})
    g = torch.Generator().manual_seed(0)
    for _ in range(150):
        units = torch.nn.functional.normalize(torch.randn(1024, 3, generator=g), dim=-1)
        sky.backward(2 * (sky.forward(units) - (0.5 + 0.4 * units)) / 1024)
        optimiser.step(OptimiserConfig(), 0.0)
    assert (sky.forward(units) - (0.5 + 0.4 * units)).abs().mean() < 0.02


@pytest.mark.parametrize("sizes", [(4,), (8, 32, 128)])
def test_sky_kernels_equal_the_twin_bit_for_bit(sizes):
    g = torch.Generator().manual_seed(0)
    units = torch.nn.functional.normalize(torch.randn(3000, 3, generator=g), dim=-1)
    units = torch.cat([units, torch.eye(3), -torch.eye(3)])
    texels = torch.randn(sum(size**2 for size in sizes), 3, generator=g)
    d_sums = torch.randn(len(units), 3, generator=g)
    fast = cpu_kernels().render
    assert torch.equal(fast.look(texels, units, sizes), slow_sky.look(texels, units, sizes))
    ours, theirs = (torch.full_like(texels, 9.0) for _ in range(2))
    fast.paint(d_sums, units, sizes, ours)
    slow_sky.paint(d_sums, units, sizes, theirs)
    assert torch.equal(ours, theirs)
