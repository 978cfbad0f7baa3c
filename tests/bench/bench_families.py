"""Quality at equal processor time: python tests/bench/bench_families.py DRIVE PRIOR [--field ...] [--budgets 16 48 96]

One thread and seconds of processor time, so that other programs change little; `nerf bench` has wall time. Each budget
is a fit of its own: the learning rate falls until just then. PSNR of the held-out views, and AbsRel against the drive's
truth or LiDAR up to 80 m, means over the views. The prior is what `nerf fit` makes of it: checked and aligned before.
`field@count` gives guided rays so many samples.
"""

import argparse
import itertools
import tempfile
import time
from pathlib import Path

from scored import score

from nerf import fields
from nerf.config import FitConfig, ModelConfig
from nerf.evidence.check import check
from nerf.evidence.lidar import sweeps_of
from nerf.model import Model
from nerf.prepare import SceneConfig, open_scene
from nerf.sample import SamplerConfig
from nerf.scene import Scene
from nerf.truths import Truths
from priors import cache
from priors.drives import open_drive
from priors.machine import threads

WARM_STEPS = 3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("drive")
    parser.add_argument("prior", help="a prior's folder, or the cache that has only one")
    parser.add_argument("--field", nargs="+", default=["ngp", "mip360", "nerfpp"])
    parser.add_argument("--budgets", nargs="+", type=float, default=[16, 48, 96])
    parser.add_argument("--views", nargs="+", default=["sparse"])
    parser.add_argument("--only-prior", action="store_true", help="leave out the fits by colours alone")
    parser.add_argument("--seed", nargs="+", type=int, default=[0])
    options = parser.parse_args()
    drive = open_drive(Path(options.drive))
    prior = cache.only(Path(options.prior))
    priors = {prior.name.partition("-")[0]: prior} if options.only_prior else {"none": None, "prior": prior}
    with tempfile.TemporaryDirectory() as folder, threads.limited(1), threads.quiet():
        print(f"{'field':10s}{'views':8s}{'':12s}{'seed':>5s}{'seconds':>8s}{'steps':>7s}{'PSNR dB':>9s}{'AbsRel':>8s}")
        for (label, prior), views in itertools.product(priors.items(), options.views):
            scene = open_scene(drive, prior, SceneConfig(views), Path(folder) / label / views)
            scene = check(scene, sweeps=sweeps_of(drive, scene.ids)).scene
            truths = Truths(drive, [scene.ids[each] for each in scene.test])
            for name, seed, budget_s in itertools.product(options.field, options.seed, options.budgets):
                model, steps = fit(scene, config(name, seed), budget_s)
                psnr, abs_rel = score(scene, truths, model)
                row = f"{name:10s}{views:8s}{label:12s}{seed:5d}{budget_s:8g}{steps:7d}{psnr:9.2f}{abs_rel:8.4f}"
                print(row, flush=True)


def config(name: str, seed: int) -> FitConfig:
    """Return the settings of a field, "mip360" or "mip360@32"."""
    family, _, count = name.partition("@")
    sampler = SamplerConfig(count=int(count)) if count else SamplerConfig()
    return FitConfig(ModelConfig(family, sampler=sampler), seed=seed)


def fit(scene: Scene, config: FitConfig, budget_s: float) -> tuple[Model, int]:
    """Train until the processor time is spent, once all kernels are compiled; returns the model and its steps."""
    family = fields.family(config.model.family)
    warm = family.start(scene, config, "cpu")
    for step in range(WARM_STEPS):
        warm.train(scene, config, step, 0.0)
    begun_s, model, steps = time.process_time(), family.start(scene, config, "cpu"), 0
    while (spent_s := time.process_time() - begun_s) < budget_s:
        model.train(scene, config, steps, spent_s / budget_s)
        steps += 1
    return model, steps


if __name__ == "__main__":
    main()
