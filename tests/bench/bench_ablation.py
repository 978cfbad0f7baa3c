"""What each part of a fit is worth: python tests/bench/bench_ablation.py DATA PRIOR [--field mip360] [--steps 400]

Each row leaves one part out, or does it as an earlier version did, and is fitted anew: one thread, one seed, sparse
views. `ms` is the processor time of a step. Rows of poses (`--poses recorded`) are there where the drive's poses are
not the recorded ones, and `--poses refined` where `--poses-from` names what `priors poses` wrote; their scene has the
same images and the same prior.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scored import fitted

from nerf import fields
from nerf.config import FitConfig, ModelConfig
from nerf.evidence.check import check
from nerf.evidence.lidar import sweeps_of
from nerf.gaussians.config import GaussianConfig
from nerf.losses import LossConfig
from nerf.prepare import SceneConfig, open_scene
from nerf.sample import SamplerConfig
from nerf.scene import Scene
from nerf.truths import Truths
from priors import cache
from priors.drives import DriveOptions, open_drive
from priors.machine import threads
from priors.types import Drive


@dataclass(frozen=True)
class Row:
    """One way to fit."""

    name: str
    sampler: dict[str, Any] = field(default_factory=dict)
    losses: dict[str, Any] = field(default_factory=dict)
    gaussians: dict[str, Any] = field(default_factory=dict)
    fit: dict[str, Any] = field(default_factory=dict)
    align: str = "auto"
    scene: Callable[[Scene], Scene] = lambda scene: scene

    def config(self, family: str, steps: int) -> FitConfig:
        """Return the fit's settings."""
        model = ModelConfig(family, sampler=SamplerConfig(**self.sampler), gaussians=GaussianConfig(**self.gaussians))
        fit = FitConfig(model, LossConfig(**self.losses), steps=steps, seconds=None)
        return replace(fit, align=self.align, **self.fit)


SKIPS_OFF = {"terminate": 0.0, "roulette_samples": 1.0, "roulette_proposals": 1.0, "proposals_every": 1}
SKIPS_OFF |= {"render_proposed": None}
ROWS = [
    Row("default"),
    Row("colours alone", scene=lambda scene: replace(scene, depth_m=None, weight=None, sky=None)),
    Row("--loss none", losses={"loss": "none"}),
    Row("--no-guide", sampler={"guide": False}),
    Row("--no-carve", sampler={"carve": False}),
    Row("--unguided-later 0", sampler={"unguided_later": 0.0}),
    Row("--align none --trim 0", losses={"trim": 0.0}, align="none"),
    Row("--sky-opacity 0 --no-carve-sky", sampler={"carve_sky": False}, losses={"sky_opacity": 0.0}),
    Row("skips off", sampler=SKIPS_OFF),
    Row("--count 32", sampler={"count": 32}),
    Row("--no-appearance", gaussians={"appearance": False}),
    *(Row(f"--rays {rays}", fit={"rays": rays, "rays_growth": 1.0}) for rays in (1024, 2048, 4096)),
]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("prior", type=Path)
    parser.add_argument("--field", nargs="*", default=["mip360"])
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--poses-from", type=Path)
    parser.add_argument("--only", nargs="*", help="rows, by their names without the first dashes")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, threads.limited(1), threads.quiet():
        drive = open_drive(args.data)
        scene = open_scene(drive, cache.only(args.prior), SceneConfig("sparse"), Path(folder) / "scenes")
        print("| field | | PSNR dB | AbsRel | ms |\n|---|---|---:|---:|---:|")
        for family in args.field:
            for row in [*ROWS, *of_poses(args.data, drive, args.poses_from)]:
                if (not args.only or row.name.lstrip("-") in args.only) and tells(row, family):
                    run(drive, scene, row, row.config(family, args.steps))


def of_poses(data: Path, drive: Drive, refined: Path | None) -> list[Row]:
    """Return the rows of a drive's other poses."""
    ways = {"--poses recorded": DriveOptions(poses="recorded")}
    if refined is not None:
        ways["--poses refined"] = DriveOptions(poses="refined", poses_from=refined)
    others = {name: open_drive(data, options=options) for name, options in ways.items()}
    changed = {name: poses_of(other, drive.ids) for name, other in others.items()}
    own = poses_of(drive, drive.ids)
    return [Row(name, scene=seen_from(poses)) for name, poses in changed.items() if not np.array_equal(poses, own)]


def poses_of(drive: Drive, ids: list[str]) -> np.ndarray:
    """Return T_world_cam (n, 4, 4) of frames."""
    places = {frame.id: frame.pose() for frame in (drive[position] for position in range(len(drive)))}
    return np.stack([places[id_] for id_ in ids])


def seen_from(poses: np.ndarray) -> Callable[[Scene], Scene]:
    """Return what gives a scene other poses."""
    return lambda scene: replace(scene, T_world_cam=poses)


def tells(row: Row, family: str) -> bool:
    """Tell whether a row differs from the default in a family: what is not trained has its poses and check alone."""
    if not fields.is_trained(family):
        return row.name == "default" or row.name.startswith(("--poses", "--align"))
    return family != "mip360" or row.name != "--unguided-later 0"  # its proposals keep the share


def run(drive: Drive, scene: Scene, row: Row, config: FitConfig) -> None:
    """Fit a row and print it."""
    family = config.model.family
    scene = row.scene(scene)
    if config.align != "none" and scene.depth_m is not None:
        scene = check(scene, not fields.is_trained(family), sweeps_of(drive, scene.ids)).scene
    truths, times = Truths(drive, [scene.ids[position] for position in scene.test]), [time.process_time()]
    psnr, abs_rel = fitted(scene, truths, config, lambda status: times.append(time.process_time()))
    ms = f"{1e3 * (times[-1] - times[len(times) // 2]) / (len(times) - len(times) // 2 - 1):.1f}" if times[1:] else ""
    print(f"| {family} | {row.name} | {psnr:.2f} | {abs_rel:.4f} | {ms} |", flush=True)


if __name__ == "__main__":
    main()
