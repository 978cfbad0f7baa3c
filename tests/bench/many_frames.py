"""Memory of drives of many frames: python tests/bench/many_frames.py [--frames 1000 10000] [--home FOLDER]

100 frames of a KITTI raw drive, forth and back, are linked again and again: the files' content is one hundred frames',
their names and poses are those of a long drive. Prints the peak memory of each command at each length, its time, and
what it said of the disk. With a prior the frames' maps are copied and checked too, which takes the longest.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from datetime import datetime, timedelta
from pathlib import Path

DATA = Path(__file__).resolve().parents[3] / "shared/data/kitti_raw_train/2011_09_26/2011_09_26_drive_0009_sync"
START, STEP = datetime(2011, 9, 26, 13, 8, 24), timedelta(seconds=0.1)  # as KITTI writes them


def link(source: Path, out: Path, count: int) -> Path:
    """Link a KITTI raw drive's frames, forth and back, into one of `count` frames; returns it."""
    drive = out / source.parent.name / source.name
    for folder in ("image_02", "image_03", "velodyne_points", "oxts"):
        files = sorted((source / folder / "data").iterdir())
        around = [*files, *files[-2:0:-1]]
        (drive / folder / "data").mkdir(parents=True, exist_ok=True)
        for number in range(count):
            file = around[number % len(around)]
            (drive / folder / "data" / f"{number:010d}{file.suffix}").symlink_to(file.resolve())
        times = "".join(f"{(START + number * STEP).isoformat(' ', 'microseconds')}000\n" for number in range(count))
        for name in (path.name for path in (source / folder).glob("timestamps*.txt")):
            (drive / folder / name).write_text(times, "utf-8")
    (drive / "oxts" / "dataformat.txt").write_bytes((source / "oxts" / "dataformat.txt").read_bytes())
    for calibration in source.parent.glob("calib_*.txt"):
        (drive.parent / calibration.name).write_bytes(calibration.read_bytes())
    return drive


def run(label: str, *words: object) -> None:
    """Run Python with some words and print what it took, and what it said of the disk."""
    began = time.perf_counter()
    given = [sys.executable, *map(str, words)]
    process = subprocess.Popen(given, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    lines = process.stdout.read().splitlines()
    _, status, used = os.wait4(process.pid, 0)
    wall_s, spent_s = time.perf_counter() - began, used.ru_utime + used.ru_stime
    print(f"| {label} | {used.ru_maxrss / 1024:.0f} | {spent_s:.0f} | {wall_s:.0f} |", flush=True)
    for line in lines if status else [line for line in lines if line.startswith("disk:")]:
        print(f"    {line}", flush=True)


def fit(drive: Path, prior: Path | None, steps: int) -> None:
    """Prepare a scene and train a few steps; the held-out views are not rendered, of which there are too many."""
    from nerf.config import FitConfig
    from nerf.run import begin
    from priors import cache
    from priors.drives import open_drive

    guide = None if prior is None else cache.only(prior)
    made = begin(open_drive(drive), guide, fit=FitConfig(steps=steps, seconds=None), folder=drive.parent / "runs" / "a")
    print(made.disk_told, flush=True)
    made.fit("cpu")


def measure(home: Path, source: Path, count: int, asked: argparse.Namespace) -> None:
    drive = link(source, home, count)
    cache, fits = home / "cache", [__file__, "--steps", asked.steps, "--fit", drive]
    shard = f"1/{max(1, count // asked.built)}"  # all frames are planned, and so many computed
    build = ["-m", "cli.priors", "build", drive, "--method", "lidar", "--cache", cache, "--shard", shard]
    run(f"{count} frames: priors build --method lidar --shard {shard}", *build)
    run(f"{count} frames: a fit's scene and {asked.steps} steps, colours alone", *fits)
    if count <= asked.guided:
        shutil.rmtree(home / source.parent.name / "runs")
        run(f"{count} frames: the same with that prior", *fits, "--prior", cache)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--frames", type=int, nargs="+", default=[1000, 10_000])
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--steps", type=int, default=5, help="of each fit")
    parser.add_argument(
        "--home", type=Path, help="where the files go, 20 MB a frame at most; default: a folder of TMPDIR"
    )
    parser.add_argument("--built", type=int, default=1000, help="about so many maps are computed of each drive")
    parser.add_argument("--guided", type=int, default=1000, help="most frames of a fit with a prior")
    parser.add_argument("--fit", type=Path, help="a drive: fit it in this process, with --prior")
    parser.add_argument("--prior", type=Path)
    asked = parser.parse_args()
    if asked.fit is not None:
        fit(asked.fit, asked.prior, asked.steps)
        return
    print("| what | peak MB | processor s | wall s |\n|---|---:|---:|---:|", flush=True)
    for count in asked.frames:
        with tempfile.TemporaryDirectory(dir=asked.home) as home:
            measure(Path(home), asked.data, count, asked)


if __name__ == "__main__":
    main()
