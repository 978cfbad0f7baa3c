"""The GPU's rasteriser: all of triton_splat_checks.py, and compiled for GPUs that are not here."""

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import torch

from nerf.gaussians.types import Drawing, Rates, SplatMoments, ViewGradients
from tests.splats import cloud, viewpoint
from tests.test_nerf_triton import LEAST_SHARED, Compiler

pytestmark = pytest.mark.skipif(find_spec("triton") is None, reason="no triton: pip install 'roadprior[dev]'")
MODULES = ("blend", "pixels", "project", "unblend", "unproject")
KERNELS = {"project", "shade", "enlist", "draw", "walk", "undraw", "back", "unproject", "move", "straighten"}
LOSS = {"compare", "differ"}


@pytest.mark.splats
def test_the_kernels_equal_their_twin() -> None:
    """On the GPU, or else in Triton's interpreter: what test_nerf_triton.py leaves out."""
    environment = dict(os.environ)
    if not torch.cuda.is_available():
        environment["TRITON_INTERPRET"] = "1"
    checks = Path(__file__).with_name("triton_splat_checks.py")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(checks), "-m", "splats"]
    done = subprocess.run(command, env=environment, cwd=checks.parents[1], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    assert int(re.search(r"(\d+) passed", done.stdout).group(1)) > 60  # type: ignore[union-attr]


@pytest.mark.stress
@pytest.mark.parametrize(("capability", "count", "size"), [(80, 64, (23, 38)), (90, 64, (23, 38)), (90, 1, (1, 1))])
def test_the_rasteriser_compiles(
    capability: int, count: int, size: tuple[int, int], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """All kernels as they are launched, also where a size is 1, which is a constant to Triton.

    In registers and shared memory that the smallest of these GPUs has.
    """
    from nerf.kernels.triton import colour_loss, splat, splat_train

    monkeypatch.setenv("TRITON_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(torch, "empty", torch.zeros)  # nothing runs, so nothing is in view
    made: list[tuple[str, Any]] = []
    parts_of = [vars(splat)[f"splat_{name}"] for name in MODULES]
    for module in (colour_loss, splat_train.splat_adam, *parts_of):
        for name in (KERNELS | LOSS) & set(vars(module)):
            monkeypatch.setattr(module, name, Compiler(vars(module)[name], capability, made))
    gaussians = cloud(count, 16 if count > 1 else 1)
    shown = splat.rasterise(gaussians, viewpoint(*size), Drawing())
    parts = splat.contributions(shown, torch.zeros(0, dtype=torch.int64))
    back = splat.backward(shown, ViewGradients(torch.zeros(*size, 3), torch.zeros(size), torch.zeros(size), parts))
    moments = SplatMoments(gaussians.zeros(), gaussians.zeros(), torch.ones(count))
    splat.adam(gaussians, back, moments, Rates(1.0, 1.0, 1.0, 1.0, 1.0, 1.0), 1)
    splat.colour_loss(torch.zeros(*size, 3), torch.zeros(*size, 3), 0.2 if count > 1 else 0.0)
    assert {name for name, _ in made} == KERNELS | LOSS
    for name, kernel in made:
        assert kernel.metadata.shared <= LEAST_SHARED, name
        found = resources(kernel, tmp_path / f"{name}.cubin")
        assert found["STACK"] <= 16, f"{name} spills: {found}"
        assert found["REG"] <= 168, f"fewer than 12 warps of {name} fit a processor: {found}"


def resources(kernel: Any, path: Path) -> dict[str, int]:
    """Return what a compiled kernel takes: registers a thread (REG), bytes that did not fit them (STACK)."""
    import triton

    tool = Path(triton.__file__).parent / "backends" / "nvidia" / "bin" / "cuobjdump"
    path.write_bytes(kernel.asm["cubin"])
    told = subprocess.run([tool, "-res-usage", path], capture_output=True, text=True, check=True).stdout
    return {name: int(value) for name, value in re.findall(r"(REG|STACK):(\d+)", told)}
