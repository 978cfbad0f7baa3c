"""What rounding to 8 bits costs in accuracy, on real pairs with truth: stereo networks in two runtimes, in turn.

    ROADPRIOR_CPU=avx512 python tests/bench/bench_int8.py --net cfnet pcwnet --runtimes fp32 int8

The KITTI stereo 2015 pairs that no network of ours was trained on, and that gave no ranges (priors/held_back.py).
"""

import argparse
import statistics
import time
from pathlib import Path

import numpy as np

from priors import codecs
from priors.held_back import is_held_back
from priors.machine import cpu
from priors.nets import runtime

SHARED = Path(__file__).resolve().parents[3] / "shared"
DATA = SHARED / "data/kitti_stereo2015/training"
DRIVE = "kitti_stereo2015_training"
LARGEST_PX = 192


def main() -> None:
    """Print a table."""
    cpu.hold_down()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--net", nargs="+", default=["cfnet", "pcwnet"])
    parser.add_argument("--runtimes", nargs="+", default=["fp32", "int8"], help="the first one is compared with")
    options = parser.parse_args()
    names = sorted(path.name for path in (options.data / "image_2").glob("*_10*") if is_held_back(DRIVE, path.stem))
    print(f"CPU mode {cpu.mode()}, {len(names)} pairs; in brackets the change")
    print("| network | runtime | EPE px | D1 % | AbsRel | ms |\n|---|---|---:|---:|---:|---:|")
    for net in options.net:
        compare(net, options.runtimes, options.data, names)


def compare(net: str, runtimes: list[str], data: Path, names: list[str]) -> None:
    """Print a row for each runtime of a network."""
    ready = {how: runtime.open_net(net, "s", runtime.choose(how, net=net)) for how in runtimes}
    errors: dict[str, list[list[float]]] = {how: [] for how in runtimes}
    seconds: dict[str, list[float]] = {how: [] for how in runtimes}
    for name in names:
        left, right = (runtime.as_bytes(codecs.read_image(data / eye / name)) for eye in ("image_2", "image_3"))
        truth_px = codecs.read_depth_png(data / "disp_occ_0" / f"{Path(name).stem}.png")
        for how in runtimes:
            start = time.perf_counter()
            found = ready[how](left, right, largest_px=LARGEST_PX)
            seconds[how].append(time.perf_counter() - start)
            errors[how].append(score(runtime.as_map(found.disparity_px), truth_px))
    base = np.mean(errors[runtimes[0]], axis=0)
    for how in runtimes:
        mean = np.mean(errors[how], axis=0)
        cells = " | ".join(f"{x:.4f} ({x / b - 1:+.1%})" for x, b in zip(mean, base, strict=True))
        print(f"| {net} | {how} | {cells} | {1e3 * statistics.median(seconds[how]):.0f} |", flush=True)


def score(found_px: np.ndarray, truth_px: np.ndarray) -> list[float]:
    """Return EPE, D1 in per cent, and AbsRel of the depth, over the pixels that have a truth."""
    there = truth_px > 0
    truth, found = truth_px[there], np.maximum(found_px[there], 0.5)
    off = np.abs(found - truth)
    return [off.mean(), 100 * np.mean((off > 3) & (off > 0.05 * truth)), np.abs(truth / found - 1).mean()]


if __name__ == "__main__":
    main()
