"""What a wrong prior costs a field: python tests/bench/bench_wrong.py DATA PRIOR [--field mip360] [--wrong "x 2"]

A right prior's maps are made wrong in several ways, and a fit takes them as they are (none) or after the check (auto).
PSNR and AbsRel are means over the held-out views, against the drive's truth or else its LiDAR. One thread; the same
seed gives the same figures.
"""

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scored import fitted

from nerf import fields
from nerf.config import Align, FitConfig, ModelConfig
from nerf.evidence.check import check
from nerf.prepare import SceneConfig, open_scene
from nerf.scene import Scene
from nerf.stress import spoilt
from nerf.truths import Truths
from priors import cache
from priors.drives import open_drive
from priors.machine import threads

DRIFT = 0.2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("prior", type=Path)
    parser.add_argument("--field", nargs="*", default=[name for name in fields.names() if fields.is_trained(name)])
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--wrong", nargs="*", choices=list(WRONG), default=list(WRONG))
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, threads.limited(1), threads.quiet():
        drive = open_drive(args.data)
        scene = open_scene(drive, cache.only(args.prior), SceneConfig("sparse"), Path(folder) / "scenes")
        truths = Truths(drive, [scene.ids[position] for position in scene.test])
        alone = replace(scene, depth_m=None, weight=None, sky=None)
        print("| field | prior | align | PSNR dB | AbsRel |\n|---|---|---|---:|---:|")
        for family in args.field:
            row(alone, truths, (family, "colours alone", "none"), args.steps)
            for kind in args.wrong:
                wrong = WRONG[kind](scene)
                for align in ("none", "auto", "learn") if kind == "drift" else ("none", "auto"):
                    row(wrong, truths, (family, kind, align), args.steps)


def row(scene: Scene, truths: Truths, case: tuple[str, str, Align], steps: int) -> None:
    """Fit one case (field, prior, align) and print its row."""
    family, _, align = case
    if align != "none":
        scene = check(scene).scene
    config = FitConfig(ModelConfig(family), steps=steps, seconds=None, align=align)
    psnr, abs_rel = fitted(scene, truths, config)
    print(f"| {' | '.join(case)} | {psnr:.2f} | {abs_rel:.4f} |", flush=True)


def drifting(scene: Scene) -> Scene:
    """Let the scale go up and down by DRIFT along the frames."""
    depth_m = spoilt.depths(scene)
    along = 1 + DRIFT * np.sin(2 * np.pi * np.arange(len(depth_m)) / len(depth_m))
    return spoilt.with_depth(scene, depth_m * along[:, None, None].astype(np.float32))


WRONG: dict[str, Callable[[Scene], Scene]] = {
    "right": spoilt.scaled(1.0),
    "x 0.5": spoilt.scaled(0.5),
    "x 2": spoilt.scaled(2.0),
    "30 % x 10": spoilt.at_random,
    "30 % x 10, blobs": spoilt.in_blobs,
    "30 % x 0.1": partial(spoilt.at_random, factor=0.1),
    "30 % x 0.1, blobs": partial(spoilt.in_blobs, factor=0.1),
    "drift": drifting,
}

if __name__ == "__main__":
    main()
