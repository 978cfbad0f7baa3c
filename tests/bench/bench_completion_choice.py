"""What completion's choice of depths is worth: the classical fill, the network alone, and with its choice.

python tests/bench/bench_completion_choice.py ../shared/data/kitti_stereo2015 --held-back
python tests/bench/bench_completion_choice.py .../2011_09_26_drive_0009_sync --frames 26 31 36 41 46

Each frame's own raw sweep is filled. Truth: the drive's, of all lines, fewer, and 500 points; else the points that are
held out, a fifth of them at random and every fifth line, but for those that a stereo match denies. One thread.
"""

import argparse
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from priors.drives import open_drive
from priors.held_back import held_back
from priors.learn.accumulated_lidar import own_scene
from priors.learn.lidar_dropout import Density, drop_points, own_m
from priors.learn.lidar_scene import splat
from priors.machine import threads
from priors.methods._completion_choice import ENTRY
from priors.methods.completion import Completion
from priors.methods.lidar import stereo_denies
from priors.nets import weights
from priors.types import FloatMap, Frame

SHOWN = Density(), Density(every=2), Density(every=4), Density(every=8), Density(points=500)
FARTHEST_M = 90.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("drive", type=Path)
    parser.add_argument("--frames", type=int, nargs="+", help="positions in the drive; default: all")
    parser.add_argument("--held-back", action="store_true", help="those that no network was trained on")
    options = parser.parse_args()
    drive = open_drive(options.drive)
    at = held_back(drive) if options.held_back else options.frames or range(len(drive))
    with tempfile.TemporaryDirectory() as folder, threads.limited(1):
        alone = Path(shutil.copy(weights.find("mffnet", "s", None), folder))
        weights.rewrite_about(alone, **{ENTRY: None})
        methods = {
            "classical": Completion(),
            "network alone": Completion(model="mffnet", weights=alone),
            "with the choice": Completion(model="mffnet"),
        }
        rows: dict[tuple[str, str], list[list[float]]] = {}
        for frame in (drive[number] for number in at):
            for shown, sparse_m, truth_m in split(frame):
                for name, method in methods.items():
                    rows.setdefault((shown, name), []).append(measure(method, frame, sparse_m, truth_m))
    print(f"{'':18}{'':16}{'AbsRel':>8}{'RMSE m':>8}{'MAE m':>8}{'CPU ms':>8}")
    for (shown, name), figures in rows.items():
        rel, rmse, mae, seconds = np.mean(figures, axis=0)
        print(f"{shown:18}{name:16}{rel:8.4f}{rmse:8.3f}{mae:8.3f}{1e3 * seconds:8.0f}")


def split(frame: Frame) -> Iterator[tuple[str, FloatMap, FloatMap]]:
    """Yield what is shown of a frame's sweep: what it is called, the samples and the truth, metres, 0 = none."""
    if frame.has("truth"):
        scene = own_scene(frame, frame.truth().depth_m, "")
        for density in SHOWN:
            yield str(density), drop_points(scene, np.random.default_rng(0), density).sparse_m, scene.truth_m
        return
    scene = own_scene(frame, np.zeros(frame.camera.size, np.float32), "")
    own = own_m(scene)
    if frame.has("other"):
        own[stereo_denies(frame, np.where(own > 0, own, np.float32(np.inf)))] = 0
    fifth = np.random.default_rng(1).random(len(scene.points_m)) < 0.2
    for name, out in (("a fifth", fifth), ("every fifth line", scene.beam % 5 == 2)):
        sparse_m, held_m = splat(scene.points_m[~out], scene.camera), splat(scene.points_m[out], scene.camera)
        yield name, sparse_m, np.where((held_m > 0) & (sparse_m == 0), own, np.float32(0))


def measure(method: Completion, frame: Frame, sparse_m: FloatMap, truth_m: FloatMap) -> list[float]:
    """Return AbsRel, RMSE, MAE, and seconds of processor time."""
    start = time.process_time()
    depth_m = method.fill(sparse_m, frame.image(), frame.camera, frame.T_cam_lidar).depth_m
    seconds = time.process_time() - start
    known = (depth_m > 0) & (truth_m > 0) & (truth_m < FARTHEST_M)
    error_m = np.abs(depth_m[known] - truth_m[known])
    return [
        float(np.mean(error_m / truth_m[known])),
        float(np.sqrt(np.mean(error_m**2))),
        float(error_m.mean()),
        seconds,
    ]


if __name__ == "__main__":
    main()
