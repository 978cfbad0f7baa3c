"""The GPU kernels against their twin, run by test_nerf_triton.py: on a GPU, or with TRITON_INTERPRET=1 anywhere."""

import math
import os
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

import nerf
from nerf.field import Field, FieldConfig
from nerf.kernels import Kernels, RenderKernels, plain_kernels, triton_kernels
from nerf.kernels.plain import field as plain_field
from nerf.kernels.plain import render as plain_render
from nerf.kernels.triton import field as triton_field
from nerf.kernels.triton import render as triton_render
from nerf.losses import LossConfig, losses
from nerf.mlp import MLPConfig
from nerf.optimise import Optimiser, OptimiserConfig
from nerf.sample import Sampler, SamplerConfig
from nerf.sky import Sky, SkyConfig
from nerf.space import Space
from nerf.twin import field as twin_field
from nerf.twin import render as twin_render
from nerf.types import Gradients, GridConfig, Histogram, Layers, Rays, Rendered, Samples, Target
from tests.reference.triton_calls import hasten
from tests.reference.triton_halves import mend
from tests.test_nerf_render import FIELDS, make

INTERPRETED = os.environ.get("TRITON_INTERPRET") == "1"
DEVICE = torch.device("cpu" if INTERPRETED else "cuda")
if INTERPRETED:
    mend()
    hasten()
PACKAGE = str(Path(nerf.__file__).parent)
COUNTS = [[5, 3, 0, 17, 1], [0, 0], [3] * 70, [50, 2, 25]]


def moved(value: Any, device: torch.device | str = DEVICE) -> Any:
    """Bring tensors, or dataclasses of tensors, to the device."""
    if isinstance(value, Tensor):
        return value.to(device)
    if isinstance(value, Target):
        return Target(*(x.to(device) for x in value))
    if isinstance(value, (Samples, Rays, Gradients)):
        return type(value)(**{name: moved(getattr(value, name), device) for name in value.__dataclass_fields__})
    return value


def drawn(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def near(ours: Tensor, theirs: Tensor, share: float) -> None:
    """Compare with a tolerance that is a share of the largest value."""
    theirs = theirs.detach().float().cpu()
    torch.testing.assert_close(ours.float().cpu(), theirs, rtol=0, atol=share * max(float(theirs.abs().max()), 1e-9))


@pytest.fixture(params=[(1, False, 3), (2, True, 5)], ids=["points", "two tables, cones"])
def asked(request: pytest.FixtureRequest) -> tuple[Tensor, Tensor, Tensor | None, GridConfig]:
    """Places, with the grid's corners among them; tables; footprints; a grid with dense and hashed levels."""
    tables, cones, levels = request.param
    m = 2 * triton_field.SAMPLES_MULTIPLE
    u = torch.rand(m, 3, generator=torch.Generator().manual_seed(1))
    u[0], u[1], u[2] = 0, 1, torch.tensor([0.5, 1.0, 0.0])
    table = (torch.arange(m) % tables).to(torch.int32)
    footprint = 0.1 * torch.rand(m, generator=torch.Generator().manual_seed(2)) if cones else None
    config = GridConfig(levels=levels, log2_size=11, coarsest=4, finest=300, tables=tables)
    return moved(u.T.contiguous().T), moved(table), moved(footprint), config


def test_encoding(asked: tuple[Tensor, Tensor, Tensor | None, GridConfig]) -> None:
    *places, config = asked
    weights = moved(drawn(config.tables, config.rows, 2).bfloat16())
    ours = triton_field.encode(*places, weights, config)
    theirs = plain_field.encode(*places, weights.float(), config)
    torch.testing.assert_close(ours.float(), theirs.bfloat16().float(), rtol=1e-2, atol=1e-6)


def test_spreading(asked: tuple[Tensor, Tensor, Tensor | None, GridConfig]) -> None:
    u, table, footprint, config = asked
    d_features = moved(drawn(config.levels, len(u), 2).bfloat16())
    ours = torch.full((config.tables, config.rows, 2), math.nan, device=DEVICE)  # what was there does not count
    theirs = torch.zeros_like(ours)
    triton_field.spread(u, table, footprint, d_features, config, ours)
    plain_field.spread(u, table, footprint, d_features.float(), config, theirs)
    near(ours, theirs, 2e-6)


@pytest.fixture(params=[(16, 16), (5, 48), (16, 64), (2, 80)], ids=lambda p: f"{p[0]} levels, {p[1]} wide")
def network(request: pytest.FixtureRequest) -> tuple[Tensor, Tensor, Tensor, Layers]:
    """Features, harmonics, rays with padding, layers; m is several tiles of every program."""
    levels, neurons = request.param
    shapes = [(neurons, 2 * levels), (16, neurons), (neurons, 32), (neurons, neurons), (3, neurons)]
    layers = Layers(*(moved(drawn(*shape, seed=i) * (2 / shape[1]) ** 0.5) for i, shape in enumerate(shapes)))
    m = 2 * triton_field.SAMPLES_MULTIPLE
    features, ray = drawn(levels, m, 2).bfloat16(), torch.randint(-1, 9, (m,), dtype=torch.int32)
    features[:, 7] = 30.0  # beyond the density's limit, or far below
    return moved(features), moved(drawn(9, 16)), moved(ray), layers


def test_shading(network: tuple[Tensor, Tensor, Tensor, Layers]) -> None:
    features, harmonics, ray, layers = network
    half = layers.density0.shape[0] <= 64
    sigma, rgb = triton_field.shade(features, harmonics, ray, layers, 0.02)
    expected = twin_field.shade(features.float(), harmonics, ray, layers, 0.02, half)
    torch.testing.assert_close(sigma, expected[0], rtol=2e-2, atol=0)
    torch.testing.assert_close(rgb, expected[1], rtol=0, atol=4e-3)
    torch.testing.assert_close(triton_field.density(features, layers, 0.02), sigma)


@pytest.mark.parametrize("colour", [False, True])
def test_shading_backward(network: tuple[Tensor, Tensor, Tensor, Layers], colour: bool) -> None:
    features, harmonics, ray, layers = network
    d_sigma, d_rgb = moved(drawn(len(ray), seed=8)), moved(drawn(len(ray), 3, seed=9))
    d_sigma[7] = 1e-9  # its density is e^12 times the others'
    leaves = Layers(*(layer.clone().requires_grad_() for layer in layers))
    inputs = features.float().requires_grad_()
    half = layers.density0.shape[0] <= 64
    if colour:
        ours = triton_field.shade_backward(features, harmonics, ray, layers, 0.02, d_sigma, d_rgb)
        outputs, given = twin_field.shade(inputs, harmonics, ray, leaves, 0.02, half), (d_sigma, d_rgb)
    else:
        ours = triton_field.density_backward(features, layers, 0.02, d_sigma)
        outputs, given = (twin_field.density(inputs, leaves, 0.02, half)[0],), (d_sigma,)
    expected = torch.autograd.grad(outputs, [inputs, *leaves], given, materialize_grads=True)
    for our, theirs in zip((ours[0], *ours[1]), expected, strict=True):
        assert our.shape == theirs.shape
        near(our, theirs, 1e-2)
        assert float((our.float() - theirs).norm()) <= 4e-3 * max(float(theirs.norm()), 1e-9)


def test_gradients_do_not_depend_on_timing(network: tuple[Tensor, Tensor, Tensor, Layers]) -> None:
    features, harmonics, ray, layers = network
    given = moved(drawn(len(ray))), moved(drawn(len(ray), 3))
    first, second = (triton_field.shade_backward(features, harmonics, ray, layers, 0.02, *given) for _ in range(2))
    assert torch.equal(first[0], second[0])
    assert all(torch.equal(a, b) for a, b in zip(first[1], second[1], strict=True))


def test_adam() -> None:
    ours, theirs = ([moved(drawn(1500, seed=s)) for s in range(3)] for _ in range(2))
    copy = torch.empty(1500, device=DEVICE, dtype=torch.bfloat16)
    for step in (1, 2):
        for (weights, mean, square), kernels in ((ours, triton_field), (theirs, plain_field)):
            square.abs_()
            weights.grad = moved(drawn(1500, seed=7 + step))
            weights.grad[: 100 * step] = 0
            kernels.adam(weights, mean, square, copy if kernels is triton_field else None, 1e-2, step)
    for our, their in zip(ours, theirs, strict=True):
        torch.testing.assert_close(our, their, rtol=1e-5, atol=1e-7)
    assert torch.equal(copy, ours[0].bfloat16())


@pytest.mark.parametrize("counts", COUNTS, ids=lambda counts: f"{len(counts)} rays")
def test_rendering(counts: list[int]) -> None:
    given = make(counts)[:4]
    ours = triton_render.forward(*(moved(x) for x in given))
    theirs = twin_render.render(given[0], *(x.double() for x in given[1:]))
    for name in FIELDS:
        torch.testing.assert_close(getattr(ours, name).cpu(), getattr(theirs, name).float(), atol=3e-6, rtol=3e-5)


@pytest.mark.parametrize("counts", COUNTS, ids=lambda counts: f"{len(counts)} rays")
def test_rendering_backward(counts: list[int]) -> None:
    samples, sigma, rgb, sky, _ = make(counts)
    sigma[3] = 1e4  # a wall
    made = triton_render.forward(*(moved(x) for x in (samples, sigma, rgb, sky)))
    shapes = [made.rgb, made.depth_m, made.depth_m, made.weights, made.weights]
    gradients = [drawn(*x.shape, seed=i) for i, x in enumerate(shapes)]
    ours = triton_render.backward(*(moved(x) for x in (samples, sigma, rgb, sky)), made, moved(Gradients(*gradients)))
    wide = Rendered(*(getattr(made, name).double().cpu() for name in FIELDS))
    doubled = [x.double() for x in (sigma, rgb, sky)]
    theirs = plain_render.backward(samples, *doubled, wide, Gradients(*(x.double() for x in gradients)))
    for our, their in zip(ours, theirs, strict=True):
        torch.testing.assert_close(our.cpu(), their.float(), atol=1e-4, rtol=2e-4)


@pytest.mark.parametrize("counts", COUNTS, ids=lambda counts: f"{len(counts)} rays")
@pytest.mark.parametrize("kind", ["kl", "sight", "distortion"])
def test_losses(counts: list[int], kind: str) -> None:
    samples, sigma, _, _, rays = make(counts, seed=3)
    assert rays.depth_m is not None
    weights = twin_render.render(samples, sigma, torch.zeros(len(sigma), 3), torch.zeros(len(counts), 3)).weights
    scale = torch.rand(len(counts), generator=torch.Generator().manual_seed(4))
    target = Target(rays.norms, rays.depth_m, 0.05 * rays.depth_m + 0.1)
    value, aims = {"kl": (sigma, [target]), "sight": (weights, [target]), "distortion": (weights, [])}[kind]
    ours, theirs = torch.ones_like(sigma), torch.ones_like(sigma).double()  # gradients are added
    ours, wide = moved(ours), [Target(*(x.double() for x in aim)) for aim in aims]
    found = getattr(triton_render, kind)(moved(samples), moved(value), *map(moved, aims), moved(scale), ours)
    expected = getattr(plain_render, kind)(samples, value.double(), *wide, scale.double(), theirs)
    torch.testing.assert_close(found.cpu(), expected.float(), atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(ours.cpu(), theirs.float(), atol=2e-5, rtol=1e-3)


@pytest.mark.parametrize("counts", COUNTS, ids=lambda counts: f"{len(counts)} rays")
def test_interlevel(counts: list[int]) -> None:
    samples, _, _, _, rays = make(counts, seed=3)
    coarse, sigma, _, _, _ = make([max(0, count - 1) for count in counts[::-1]], seed=5)
    weights, bound = torch.rand(len(samples.t), generator=torch.Generator().manual_seed(1)), 0.2 * sigma
    scale = rays.norms
    found = triton_render.interlevel(*(moved(x) for x in (samples, weights, coarse, bound, scale)))
    expected = plain_render.interlevel(samples, weights.double(), coarse, bound.double(), scale.double())
    for our, theirs in zip(found, expected, strict=True):
        torch.testing.assert_close(our.cpu(), theirs.float(), atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("value", [0.0, 1e-38, 1e-12, 65504.0, 1e30])
def test_extreme_densities_stay_finite(value: float) -> None:
    samples, sigma, rgb, sky, rays = (moved(x) for x in make([12] * 4))
    sigma = torch.full_like(sigma, value)
    made = triton_render.forward(samples, sigma, rgb, sky)
    gradients, scale = Gradients.zeros(made), torch.ones_like(rays.norms)
    found = triton_render.kl(samples, sigma, Target(rays.norms, rays.depth_m, 0.1 * rays.norms), scale, gradients.tau)
    gradients.rgb.fill_(1)
    back = triton_render.backward(samples, sigma, rgb, sky, made, gradients)
    assert all(torch.isfinite(x).all() for x in (found, made.rgb, made.depth_m, made.weights, *back))


class Placed(TorchFunctionMode):
    """Notes where the package makes a tensor without saying on which device."""

    MAKERS = (torch.empty, torch.zeros, torch.ones, torch.full, torch.arange, torch.tensor, torch.rand, torch.linspace)

    def __init__(self) -> None:
        super().__init__()
        self.lost: list[str] = []

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        frame = sys._getframe(1)
        if func in self.MAKERS and "device" not in (kwargs or {}) and frame.f_code.co_filename.startswith(PACKAGE):
            self.lost.append(f"{frame.f_code.co_filename}:{frame.f_lineno}")
        return func(*args, **(kwargs or {}))


def trained(device: torch.device, kernels: Kernels) -> tuple[dict[str, Tensor], list[str]]:
    """Take two steps with a small field; return all parameters and where tensors were made on no named device."""
    samples, _, _, _, rays = make([9, 4, 0, 20] * 5)
    made = torch.Generator().manual_seed(2)
    samples.u.copy_(torch.rand(samples.u.shape, generator=made))
    samples, rays = (x if device.type == "cpu" else moved(x) for x in (samples, rays))
    config = FieldConfig(GridConfig(levels=3, log2_size=8, coarsest=4, finest=64), MLPConfig(width=16))
    field, sky = Field(config, device, 3, kernels.field), Sky(SkyConfig(sizes=(4, 8)), device, kernels.render)
    parameters = {f"field.{k}": v for k, v in field.parameters().items()} | {"sky.texels": sky.texels}
    optimiser = Optimiser(parameters, {"field.grid": field.copies()["grid"]}, kernels.field)
    with Placed() as placed:
        for _ in range(2):
            forth_and_back(field, sky, samples, rays, kernels.render)
            optimiser.step(OptimiserConfig(warm_up=0), 0.5)
    return {name: tensor.cpu() for name, tensor in parameters.items()}, placed.lost


def forth_and_back(field: Field, sky: Sky, samples: Samples, rays: Rays, kernels: RenderKernels) -> None:
    """Set the gradients of all parameters."""
    sigma, rgb = field.forward(samples, rays.units)
    behind = sky.forward(rays.units)
    rendered = kernels.forward(samples, sigma, rgb, behind)
    found = losses(LossConfig(loss="urf", trim=0.1), samples, rays, sigma, rendered, kernels)
    d_sigma, d_rgb, d_sky = kernels.backward(samples, sigma, rgb, behind, rendered, found.gradients)
    field.backward(d_sigma, d_rgb)
    sky.backward(d_sky)


def test_a_step_of_training() -> None:
    """The whole chain on the kernels moves the parameters as on the twin, and says where its tensors are made."""
    expected, _ = trained(torch.device("cpu"), plain_kernels())
    found, lost = trained(DEVICE, triton_kernels())
    assert lost == []
    for name, theirs in expected.items():
        # Adam's first steps have the gradient's sign alone: where it is next to nothing, rounding decides.
        assert float(((found[name] - theirs).abs() > 2e-3).float().mean()) < 0.05, name
        assert float((theirs - untrained(name, theirs)).abs().max()) > 1e-3, name


def untrained(name: str, like: Tensor) -> Tensor:
    """Return the parameters before the first step."""
    if name == "sky.texels":
        return torch.zeros_like(like)
    config = FieldConfig(GridConfig(levels=3, log2_size=8, coarsest=4, finest=64), MLPConfig(width=16))
    return Field(config, "cpu", seed=3).parameters()[name.removeprefix("field.")]


@pytest.mark.parametrize("kind", ["box", "ball", "spheres", "cube"])
def test_samplers_say_where_their_tensors_are(kind: Any) -> None:
    """The plain samplers serve GPUs."""
    rays = make([1] * 6)[-1]
    wide = Rays(rays.origins_m.double(), rays.directions.double(), None, rays.depth_m.double())
    space = Space(kind, (0.0, 0.0, 10.0), (20.0, 5.0, 40.0), 0.5, 80.0)
    with Placed() as placed:
        sampler = Sampler(space, kernels=plain_kernels().sample)
        samples = [sampler.march(wide, 64, (0, 1)), sampler.guided(wide, SamplerConfig(), (0, 1))]
        targets = torch.linspace(0, 1, 5, device=wide.directions.device).expand(len(wide), 5)
        plain_kernels().sample.resample(Histogram(samples[0], samples[0].dt_m, 0.01), targets)
    assert placed.lost == []
    assert all(made.used > 0 for made in samples)


def test_field_and_sky_stay_on_their_device() -> None:
    """torch's `meta` device refuses to meet tensors of another one."""
    samples, _, _, _, rays = make([9, 4, 0, 20])
    away = moved(samples, "meta")
    units = rays.units.to("meta")
    field, sky = Field(FieldConfig(GridConfig(log2_size=8)), "meta"), Sky(SkyConfig(), "meta")
    sigma, rgb = field.forward(away, units, torch.empty(len(samples.t), device="meta"))
    field.backward(torch.empty_like(sigma), torch.empty_like(rgb))
    sky.backward(torch.empty_like(sky.forward(units)))
    made = [*field.parameters().values(), sky.texels]
    assert all(x.device.type == "meta" and x.grad is not None and x.grad.device.type == "meta" for x in made)
