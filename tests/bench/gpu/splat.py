"""Gaussians: the rasteriser against its twin, its time beside gsplat's, and a fit of the packed drive."""

import tempfile
import time
from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from nerf.config import FitConfig, ModelConfig
from nerf.fit import Status, fit
from nerf.gaussians.types import NAMES, Drawing, Gaussians, ViewGradients, Viewpoint
from nerf.kernels import gsplat, kernels_for
from nerf.kernels.plain import splat as plain
from nerf.losses import LossConfig
from tests.bench.bench_gpu import milliseconds
from tests.bench.bench_splat import scene, share, viewpoint
from tests.bench.gpu.fit import SCORING_S, score
from tests.bench.gpu.pack import open_pack
from tests.bench.gpu.parts import note

SIZE, COUNT, DEGREE = (1242, 375), 500_000, 3
"""Of the view that is timed: width and height, Gaussians (half of them in view), degree of their colours."""
EXACT = Drawing(least_alpha=1e-6, enough=0.0)
"""No Gaussian ends where rounding could matter."""
MOST_APART = 1e-3
"""Share of the twin's norm, float32 too, by which pictures and gradients may differ; the median may jump."""
FIT_S = 60.0


def run(options: Namespace) -> None:
    """Note the figures as they come; on a CPU small shapes, which say nothing about a GPU."""
    device, small = torch.device(options.device), options.device == "cpu"
    note(kernels=kernels_for(device).splat.__name__)  # type: ignore[attr-defined]
    _against_twin(device)
    width, height, count = (124, 37, 2000) if small else (*SIZE, COUNT)
    seen_from = viewpoint(width, height)
    made = scene(count, seen_from, (DEGREE + 1) ** 2)
    gaussians = Gaussians(*(x.to(device) for x in made.tensors().values()))
    for name, kernels in (("ours", kernels_for(device).splat), ("gsplat", gsplat)):
        what = f"{name}, {width}x{height}, {count} Gaussians"
        if name == "gsplat" and not gsplat.is_there():
            note(gsplat="not installed: no comparison")
        else:
            note(**{what: _timed(kernels, gaussians, seen_from, device, 1 if small else 20)})
    _fitted(options)


def _against_twin(device: torch.device) -> None:
    """Note how far kernels and twin are apart on the device; raise SystemExit where that is too far."""
    seen_from, random = viewpoint(100, 60), torch.Generator().manual_seed(0)
    made = scene(1500, seen_from, 16)
    gaussians = Gaussians(*(x.to(device) for x in made.tensors().values()))
    given = [torch.randn(60, 100, *more, generator=random).to(device) for more in ((3,), (), ())]
    shown, back = [], []
    for kernels in (kernels_for(device).splat, plain):
        shown.append(kernels.rasterise(gaussians, seen_from, EXACT))
        back.append(kernels.backward(shown[-1], ViewGradients(*given)))
    apart = {name: share(*(getattr(x, name) for x in shown)) for name in ("rgb", "depth_sum", "opacity", "median_m")}
    if torch.equal(back[0].index, back[1].index):
        apart |= {name: share(*(getattr(x.of, name) for x in back)) for name in NAMES}
    note(**{f"apart from the twin, {name}": float(f"{value:.2g}") for name, value in apart.items()})
    far = [name for name, value in apart.items() if name != "median_m" and not value <= MOST_APART]
    if far or len(apart) < 4 + len(NAMES):
        raise SystemExit(f"the rasteriser differs from its twin: {', '.join(far) or 'other Gaussians are in view'}")


def _timed(kernels: Any, gaussians: Gaussians, seen_from: Viewpoint, device: torch.device, repeats: int) -> Any:
    """Return the milliseconds of a view, there and back, as training draws it."""
    drawing = Drawing(degree=DEGREE, median=False)
    shown = kernels.rasterise(gaussians, seen_from, drawing)
    given = ViewGradients(torch.ones_like(shown.rgb), torch.ones_like(shown.opacity), torch.ones_like(shown.opacity))
    work: dict[str, Callable[[], object]] = {
        "forward ms": lambda: kernels.rasterise(gaussians, seen_from, drawing),
        "backward ms": lambda: kernels.backward(shown, given),
        "both ms": lambda: kernels.backward(kernels.rasterise(gaussians, seen_from, drawing), given),
    }
    times = {name: float(f"{milliseconds(call, device, repeats):.4g}") for name, call in work.items()}
    return times | {"in view": len(shown.index)}


def _fitted(options: Namespace) -> None:
    """Fit the packed drive for a minute, sparse views, stereo prior; note what it scores."""
    with tempfile.TemporaryDirectory() as folder:
        drive = open_pack(options.pack, Path(folder) / "scenes")
        seconds = min(FIT_S * options.scale, options.deadline - time.time() - SCORING_S)
        if seconds <= 0:
            return note(left_out=f"the fit: {seconds + SCORING_S:.0f} s were left")
        config = FitConfig(ModelConfig("splat"), LossConfig(loss="l1"), seconds=round(seconds, 2))
        if options.device == "cpu":
            drive = replace(drive, test=drive.test[len(drive.test) // 2 :][:1])
            config = replace(config, seconds=None, steps=20)
        last: list[Status] = []
        began = time.perf_counter()

        def keep(status: Status) -> None:
            last[:] = [status]

        model = fit(drive, config, Path(folder) / "run", keep, options.device)
        name = f"fit, {drive.camera.size[1]}x{drive.camera.size[0]}, {last[-1].step} steps"
        figures: dict[str, Any] = {
            "train_s": round(last[-1].elapsed_s, 2),
            "whole_s": round(time.perf_counter() - began, 1),
        }
        note(**{name: figures})
        note(**{name: figures | score(drive, model, options.pack, options.out)})
    return None
