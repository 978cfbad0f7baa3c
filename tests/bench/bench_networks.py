"""Stereo: error, time and memory of every preset and of named peers, in one interleaved run.

    python tests/bench/bench_networks.py --data DRIVE --truth KITTI/depth
    python tests/bench/bench_networks.py ... --psmnet psmnet.py --psmnet-weights pretrained_model_KITTI2015.tar

Prints a table and draws the error-time plot. Times are of the method alone, images in memory, contestants in turn; the
ratio is the median over pairs of runs that stood side by side. Memory is the largest resident size of a process of its
own that makes one map. Errors are against the drive's truth, uncapped, mean over images: from the images alone, with
KITTI's usual offset, and with the one that the first frame's LiDAR sweep gives (docs/methods/stereo.md).
"""

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scatter import Dot, write_scatter
from stereo_contestants import Contestant, contestants, moved

from eval.protocol import preset
from eval.result import score
from priors.drives import DriveOptions, open_drive
from priors.nets.weights import FOLDER
from priors.types import Frame

SHARED = Path(__file__).resolve().parents[3] / "shared"
DRIVE = SHARED / "data/kitti_raw/2011_09_26/2011_09_26_drive_0001_sync"
PLOT = Path(__file__).resolve().parents[2] / "docs/images/stereo_error_time.png"
COLUMNS = ("density", "abs_rel", "sq_rel", "rmse", "epe", "d1")


def main() -> None:
    """Print the table, write the plot."""
    options = parse()
    drive = open_drive(options.data, options=DriveOptions(truth=options.truth))
    frames = [drive[index] for index in range(len(drive)) if drive[index].has("truth")][: options.frames]
    frames = [in_memory(frame) for frame in frames or [drive[0]]]
    everyone = contestants(options.weights, options.runtimes, options.psmnet, options.psmnet_weights)
    if options.only:
        run = next(c for c in everyone if c.name == options.only).run
        run(frames[0])
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)
        return
    peaks = {c.name: peak_gib(c.name) for c in everyone}
    seconds = measure(everyone, frames, options.rounds)
    print("| method | ms | of SGBM | peak GiB | density | AbsRel | SqRel m | RMSE m | EPE px | D1 % |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|")
    dots = []
    for contestant in everyone:
        name = contestant.name
        ratio = np.median([a / b for a, b in zip(seconds[name], seconds["SGBM full"], strict=False)])
        cells = [f"{1e3 * np.median(seconds[name]):.0f}", f"{ratio:.2f}", f"{peaks[name]:.2f}"]
        figures = errors(contestant, frames)
        print(row(name, cells, figures), flush=True)
        for kind, other in moved(contestant, frames[0]).items():
            shifted = errors(other, frames)
            figures = shifted if kind == "usual" else figures
            print(row(f"{name}, {kind} offset", ["", "", ""], shifted), flush=True)
        error = figures.get(options.error, np.nan)
        dots.append(Dot(name, 1e3 * float(np.median(seconds[name])), error, contestant.family))
    if all(np.isfinite(dot.error) for dot in dots):
        title = f"{drive.name}, {len(frames)} pairs, KITTI's usual offset"
        write_scatter(options.plot, dots, options.error_name, title)
        print(f"\nwrote {options.plot}")


def parse() -> argparse.Namespace:
    """Read the flags."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DRIVE)
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--frames", type=int, default=12, help="frames to score")
    parser.add_argument("--rounds", type=int, default=5, help="timings of each")
    parser.add_argument("--runtimes", nargs="+", default=["auto"], help="of ours: auto, bf16, fp32, onnx, cuda")
    parser.add_argument("--weights", type=Path, default=FOLDER, help="folder of weights; default: what ships")
    parser.add_argument("--psmnet", type=Path, help="psmnet.py of the peer")
    parser.add_argument("--psmnet-weights", type=Path)
    parser.add_argument("--error", default="abs_rel", choices=COLUMNS[1:])
    parser.add_argument("--plot", type=Path, default=PLOT)
    parser.add_argument("--only", help="run this one once and print its peak memory")
    options = parser.parse_args()
    names = {"abs_rel": "AbsRel", "sq_rel": "SqRel (m)", "rmse": "RMSE (m)", "epe": "EPE (px)", "d1": "D1 (%)"}
    options.error_name = names[options.error]
    return options


def in_memory(frame: Frame) -> Frame:
    """The frame with its images read, so that only the method is timed."""
    image, other = frame.image(), frame.other()
    return replace(frame, readers={**frame.readers, "image": lambda: image, "other": lambda: other})


def measure(everyone: Sequence[Contestant], frames: Sequence[Frame], rounds: int) -> dict[str, list[float]]:
    """Return the seconds of each, contestants in turn, after one run that is not counted; a slow one runs once."""
    seconds: dict[str, list[float]] = {contestant.name: [] for contestant in everyone}
    for count in range(rounds + 1):
        frame = frames[count % len(frames)]
        for contestant in everyone:
            if contestant.once and count != 1:
                continue
            start = time.perf_counter()
            contestant.run(frame)
            if count:
                seconds[contestant.name].append(time.perf_counter() - start)
    return seconds


def errors(contestant: Contestant, frames: Sequence[Frame]) -> dict[str, float]:
    """Score the maps of all frames; a slow contestant's of the first only. Empty without truth."""
    scored = [frame for frame in frames if frame.has("truth")][: 1 if contestant.once else None]
    if not scored:
        return {}
    assert scored[0].baseline_m is not None
    maps = (
        (frame.id, (depth := contestant.run(frame)).depth_m, depth.confidence, frame.truth().depth_m)
        for frame in scored
    )
    return score(maps, preset("uncapped"), scored[0].camera.fx * scored[0].baseline_m).metrics("image")


def row(name: str, cells: list[str], figures: dict[str, float]) -> str:
    """Return a line of the table."""
    kinds = {"density": ".1%", "rmse": ".3f", "d1": ".2f", "epe": ".3f", "sq_rel": ".3f"}
    cells = cells + [format(figures.get(column, np.nan), kinds.get(column, ".4f")) for column in COLUMNS]
    return f"| {name} | " + " | ".join(cells) + " |"


def peak_gib(name: str) -> float:
    """Return the largest resident memory of a process that makes one map, GiB."""
    command = [sys.executable, __file__, *sys.argv[1:], "--only", name]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()[-1])


if __name__ == "__main__":
    main()
