"""Make what lies here, with the code of commit 36e3991; README.md says how.

python make.py thin STREET OUT    a street of `priors street`, with fewer frames and points
python make.py fit                fits/finished and fits/stopped, on street/ and maps/
"""

import shutil
import sys
from pathlib import Path

import numpy as np

KEPT = {
    "image_02/data": range(10),
    "image_03/data": range(3),
    "oxts/data": range(10),
    "velodyne_points/data": range(3),
    "proj_depth/groundtruth/image_02": (0, 1, 2, 9),  # the frames with maps, and the view that is held out
    "proj_depth/velodyne_raw/image_02": range(3),
}
"""Folder of a drive -> the frames that stay."""
POINTS = 800
STEPS = 6


def thin(street: Path, out: Path) -> None:
    """Copy a street: few frames, and few points of each sweep."""
    drive = next(street.glob("*_sync"))
    frames = [path for kind, kept in KEPT.items() for n in kept for path in (drive / kind).glob(f"{n:010d}.*")]
    for path in sorted([*frames, *street.glob("calib_*.txt"), *drive.glob("*/timestamps.txt")]):
        place = out / path.relative_to(street)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, place)
    for path in out.rglob("*.bin"):
        points = np.fromfile(path, "<f4").reshape(-1, 4)
        x, y, z = points[:, :3].T
        ahead = np.flatnonzero((x > 3) & (np.abs(y) < x) & (np.abs(z) < 0.4 * x))
        few = np.sort(np.random.default_rng(int(path.stem)).choice(ahead, POINTS, replace=False))
        points[few].tofile(path)


def fit() -> None:
    """Fit two small runs, one to its end, one stopped half way: the command has no flag for the grid's size."""
    from safetensors.torch import load_file, save_file

    from cli.report import LpipsArguments, report_run
    from nerf.fit import FitConfig, fit
    from nerf.losses import LossConfig
    from nerf.model import ModelConfig, SamplerConfig
    from nerf.run import RunConfig, claim
    from priors import cache
    from priors.drives import open_drive
    from priors.filters import Filters

    def stop(status: object) -> None:
        if status.step == STEPS // 2:
            raise KeyboardInterrupt

    drive = open_drive(Path("street"))
    prior = cache.only(next(Path("maps").glob("*/lidar-*")))
    sampler = SamplerConfig(count=16, free=32, reach=0.2)
    model = ModelConfig(log2_size=4, finest=32, width=16, sampler=sampler)
    losses = LossConfig(loss="kl", sigma_share=0.1)
    config = FitConfig(model=model, losses=losses, rays=64, steps=STEPS, seconds=None, seed=3)
    asked = RunConfig(drive.describe(), str(prior.folder.resolve()), None, "dense", Filters(clip=60.0), config)
    for name in ("finished", "stopped"):
        run = claim(Path("fits") / name, asked)
        scene = run.scene(drive)
        try:
            fit(scene, config, run.folder, *([stop] if name == "stopped" else []))
            report_run(run, LpipsArguments(), scene, drive, device="cpu")
        except KeyboardInterrupt:
            print(f"{name} after {STEPS // 2} steps")
    learned = load_file("fits/finished/checkpoint.safetensors")
    field = {name: tensor for name, tensor in learned.items() if name.startswith("model.field.")}
    save_file(field, "fits/finished/field.safetensors")


if __name__ == "__main__":
    thin(*map(Path, sys.argv[2:])) if sys.argv[1] == "thin" else fit()
