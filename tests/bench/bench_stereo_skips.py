"""What stereo leaves out, and what that changes: python tests/bench/bench_stereo_skips.py [DRIVE] [--threads 1]

Rows of sky and disparities that no surface reaches, on and off in turn: processor time of a frame, and how far the
depths differ below the sky. Off searches 192 disparities of KITTI's width, as many of another, in every row.
"""

import argparse
import time
from contextlib import ExitStack
from pathlib import Path
from unittest.mock import patch

import numpy as np

from priors.drives import open_drive
from priors.machine import threads
from priors.methods import stereo
from priors.methods.stereo import Stereo
from priors.plan.skips import USUAL_SEARCH
from priors.selection import pick_middles
from priors.sky import sky_mask
from priors.types import Depth, Frame

SHARED = Path(__file__).resolve().parents[3] / "shared"
DRIVE = SHARED / "data/kitti_raw_train/2011_09_26/2011_09_26_drive_0009_sync"
WAYS = {"both": (), "no rows": ("rows",), "no disparities": ("disparities",), "neither": ("rows", "disparities")}


def make(method: Stereo, frame: Frame, off: tuple[str, ...]) -> tuple[Depth, float]:
    """Return a frame's map with some skips off, and its processor time, ms."""
    usual_px = round(USUAL_SEARCH * frame.camera.size[1] / 16) * 16
    with ExitStack() as patched:
        if "rows" in off:
            patched.enter_context(patch.object(stereo, "rows_below", lambda sky: slice(0, sky.shape[0])))
        if "disparities" in off:
            patched.enter_context(patch.object(stereo, "find_range", lambda frame, pair: usual_px))
        start = time.process_time()
        depth = method(frame)
        return depth, 1e3 * (time.process_time() - start)


def main() -> None:
    """Print a line a way."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drive", nargs="?", type=Path, default=DRIVE)
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--models", nargs="+", default=["classical", "cfnet"])
    options = parser.parse_args()
    drive = open_drive(options.drive)
    with threads.limited(options.threads):
        for model in options.models:
            method = Stereo(model, offset_px=(0.0,)).resolve(drive[0])
            method(drive[0])
            report(method, [drive[index] for index in pick_middles(range(len(drive)), options.frames)])


def report(method: Stereo, frames: list[Frame]) -> None:
    """Measure the ways in turn."""
    took: dict[str, list[float]] = {way: [] for way in WAYS}
    off_by: dict[str, list[float]] = {way: [] for way in WAYS}
    for frame in frames:
        made = {way: make(method, frame, off) for way, off in WAYS.items()}
        ground = ~sky_mask(frame.image())
        whole_m = made["neither"][0].depth_m[ground]
        for way, (depth, ms) in made.items():
            took[way].append(ms)
            off_by[way].append(float(np.mean(np.abs(depth.depth_m[ground] / whole_m - 1) > 0.01)))
    for way in WAYS:
        ratio = np.median(np.array(took["neither"]) / took[way])
        print(
            f"{method.model:10s} {way:15s} {np.median(took[way]):7.1f} ms  {ratio:5.2f} times as fast as without;"
            f" {np.mean(off_by[way]):.2%} of the ground differs by more than 1 %"
        )


if __name__ == "__main__":
    main()
