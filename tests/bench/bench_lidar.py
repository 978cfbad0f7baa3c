"""What the LiDAR method costs and what each part of it buys: python tests/bench/bench_lidar.py [DRIVE] [--frames N].

First the stages' times with the sweeps in memory (medians, interleaved, the images read from disk as in a build), then
error against density for sweeps x tests. Outliers are off by more than 1 m and 5 % of the drive's truth.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from priors.drives import open_drive
from priors.methods import lidar
from priors.methods.lidar import Lidar
from priors.types import Depth, Frame

SHARED = Path(__file__).resolve().parents[3] / "shared"
DRIVE = SHARED / "data/kitti_raw/2011_09_26/2011_09_26_drive_0001_sync"
TESTS = {
    "none": {"occlusion": False, "motion": False, "stereo": False},
    "occlusion": {"motion": False, "stereo": False},
    "motion": {"occlusion": False, "stereo": False},
    "stereo": {"occlusion": False, "motion": False},
    "occlusion motion": {"stereo": False},
    "all": {},
}


def hold(frame: Frame) -> Frame:
    """Return the frame with its sweeps in memory."""
    sweeps = {offset: frame.sweep(offset) for offset in range(-5, 6)}
    return replace(frame, readers={**frame.readers, "sweep": lambda offset=0: sweeps[offset]})


def time_stages(frame: Frame, rounds: int = 15) -> None:
    depth_m = lidar.accumulate(frame, 11)
    fx_px = frame.camera.fx
    stages = {
        "accumulate 11": lambda: lidar.accumulate(frame, 11),
        "accumulate 1": lambda: lidar.accumulate(frame, 1),
        "hidden": lambda: lidar.hidden(depth_m, fx_px),
        "stereo": lambda: lidar.stereo_denies(frame, depth_m),
        "of it: reading images": lambda: (frame.image(), frame.other()),
        "confidence": lambda: lidar.confidence(depth_m, fx_px),
        "whole, no stereo": lambda: Lidar(stereo=False)(frame),
        "whole": lambda: Lidar()(frame),
    }
    taken_s = {name: [] for name in stages}
    cpu_s = {name: [] for name in stages}
    for _ in range(rounds + 1):
        for name, stage in stages.items():
            start, cpu_start = time.perf_counter(), time.process_time()
            stage()
            taken_s[name].append(time.perf_counter() - start)
            cpu_s[name].append(time.process_time() - cpu_start)
    whole = np.median(taken_s["whole"][1:])
    print(f"{'stage':24}{'median ms':>10}{'least':>8}{'CPU ms':>8}{'of whole':>10}")
    for name, seconds in taken_s.items():
        wall, cpu = np.median(seconds[1:]), np.median(cpu_s[name][1:])
        print(f"{name:24}{1e3 * wall:10.1f}{1e3 * min(seconds[1:]):8.1f}{1e3 * cpu:8.1f}{wall / whole:10.2f}")


def score(depth: Depth, truth: Depth) -> tuple[float, float, float]:
    both = depth.valid & truth.valid
    error_m = np.abs(depth.depth_m - truth.depth_m)[both]
    relative = error_m / truth.depth_m[both]
    return float(relative.mean()), float(np.mean((error_m > 1) & (relative > 0.05))), depth.density


def compare(frames: list[Frame]) -> None:
    print(f"\n{'sweeps':>6} {'tests':18}{'AbsRel':>9}{'outliers %':>12}{'density %':>11}{'ms':>8}")
    for count in (1, 3, 5, 11):
        for name, changes in TESTS.items():
            method = Lidar(sweeps=count, **changes)
            rows, taken_s = [], []
            for frame in frames:
                start = time.perf_counter()
                depth = method(frame)
                taken_s.append(time.perf_counter() - start)
                rows.append(score(depth, frame.truth()))
            abs_rel, outliers, density = np.mean(rows, axis=0)
            figures = f"{abs_rel:9.5f}{100 * outliers:12.3f}{100 * density:11.2f}{1e3 * np.median(taken_s):8.1f}"
            print(f"{count:6} {name:18}{figures}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("drive", nargs="?", type=Path, default=DRIVE)
    parser.add_argument("--frames", type=int, default=12)
    options = parser.parse_args()
    drive = open_drive(options.drive)
    every = max(1, len(drive) // options.frames)
    frames = [hold(drive[index]) for index in range(0, len(drive), every)][: options.frames]
    time_stages(frames[len(frames) // 2])
    compare(frames)


if __name__ == "__main__":
    main()
