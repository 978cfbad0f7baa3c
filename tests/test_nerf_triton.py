"""The GPU kernels: equal to their twin (tests/triton_checks.py), and compiled for GPUs that are not here."""

import os
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import torch

from nerf import kernels
from nerf.types import Gradients, GridConfig, Layers, Target
from tests.test_nerf_render import make

pytestmark = [
    pytest.mark.stress,
    pytest.mark.skipif(find_spec("triton") is None, reason="no triton: pip install 'roadprior[dev]'"),
]
LEAST_SHARED = 99 << 10
"""Shared memory that a program may ask for on the smallest of the GPUs with bfloat16 products, bytes."""


def test_the_kernels_equal_their_twin() -> None:
    """On the GPU, or else in Triton's interpreter, which has to be chosen before Triton is imported."""
    environment = dict(os.environ)
    if not torch.cuda.is_available():
        environment["TRITON_INTERPRET"] = "1"
    here = Path(__file__).parent
    checks = [str(here / name) for name in ("triton_checks.py", "triton_splat_checks.py")]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *checks, "-m", "not splats"]
    done = subprocess.run(command, env=environment, cwd=here.parent, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    assert " passed" in done.stdout


class Compiler:
    """Stands in for a kernel: compiles it for a GPU as it is called, and runs nothing."""

    made: list[tuple[str, Any]]

    def __init__(self, kernel: Any, capability: int, made: list[tuple[str, Any]]) -> None:
        self.kernel, self.capability, self.made = kernel, capability, made

    def __getitem__(self, grid: Any) -> "Compiler":
        return self

    def __call__(self, *arguments: Any, **constants: Any) -> None:
        from triton import compile as build
        from triton.backends.compiler import GPUTarget
        from triton.compiler import ASTSource

        names = {torch.float32: "fp32", torch.bfloat16: "bf16", torch.int32: "i32", torch.int64: "i64"}
        options = {name: constants.pop(name) for name in ("num_warps", "num_stages") if name in constants}
        signature, aligned = {}, {}
        for i, (name, value) in enumerate(zip(self.kernel.arg_names, arguments, strict=False)):
            if type(value) is int and value == 1:  # the launcher compiles another kernel for it
                constants[name] = value
                continue
            scalar = "fp32" if isinstance(value, float) else "i32"
            signature[name] = "*" + names[value.dtype] if isinstance(value, torch.Tensor) else scalar
            if (value.data_ptr() if isinstance(value, torch.Tensor) else value) % 16 == 0:
                aligned[(i,)] = [["tt.divisibility", 16]]
        signature |= dict.fromkeys(constants, "constexpr")
        target = GPUTarget("cuda", self.capability, 32)
        source = ASTSource(self.kernel, signature, constexprs=constants, attrs=aligned)
        found = build(source, target=target, options=options)
        self.made.append((self.kernel.__name__, found))


@pytest.fixture(params=[80, 90], ids=["sm80", "sm90"])
def made(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Iterator[list[tuple[str, Any]]]:
    """Make the kernels compile instead of running."""
    from nerf.kernels.triton import adam, composite, encode, field, perceptron

    monkeypatch.setenv("TRITON_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(field, "_capability", lambda device: divmod(request.param, 10))
    found: list[tuple[str, Any]] = []
    for module in (adam, composite, encode, perceptron):
        for name, kernel in list(vars(module).items()):
            if type(kernel).__name__ == "JITFunction" and not name.startswith("_") and name != "pack":
                monkeypatch.setattr(module, name, Compiler(kernel, request.param, found))
    yield found
    for name, kernel in found:
        assert kernel.metadata.shared <= LEAST_SHARED, name
    assert found


def test_the_field_compiles(made: list[tuple[str, Any]]) -> None:
    from nerf.kernels.triton import field

    config = GridConfig(levels=16, log2_size=10, tables=2)
    m = field.SAMPLES_MULTIPLE
    u, table, footprint = torch.rand(m, 3), torch.zeros(m, dtype=torch.int32), torch.rand(m)
    features = field.encode(u, table, footprint, torch.zeros(2, config.rows, 2).bfloat16(), config)
    field.spread(u, table, footprint, features, config, torch.zeros(2, config.rows, 2))
    layers = Layers(*(torch.zeros(shape) for shape in [(64, 32), (16, 64), (64, 32), (64, 64), (3, 64)]))
    given = torch.zeros(9, 16), torch.zeros(m, dtype=torch.int32)
    field.density(features, layers, 0.02)
    field.density_backward(features, layers, 0.02, torch.zeros(m))
    field.shade(features, *given, layers, 0.02)
    field.shade_backward(features, *given, layers, 0.02, torch.zeros(m), torch.zeros(m, 3))
    weights = torch.zeros(5000)
    weights.grad = torch.zeros(5000)
    field.adam(weights, torch.zeros(5000), torch.zeros(5000), weights.bfloat16(), 1e-2, 1)
    assert {name for name, _ in made} == {"encode", "spread", "forward", "backward", "adam"}
    # Hopper adds both features of a row at once; without that the way back takes twice as long.
    for name, kernel in made:
        if name == "spread" and kernel.metadata.target.arch == 90:
            assert "add.v2.f32" in kernel.asm["ptx"]


@pytest.mark.parametrize(("capability", "runs"), [((7, 5), False), ((8, 0), True), ((9, 0), True)])
def test_gpus_get_the_kernels_that_they_can_run(
    monkeypatch: pytest.MonkeyPatch, capability: tuple[int, int], runs: bool
) -> None:
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: capability)
    kernels._runs_triton.cache_clear()
    found = kernels.kernels_for(torch.device("cuda"))
    kernels._runs_triton.cache_clear()
    kind = "triton" if runs else "plain"
    expected = [f"nerf.kernels.{kind}.field", f"nerf.kernels.{kind}.render", "nerf.kernels.plain.sample"]
    expected += [f"nerf.kernels.{kind}.splat"]
    assert [part.__name__ for part in found] == expected  # type: ignore[attr-defined]
    assert kernels.kernels_for(torch.device("meta")) == kernels.plain_kernels()


def test_the_renderer_compiles(made: list[tuple[str, Any]]) -> None:
    from nerf.kernels.triton import render

    samples, sigma, rgb, sky, rays = make([3, 0, 5])
    rendered = render.forward(samples, sigma, rgb, sky)
    render.backward(samples, sigma, rgb, sky, rendered, Gradients.zeros(rendered))
    target = Target(rays.norms, rays.norms, rays.norms)
    render.kl(samples, sigma, target, rays.norms, sigma)
    render.sight(samples, sigma, target, rays.norms, sigma)
    render.distortion(samples, sigma, rays.norms, sigma)
    render.interlevel(samples, sigma, samples, sigma, rays.norms)
    assert {name for name, _ in made} == {"forward", "backward", "kl", "sight", "distortion", "interlevel"}
