"""What `--reuse N` saves and costs: processor time of a frame and error, by the length of a chain.

    python tests/bench/bench_reuse.py DRIVE
    python tests/bench/bench_reuse.py DRIVE --truth KITTI/depth --model cfnet --lengths 1 2 4 8

Errors are against the truth of the drive, else each frame's own sweep without what the pair contradicts. One thread.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from priors.build.chains import Chains
from priors.drives import DriveOptions, open_drive
from priors.machine import threads
from priors.methods.lidar import Lidar
from priors.methods.stereo import Stereo
from priors.types import Depth, Drive, Earlier, Frame

MOST_CONFIDENT = 0.9228


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("drive", type=Path)
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--model", default="classical")
    parser.add_argument("--frames", type=int, default=51)
    parser.add_argument("--lengths", type=int, nargs="+", default=[1, 2, 4])
    asked = parser.parse_args()
    drive = open_drive(asked.drive, options=DriveOptions(truth=asked.truth))
    with threads.limited(1):
        method = Stereo(model=asked.model).resolve(drive[0])
        truths = [truth_of(drive[index]) for index in range(min(asked.frames, len(drive)))]
        print("| `--reuse` | ms a frame | of 1 | made of the one before | AbsRel | RMSE m | AbsRel, 92 % surest |")
        print("|---:|---:|---:|---:|---:|---:|---:|")
        first = None
        for length in asked.lengths:
            ms, carried, figures = run(drive, method, truths, length)
            first = first or ms
            errors = " | ".join(f"{value:.4f}" for value in figures)
            print(f"| {length} | {ms:.0f} | {ms / first:.2f} | {carried:.0%} | {errors} |", flush=True)


def truth_of(frame: Frame) -> np.ndarray:
    return frame.truth().depth_m if frame.has("truth") else Lidar(sweeps=1).resolve(frame)(frame).depth_m


def run(drive: Drive, method: Stereo, truths: list[np.ndarray], length: int) -> tuple[float, float, np.ndarray]:
    """Return processor time a frame, ms, the share of frames that were carried, and the mean errors."""
    method(drive[0])  # compiles, loads
    before, spent_s, carried, figures = None, 0.0, 0, []
    for step in Chains(drive, length).steps(range(len(truths))):
        frame, start = drive[step.position], time.process_time()
        kept = before is not None and step.position % length
        depth = method.carry_on(frame, before) if kept else None
        carried += depth is not None
        depth = method(frame) if depth is None else depth
        spent_s += time.process_time() - start
        before = Earlier(frame, depth)
        figures.append(errors_of(depth, truths[step.position]))
    return 1e3 * spent_s / len(truths), carried / len(truths), np.mean(figures, axis=0)


def errors_of(depth: Depth, truth_m: np.ndarray) -> tuple[float, float, float]:
    both = depth.valid & (truth_m > 0)
    error_m = np.abs(depth.depth_m - truth_m)[both]
    share = error_m / truth_m[both]
    surest = np.argsort(-depth.trust()[both], kind="stable")[: int(MOST_CONFIDENT * share.size)]
    return float(share.mean()), float(np.sqrt(np.mean(error_m**2))), float(share[surest].mean())


if __name__ == "__main__":
    main()
