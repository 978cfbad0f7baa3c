"""The small networks: the kernels equal the twin that rounds alike, and are near the one that does not."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.special import sph_harm_y

from nerf.harmonics import harmonics
from nerf.kernels.cpu import field as cpu
from nerf.kernels.cpu import layers as kernel
from nerf.kernels.cpu import perceptron
from nerf.kernels.plain import field as plain
from nerf.mlp import MLP, MLPConfig
from nerf.twin import encode as twin_encode
from nerf.twin import field as twin
from nerf.twin.field import LOGIT_MAX
from nerf.types import Layers
from priors.errors import DataError
from priors.machine import threads

INITIAL = 0.02
SIZES = pytest.mark.parametrize(
    ("width", "levels", "count"), [(64, 16, 2048), (16, 16, 320), (32, 5, 64), (48, 7, 192), (128, 12, 1024)]
)


@pytest.fixture(autouse=True)
def seeded():
    torch.manual_seed(0)


def made(width, levels, count, rays=7):
    """Return layers, features, harmonics, rays and gradients of the results."""
    g = torch.Generator().manual_seed(width)
    shapes = [(width, 2 * levels), (16, width), (width, 32), (width, width), (3, width)]
    layers = Layers(*(torch.randn(shape, generator=g) * (2 / shape[1]) ** 0.5 for shape in shapes))
    features = torch.randn(levels, count, 2, generator=g).bfloat16()
    basis = harmonics(torch.nn.functional.normalize(torch.randn(rays, 3, generator=g), dim=-1))
    ray = torch.randint(-1, rays, (count,), generator=g, dtype=torch.int32)
    return layers, features, basis, ray, torch.randn(count, generator=g), torch.randn(count, 3, generator=g)


def exact(layers, features, basis, ray, d_sigma, d_rgb, half):
    """Return the twin's results and gradients in float64."""
    leaves = Layers(*(layer.double().requires_grad_() for layer in layers))
    x = features.double().requires_grad_()
    outputs = twin.shade(x, basis.double(), ray, leaves, INITIAL, half)
    gradients = torch.autograd.grad(outputs, [x, *leaves], [d_sigma.double(), d_rgb.double()])
    return [output.detach() for output in outputs], gradients


def far(found, wanted):
    """Return the relative distance of two tensors."""
    return float((found.double() - wanted).norm() / wanted.norm())


@SIZES
def test_equal_to_the_twin_that_rounds_alike(width, levels, count):
    layers, *asked, d_sigma, d_rgb = made(width, levels, count)
    (sigma, rgb), gradients = exact(layers, *asked, d_sigma, d_rgb, half=True)
    found = cpu.shade(*asked, layers, INITIAL)
    # sums in another order round some activations the other way: a few samples differ by a bfloat16 step
    assert far(found[0], sigma) < 2e-4 and far(found[1], rgb) < 1e-4
    assert ((found[0] / sigma - 1).abs() < 1e-5).double().mean() > 0.9
    d_features, d_layers = cpu.shade_backward(*asked, layers, INITIAL, d_sigma, d_rgb)
    for mine, wanted in zip((d_features, *d_layers), gradients, strict=True):
        assert mine.shape == wanted.shape
        assert far(mine, wanted) < 1e-3


@SIZES
def test_near_the_twin_in_full_precision(width, levels, count):
    layers, *asked, d_sigma, d_rgb = made(width, levels, count)
    (sigma, rgb), gradients = exact(layers, *asked, d_sigma.abs(), d_rgb.abs(), half=False)
    found = cpu.shade(*asked, layers, INITIAL)
    assert (found[0] / sigma - 1).abs().max() < 0.05 and (found[1] - rgb).abs().max() < 0.02
    d_features, d_layers = cpu.shade_backward(*asked, layers, INITIAL, d_sigma.abs(), d_rgb.abs())
    # a gate that opens or shuts by rounding changes its sample's gradient: few do, and they are not all of it
    samples = [far(d_features[:, i], gradients[0][:, i]) for i in range(count)]
    assert float(np.median(samples)) < 0.03
    for mine, wanted in zip((d_features, *d_layers), gradients, strict=True):
        assert far(mine, wanted) < 0.2


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="matrix tiles are x86's")
def test_the_code_for_tiles_compiles_on_cpus_without(tmp_path):
    root = Path(__file__).resolve().parents[1]
    environment = {**os.environ, "PYTHONPATH": str(root), "ROADPRIOR_CACHE": str(tmp_path)}
    command = [sys.executable, "-P", str(root / "tests" / "reference" / "tiles_compiled.py")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    instructions = "ldtilecfg tdpbf16ps vcvtne2ps2bf16 tilerelease"
    assert done.stdout.splitlines() == [f"forward {instructions}", f"backward {instructions}"], done.stderr


@SIZES
def test_density_alone_is_the_same_density(width, levels, count):
    layers, features, basis, ray, d_sigma, d_rgb = made(width, levels, count)
    assert torch.equal(cpu.density(features, layers, INITIAL), cpu.shade(features, basis, ray, layers, INITIAL)[0])
    d_features, d_layers = cpu.density_backward(features, layers, INITIAL, d_sigma)
    dark = cpu.shade_backward(features, basis, ray, layers, INITIAL, d_sigma, torch.zeros_like(d_rgb))
    assert torch.equal(d_features, dark[0])
    for mine, wanted in zip(d_layers, dark[1], strict=True):
        torch.testing.assert_close(mine, wanted, rtol=1e-6, atol=0)


def passes(inputs, layers, gradients):
    """Return everything that a pass forward and back computes."""
    d_features, d_layers = cpu.shade_backward(*inputs, layers, INITIAL, *gradients)
    return *cpu.shade(*inputs, layers, INITIAL), d_features, *d_layers


def test_same_bits_whatever_the_threads(monkeypatch):
    layers, *inputs, d_sigma, d_rgb = made(64, 16, 4096)
    gradients = d_sigma, d_rgb
    results = []
    for count in (1, 2, 5):
        with threads.limited(count):
            results.append(passes(inputs, layers, gradients))
    assert all(torch.equal(a, b) for other in results[1:] for a, b in zip(results[0], other, strict=True))
    # sums in another order have other bits: had the threads a say in it, the comparison above would tell
    monkeypatch.setattr(perceptron, "PARTS", 5)
    other = passes(inputs, layers, gradients)
    assert all(torch.equal(a, b) for a, b in zip(results[0][:3], other[:3], strict=True))
    assert not any(torch.equal(a, b) for a, b in zip(results[0][3:], other[3:], strict=True))


def test_results_do_not_depend_on_the_neighbours():
    layers, features, basis, ray, _, _ = made(64, 16, 1024)
    sigma, rgb = cpu.shade(features, basis, ray, layers, INITIAL)
    part = cpu.shade(features[:, 448:640].contiguous(), basis, ray[448:640].contiguous(), layers, INITIAL)
    torch.testing.assert_close(part[0], sigma[448:640], rtol=1e-6, atol=0)
    torch.testing.assert_close(part[1], rgb[448:640], rtol=1e-6, atol=1e-7)


def test_density_stops_growing_but_its_gradient_does_not_vanish():
    layers, features, *_ = made(64, 16, 64)
    steep = layers._replace(density1=layers.density1 * 1e3)
    sigma = cpu.density(features, steep, INITIAL)
    limit = INITIAL * float(np.exp(LOGIT_MAX))
    assert torch.isfinite(sigma).all() and sigma.max() == pytest.approx(limit, rel=1e-5) and sigma.min() < 1e-6
    d_features, _ = cpu.density_backward(features, steep, INITIAL, torch.ones(64))
    assert (d_features[:, sigma > 0.99 * limit] != 0).any()


def test_plain_functions_equal_autograd():
    layers, features, *asked, d_sigma, d_rgb = made(32, 8, 64)
    _, gradients = exact(layers, features, *asked, d_sigma, d_rgb, half=False)
    d_features, d_layers = plain.shade_backward(features.float(), *asked, layers, INITIAL, d_sigma, d_rgb)
    for mine, wanted in zip((d_features, *d_layers), gradients, strict=True):
        assert far(mine, wanted) < 1e-5
    _, d_layers = plain.density_backward(features.float(), layers, INITIAL, d_sigma)
    assert not any(layer.any() for layer in d_layers[2:])


def test_twin_gradients_equal_finite_differences():
    from nerf.types import GridConfig

    config = GridConfig(levels=2, log2_size=6, coarsest=2, finest=5)
    g = torch.Generator().manual_seed(0)
    weights = torch.randn(1, config.rows, 2, generator=g, dtype=torch.float64, requires_grad=True)
    shapes = [(16, 4), (16, 16), (16, 32), (16, 16), (3, 16)]
    layers = [torch.randn(s, generator=g, dtype=torch.float64, requires_grad=True) for s in shapes]
    u, table, ray = torch.rand(3, 3, generator=g), torch.zeros(3, dtype=torch.int32), torch.tensor([0, 1, 1])
    basis = torch.randn(2, 16, generator=g, dtype=torch.float64)

    def function(weights, *layers):
        features = twin_encode.encode(u, table, torch.tensor([0.0, 0.1, 0.3]), weights, config)
        return twin.shade(features, basis, ray, Layers(*layers), INITIAL)

    assert torch.autograd.gradcheck(function, (weights, *layers), fast_mode=True)


def test_harmonics_are_scipys():
    units = torch.nn.functional.normalize(torch.randn(50, 3, dtype=torch.float64), dim=-1)
    polar, azimuth = torch.arccos(units[:, 2]).numpy(), torch.atan2(units[:, 1], units[:, 0]).numpy()
    wanted = []
    for degree in range(4):
        for order in range(-degree, degree + 1):
            complex_one = sph_harm_y(degree, abs(order), polar, azimuth)
            part = complex_one.imag if order < 0 else complex_one.real
            wanted.append(part * (2**0.5 if order else 1))
    np.testing.assert_allclose(harmonics(units).numpy(), np.stack(wanted, axis=1), atol=1e-12)


def test_new_networks_start_from_an_even_fog():
    network = MLP(MLPConfig(), 16, torch.device("cpu"), torch.Generator().manual_seed(0), cpu)
    sigma = network.density(torch.full((16, 64, 2), 1e-4, dtype=torch.bfloat16))
    assert torch.allclose(sigma, torch.tensor(INITIAL), rtol=0.01)


@pytest.mark.parametrize("wrong", [{"width": 20}, {"width": 0}, {"width": 144}, {"initial_density": 0.0}])
def test_wrong_sizes_are_told(wrong):
    with pytest.raises(DataError, match="expected"):
        MLPConfig(**wrong)


def tiles_of(layer):
    """A layer as the products take it, by PyTorch: rounded, padded, tiles of 16 x 32."""
    rows, columns = kernel.padded(*layer.shape)
    full = torch.zeros(rows, columns, dtype=torch.bfloat16)
    full[: layer.shape[0], : layer.shape[1]] = layer
    return full.view(rows // 16, 16, columns // 32, 32).permute(0, 2, 1, 3).flatten()


@pytest.mark.parametrize("shape", [(64, 32), (16, 64), (3, 48), (32, 10), (1, 1)])
@pytest.mark.parametrize("across", [False, True])
def test_layers_are_cut_as_torch_rounds_and_lays_them(shape, across):
    layer = torch.randn(shape) * 10.0 ** torch.randint(-30, 30, shape)
    layer.view(-1)[:1] = torch.inf
    wanted = tiles_of(layer.T if across else layer)
    tiles = cpu._net(Layers(*[layer] * 5), across).density0
    found = torch.from_numpy(tiles).view(torch.bfloat16) if kernel.PAIRED else torch.from_numpy(tiles)
    assert torch.equal(found.float(), wanted.float())


def test_what_is_no_number_stays_none_in_a_layer():
    layer = torch.from_numpy(np.array([[0x7FFFFFFF, 0x7F800001, -1, 0]], np.int64).astype(np.int32)).view(torch.float32)
    tiles = torch.from_numpy(cpu._net(Layers(*[layer] * 5)).colour1)
    found = (tiles.view(torch.bfloat16) if kernel.PAIRED else tiles)[:4]
    assert found.isnan().tolist() == [True, True, True, False]


@pytest.mark.parametrize("shape", [(64, 32), (3, 48), (16, 64)])
def test_the_parts_of_a_gradient_are_added_in_their_order(shape):
    rows, columns = kernel.padded(*shape)
    parts = torch.randn(5, rows // 16, columns // 16, 16, 16) * 10.0 ** torch.randint(-6, 6, (5, 1, 1, 1, 1))
    total = parts[0].clone()
    for part in parts[1:]:
        total += part
    out = torch.empty(shape)
    kernel.join(parts.flatten(1).numpy(), *shape, out.view(-1).numpy())
    assert torch.equal(out, total.permute(0, 2, 1, 3).reshape(rows, columns)[: shape[0], : shape[1]])
