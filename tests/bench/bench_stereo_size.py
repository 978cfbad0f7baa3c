"""The sizes at which a stereo network sees a pair: error, confidence and processor time of each --stereo.resize.

python tests/bench/bench_stereo_size.py ../shared/data/kitti_stereo2015 --held-back
python tests/bench/bench_stereo_size.py half/2011_09_26/2011_09_26_drive_0009_sync --frames 26 32 38 44 50

One thread; the settings take turns on each frame. Half size: tests/bench/resize.py. Truth: the drive's, else each
frame's own sweep.
"""

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

from priors.codecs import as_grey
from priors.drives import open_drive
from priors.held_back import held_back
from priors.machine import threads
from priors.methods.lidar import Lidar
from priors.methods.stereo import Stereo
from priors.types import FloatMap, Frame

FARTHEST_M = 90.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("drive", type=Path)
    parser.add_argument("--frames", type=int, nargs="+", help="positions in the drive; default: all")
    parser.add_argument("--held-back", action="store_true", help="those that no network was trained on")
    options = parser.parse_args()
    drive = open_drive(options.drive)
    frames = [drive[at] for at in (held_back(drive) if options.held_back else options.frames or range(len(drive)))]
    kinds = {name: Stereo(model="cfnet", resize=name).resolve(frames[0]) for name in ("none", "auto", "fast")}
    kinds = {name: method for name, method in kinds.items() if name == method.resize}
    rows: dict[str, list[list[float]]] = {name: [] for name in kinds}
    sgbm_s = []
    with threads.limited(1):
        for method in kinds.values():
            method(frames[0])  # what is compiled at the first call
        for frame in frames:
            truth_m = frame.truth().depth_m if frame.has("truth") else Lidar(sweeps=1)(frame).depth_m
            truth_m = np.where(truth_m < FARTHEST_M, truth_m, np.float32(0))
            for name, method in kinds.items():
                rows[name].append(measure(method, frame, truth_m))
            sgbm_s.append(time_sgbm(frame))
    print(
        f"{len(frames)} frames of {drive.name}, {frames[0].camera.size[1]} px wide; SGBM {1e3 * np.mean(sgbm_s):.0f} ms"
    )
    print(f"{'':6}{'AbsRel':>8}{'RMSE m':>8}{'D1 %':>7}{'within 1 px':>12}{'stated':>8}{'CPU ms':>8}")
    for name, figures in rows.items():
        rel, rmse, d1, right, stated, seconds = np.mean(figures, axis=0)
        line = f"{rel:8.4f}{rmse:8.3f}{100 * d1:7.2f}{right:12.3f}{stated:8.3f}{1e3 * seconds:8.0f}"
        print(f"{name:6}{line}", flush=True)


def measure(method: Stereo, frame: Frame, truth_m: FloatMap) -> list[float]:
    """Return AbsRel, RMSE, D1, the share within 1 px, the mean confidence, and seconds of processor time."""
    start = time.process_time()
    depth = method(frame)
    seconds = time.process_time() - start
    known = (truth_m > 0) & depth.valid
    ours_m, true_m, reach = depth.depth_m[known], truth_m[known], frame.camera.fx * (frame.baseline_m or np.nan)
    true_px = reach / true_m
    off_px = np.abs(reach / ours_m - true_px)
    d1 = np.mean((off_px > 3) & (off_px > 0.05 * true_px))
    rmse = np.sqrt(np.mean((ours_m - true_m) ** 2))
    return [
        np.mean(np.abs(ours_m / true_m - 1)),
        rmse,
        d1,
        np.mean(off_px <= 1),
        np.mean(depth.trust()[known]),
        seconds,
    ]


def time_sgbm(frame: Frame) -> float:
    """Return the processor time of OpenCV's 3-way matcher on a pair, seconds."""
    left, right = as_grey(frame.image()), as_grey(frame.other())
    most = 16 * max(1, min(192, left.shape[1] // 3) // 16)
    matcher = cv2.StereoSGBM.create(0, most, 3, P1=72, P2=288, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    start = time.process_time()
    matcher.compute(left, right)
    return time.process_time() - start


if __name__ == "__main__":
    main()
