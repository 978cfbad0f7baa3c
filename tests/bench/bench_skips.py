"""Processor time of a step and of a view with the skips and without them: python tests/bench/bench_skips.py [FIELD ...]

Two fits of the same seed on a street take their steps in turns, so that what else the machine does hits both. `off` has
none of terminate, roulette_samples, roulette_proposals, proposals_every, carve_sky and sky_opacity; `bare` has no
carving and no guiding either, and `render_proposed` of none. Milliseconds of user and system time; quality is
`nerf bench`'s matter.
"""

import argparse
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from nerf import fields
from nerf.config import FitConfig, ModelConfig
from nerf.losses import LossConfig
from nerf.model import Model
from nerf.prepare import SceneConfig, open_scene
from nerf.sample import SamplerConfig
from nerf.scene import Scene
from priors import build
from priors.drives import open_drive
from priors.machine import threads
from priors.methods.stereo import Stereo
from priors.street.write import write_street

SIZE, FRAMES, STEPS, LAST = (120, 397), 40, 400, 100
OFF = SamplerConfig(terminate=0.0, roulette_samples=1.0, roulette_proposals=1.0, proposals_every=1, carve_sky=False)
WAYS = {"bare": replace(OFF, carve=False, guide=False), "off": OFF, "on": SamplerConfig()}


def street(folder: Path) -> Scene:
    """Write a street and its stereo prior, and prepare them."""
    drive = open_drive(write_street(folder / "street", FRAMES, 7, SIZE))
    prior = build.prepare(drive, Stereo(), folder=folder / "cache").run().prior
    return open_scene(drive, prior, SceneConfig("sparse"), folder / "scenes")


def config(family: str, way: str) -> FitConfig:
    """Return a fit with the skips of a way."""
    losses = LossConfig() if way == "on" else LossConfig(sky_opacity=0.0)
    return FitConfig(ModelConfig(family, sampler=WAYS[way]), losses, steps=STEPS, seconds=None, rays_growth=1.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("fields", nargs="*", default=["ngp", "mip360", "nerfpp"])
    chosen = parser.parse_args().fields
    with tempfile.TemporaryDirectory() as folder, threads.limited(1), threads.quiet():
        scene = street(Path(folder))
        print(f"ms of processor time, means of the last {LAST} of {STEPS} steps; a view of {SIZE[1]}x{SIZE[0]}")
        print(f"{'field':8s} {'way':6s} {'step':>7s} {'ratio':>6s} {'view':>7s}")
        for family in chosen:
            run(scene, family)


def run(scene: Scene, family: str) -> None:
    """Train one model a way, in turns, and print what they cost."""
    configs = {way: config(family, way) for way in WAYS}
    models = {way: fields.family(family).start(scene, each, "cpu") for way, each in configs.items()}
    times: dict[str, list[float]] = {way: [] for way in WAYS}
    for step in range(STEPS):
        for way, model in models.items():
            start = time.process_time()
            model.train(scene, configs[way], step, step / STEPS)
            times[way].append(1e3 * (time.process_time() - start))
    means = {way: statistics.fmean(series[-LAST:]) for way, series in times.items()}
    for way, model in models.items():
        print(f"{family:8s} {way:6s} {means[way]:7.1f} {means[way] / means['on']:6.2f} {view_ms(scene, model):7.0f}")


def view_ms(scene: Scene, model: Model) -> float:
    """Return the least of three renderings of a held-out view."""
    spent = []
    for _ in range(3):
        start = time.process_time()
        model.render(scene.T_world_cam[scene.test[0]], scene.camera)
        spent.append(1e3 * (time.process_time() - start))
    return min(spent)


if __name__ == "__main__":
    main()
