"""A training step of Gaussians by stages: milliseconds of processor time on one thread, and the plain twin beside.

    python tests/bench/bench_splat.py [--gaussians 105000] [--size 397x120] [--degree 0] [--rounds 15]
    ROADPRIOR_CPU=avx2 python tests/bench/bench_splat.py

The scene is made up: discs as large as 1.2 pixels of the view, 3 to 60 m away, half of them behind the camera. The
least of several rounds is told, in processor time: what else the machine does counts little. The twin draws a hundredth
of the Gaussians in a sixteenth of the image. Errors are those of the picture and the gradients against the twin.
"""

import argparse
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from nerf.gaussians.types import NAMES, Drawing, Gaussians, Rates, SplatMoments, ViewGradients, Viewpoint
from nerf.kernels.cpu import splat, splat_blend, splat_project, splat_unblend, splat_unproject
from nerf.kernels.plain import splat as plain
from priors.machine import cpu, memory, threads
from priors.types import Camera

SIZES = (1, 4, 9, 16)


def scene(n: int, viewpoint: Viewpoint, coefficients: int, size_px: float = 1.2) -> Gaussians:
    """Return n flat discs on both sides of a camera."""
    random = torch.Generator().manual_seed(0)
    K, (h, w) = viewpoint.camera.K, viewpoint.camera.size
    z, u, v, side = (torch.rand(n, generator=random) for _ in range(4))
    z = torch.exp(z * math.log(20)) * 3
    x, y = (1.05 * u * w - K[0, 2]) / K[0, 0] * z, (1.05 * v * h - K[1, 2]) / K[1, 1] * z
    means_m = torch.stack([x, y, torch.where(side < 0.5, -z, z)], 1).float()
    along = torch.log(size_px * z / K[0, 0]) + torch.rand(n, generator=random) - 0.5
    log_scales = torch.stack([along, along + torch.rand(n, generator=random), along - 1.9], 1).float()
    colours = torch.rand(n, coefficients, 3, generator=random) - 0.5
    return Gaussians(means_m, log_scales, torch.randn(n, 4, generator=random), torch.full((n,), 1.4), colours)


def viewpoint(width: int, height: int) -> Viewpoint:
    """Return a camera as wide as KITTI's."""
    K = np.array([[0.58 * width, 0, width / 2], [0, 0.58 * width, height / 2], [0, 0, 1]])
    return Viewpoint(Camera(K, (height, width)), np.eye(4))


def least_ms(work: Callable[[], object], rounds: int) -> float:
    """Return the least processor time of several calls."""
    found = []
    for _ in range(rounds):
        start = time.process_time()
        work()
        found.append(time.process_time() - start)
    return 1e3 * min(found)


def stages(gaussians: Gaussians, seen_from: Viewpoint, drawing: Drawing, rounds: int) -> dict[str, float]:
    """Return the milliseconds of each stage, and those of whole calls."""
    size = seen_from.camera.size
    shown = splat.rasterise(gaussians, seen_from, drawing)
    truth = torch.rand(*size, 3)
    given = ViewGradients(splat.colour_loss(shown.rgb, truth, 0.2).d_rgb, torch.randn(size))
    gradients = splat.backward(shown, given)
    moments = SplatMoments(gaussians.zeros(), gaussians.zeros(), torch.ones(len(gaussians)))
    kept = shown.kept
    chunks, regions = len(kept.view.found), len(kept.regions.first_member) - 1
    parts = np.random.default_rng(0).normal(size=int(kept.lists.copies[-1]) * splat.RECORD).astype(np.float32)
    flat = [x.numpy().reshape(-1) for x in gradients.of.tensors().values()]
    out = splat.Derivatives._make([*flat, gradients.screen.numpy(), np.empty(6 * chunks)])
    wanted = splat.Wanted(*(x.numpy().reshape(-1) for x in (given.rgb, given.depth_sum)), np.empty(0, np.float32))

    def project() -> None:
        kept.view.copies[:], kept.view.entries[:] = 0, 0
        splat_project.project(kept.scene, kept.lens, kept.view, 0, chunks)

    with splat.scratch(kept.most) as own:
        arrays = kept.view, kept.regions, kept.rules, own, kept.picture
        work: dict[str, Callable[[], Any]] = {
            "project": project,
            "draw": lambda: splat_blend.draw(*arrays, 0, regions),
            "undraw": lambda: splat_unblend.undraw(*arrays, wanted, parts, 0, regions),
            "unproject": lambda: splat_unproject.unproject(
                kept.scene, kept.lens, kept.view, kept.lists, parts, out, 0, chunks
            ),
            "rasterise": lambda: splat.rasterise(gaussians, seen_from, drawing),
            "loss": lambda: splat.colour_loss(shown.rgb, truth, 0.2),
            "backward": lambda: splat.backward(shown, given),
            "adam": lambda: splat.adam(gaussians, gradients, moments, Rates(0, 0, 0, 0, 0, 0), 1),
        }
        found = {name: least_ms(function, rounds) for name, function in work.items()}
    found["step"] = sum(found[name] for name in ("rasterise", "loss", "backward", "adam"))
    tiles = kept.regions.ends.reshape(regions, -1)[:, -1].sum()
    print(f"{len(shown.index)} of {len(gaussians)} in view, {16 * tiles / math.prod(size):.0f} a pixel's tile")
    return found


def beside_twin(args: argparse.Namespace, drawing: Drawing) -> dict[str, float]:
    """Return how many times as long the twin takes, and how far from it we are: shares of the largest values."""
    seen_from = viewpoint(args.width // 4, args.height // 4)
    gaussians = scene(args.gaussians // 100, seen_from, SIZES[drawing.degree])
    given = ViewGradients(torch.randn(*seen_from.camera.size, 3))

    def both(kernels: Any) -> Any:
        shown = kernels.rasterise(gaussians, seen_from, drawing)
        return shown, kernels.backward(shown, given)

    (ours, d_ours), (theirs, d_theirs) = both(splat), both(plain)
    found = {"twin, times as long": least_ms(lambda: both(plain), 1) / least_ms(lambda: both(splat), 5)}
    found["picture"] = share(ours.rgb, theirs.rgb)
    return found | {name: share(getattr(d_ours.of, name), getattr(d_theirs.of, name)) for name in NAMES}


def share(ours: torch.Tensor, theirs: torch.Tensor) -> float:
    """Return the norm of a difference as a share of the twin's."""
    return float(torch.linalg.vector_norm(ours - theirs) / torch.linalg.vector_norm(theirs))


def main() -> None:
    """Run the benchmark."""
    cpu.hold_down()
    memory.keep_freed()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gaussians", type=int, default=105_000)
    parser.add_argument("--size", default="397x120")
    parser.add_argument("--degree", type=int, default=0)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--json", type=Path, help="write the figures here too")
    args = parser.parse_args()
    args.width, args.height = (int(x) for x in args.size.split("x"))
    drawing, seen_from = Drawing(degree=args.degree, median=False), viewpoint(args.width, args.height)
    with threads.limited(1):
        print(f"CPU mode {cpu.mode()}, one thread, {args.size}, degree {args.degree}")
        found = stages(scene(args.gaussians, seen_from, SIZES[args.degree]), seen_from, drawing, args.rounds)
        for name, value in found.items():
            print(f"{name:10} {value:8.2f} ms")
        errors = beside_twin(args, drawing)
    for name, value in errors.items():
        print(f"{name:20} {value:.2g}")
    if args.json:
        args.json.write_text(json.dumps(found | errors))


if __name__ == "__main__":
    main()
