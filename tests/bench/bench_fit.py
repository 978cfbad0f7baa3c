"""Quality against time on the street, with and without a prior: held-out PSNR and AbsRel after 4, 9, 18 and 36 s.

    python tests/bench/bench_fit.py [--folder DIR] [--times 4 9 18 36]

40 frames of 320x96, stereo prior with the sky cropped; every run is stopped at each time, scored, and resumed, so the
scoring takes no training time. Peak memory is of the whole process.
"""

import argparse
import resource
import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np

from nerf import checkpoint
from nerf.config import FitConfig, ModelConfig
from nerf.fit import Status, fit
from nerf.losses import LossConfig
from nerf.prepare import SceneConfig, open_scene
from nerf.scene import Scene
from priors import build
from priors.drives import open_drive
from priors.filters import Filters
from priors.methods.stereo import Stereo
from priors.street.write import write_street
from priors.types import Drive


class Stop(Exception):
    """The time to score has come."""


def main() -> None:
    """Print one row a run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "bench_fit")
    parser.add_argument("--times", type=float, nargs="+", default=[4.0, 9.0, 18.0, 36.0])
    options = parser.parse_args()
    write_street(options.folder / "street", 40, 7, (96, 320), workers=2)
    drive = open_drive(options.folder / "street")
    filters = Filters(sky="mask")
    prior = build.prepare(drive, Stereo(), filters, options.folder / "cache").run().prior
    warm = open_scene(drive, prior, SceneConfig("sparse"), options.folder / "scenes")
    with tempfile.TemporaryDirectory() as runs:
        fit(warm, FitConfig(ModelConfig("ngp"), steps=5), Path(runs) / "warm")  # compiles
        print(f"{'':24}" + "".join(f"{time:>18g} s" for time in options.times))
        for views in ("dense", "sparse"):
            for made in (None, prior):
                scene = open_scene(drive, made, SceneConfig(views), options.folder / "scenes")
                name = f"{views} {'colours alone' if made is None else 'stereo prior'}"
                figures = curve(scene, drive, Path(runs) / name.replace(" ", "-"), options.times)
                print(
                    f"{name:24}" + "".join(f"{psnr:>10.2f} dB {abs_rel:.3f}" for psnr, abs_rel in figures), flush=True
                )
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB")


def curve(scene: Scene, drive: Drive, run: Path, times: list[float]) -> list[tuple[float, float]]:
    """Train to each time in turn; return the held-out views' mean PSNR (dB) and AbsRel."""
    config = FitConfig(ModelConfig("ngp"), LossConfig(loss="mse"), seconds=times[-1])
    figures = []
    for time in times:

        def stop(status: Status, time: float = time) -> None:
            if status.elapsed_s >= time:
                raise Stop

        with suppress(Stop):
            fit(scene, config, run, stop)
        figures.append(score(scene, drive, run))
    return figures


def score(scene: Scene, drive: Drive, run: Path) -> tuple[float, float]:
    """Render the held-out views; the truth is the street's exact depth up to 80 m."""
    render = checkpoint.open_model(run).render
    psnr, abs_rel = [], []
    for position in scene.test:
        view = render(scene.T_world_cam[position], scene.camera)
        psnr.append(-10 * np.log10(np.mean((np.clip(view.rgb, 0, 1) - scene.images[position] / 255) ** 2)))
        truth_m = drive[position].truth().depth_m
        seen = (truth_m > 0) & (truth_m < 80)
        abs_rel.append(np.mean(np.abs(view.depth_m - truth_m)[seen] / truth_m[seen]))
    return float(np.mean(psnr)), float(np.mean(abs_rel))


if __name__ == "__main__":
    main()
