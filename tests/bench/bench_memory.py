"""Peak memory of preparing, fitting and rendering a long drive of full-size frames, by its number of frames.

    python tests/bench/bench_memory.py [--frames 100 300 1000] [--size 1242x375] [--steps 200] [--folder DIR]

Four street frames, hard-linked over and over along a straight path, with their exact depth as a dense prior; the
geometry makes no sense, the amounts do. Each number of frames runs in a process of its own; its peak is the largest
resident memory up to then, pages of mapped files included. Needs 3.7 MB of disk a frame.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

SEEDS_OF_FRAMES = 4
SPACING_M = 0.8


def main() -> None:
    """Print one row a number of frames."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, nargs="+", default=[100, 300, 1000])
    parser.add_argument("--size", default="1242x375")
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--one", type=int, help="measure this number of frames in this process")
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(options.folder, options.one, options.steps)))
        return
    home = options.folder or Path(tempfile.mkdtemp(prefix="bench_memory_"))
    width, height = map(int, options.size.split("x"))
    print(f"{options.size}, {options.steps} steps; peak resident memory in GiB, and seconds, after")
    print(f"{'frames':>8} {'files GiB':>10} {'preparing':>15} {'fitting':>15} {'a render':>15}")
    for count in options.frames:
        link(home, count, (height, width))
        command = [sys.executable, __file__, "--one", str(count), "--folder", str(home), "--steps", str(options.steps)]
        row = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        stages = "".join(
            f"{row[stage][0]:>9.2f} {row[stage][1]:>3.0f} s" for stage in ("preparing", "fitting", "render")
        )
        print(f"{count:>8} {row['files']:>10.2f} {stages}", flush=True)
        shutil.rmtree(home / f"run{count}")
    if options.folder is None:
        shutil.rmtree(home)


def link(home: Path, count: int, size: tuple[int, int]) -> None:
    """Make a folder of `count` images and a prior for them out of a few street frames."""
    from priors import cache, codecs
    from priors.drives import open_drive
    from priors.street.write import write_street
    from priors.types import Depth

    street = open_drive(write_street(home / "street", SEEDS_OF_FRAMES, 7, size, workers=2))
    drive = home / f"drive{count}"
    shutil.rmtree(drive, ignore_errors=True)
    (drive / "left").mkdir(parents=True)
    images = [home / f"{i}.png" for i in range(len(street))]
    for path, frame in zip(images, street, strict=True):
        codecs.write_image(path, frame.image())
    ids = [f"{i:06d}" for i in range(count)]
    for i, id_ in enumerate(ids):
        os.link(images[i % len(images)], drive / "left" / f"{id_}.png")
    camera = street[0].camera
    K = {"fx": camera.fx, "fy": camera.K[1, 1], "cx": camera.K[0, 2], "cy": camera.K[1, 2]}
    (drive / "calib.json").write_text(json.dumps(K))
    (drive / "poses.txt").write_text("".join(f"1 0 0 0 0 1 0 0 0 0 1 {SPACING_M * i}\n" for i in range(count)))
    linked = open_drive(drive)
    manifest = {"format": cache.FORMAT, "key": "0" * 10, "method": "truth", "fingerprint": linked.fingerprint()}
    manifest["drive"] = {"name": linked.name, **linked.describe()}
    prior = cache.create(home / "cache" / linked.name / "truth-0", manifest)
    for i, id_ in enumerate(ids):
        if i < len(street):
            truth = street[i].truth()
            prior.write(id_, Depth(truth.depth_m, np.full(size, 0.5, np.float32)), 0.0)
        else:
            source = ids[i % len(street)]
            for place in (prior.depth_path, prior.confidence_path):
                place(id_).unlink(missing_ok=True)
                os.link(place(source), place(id_))


def measure(home: Path, count: int, steps: int) -> dict[str, object]:
    """Prepare, fit, render; return the peak so far (GiB) and the seconds of each, and the size of what is mapped."""
    from nerf.config import FitConfig, ModelConfig
    from nerf.fit import fit
    from nerf.prepare import SceneConfig, open_scene
    from priors import cache
    from priors.drives import open_drive

    row: dict[str, object] = {}
    start = time.perf_counter()

    def note(stage: str) -> None:
        nonlocal start
        row[stage] = (peak_gib(), time.perf_counter() - start)
        start = time.perf_counter()

    run = home / f"run{count}"
    drive = open_drive(home / f"drive{count}")
    scene = open_scene(drive, cache.only(home / "cache" / drive.name), SceneConfig(), run / "scenes")
    note("preparing")
    model = fit(scene, FitConfig(ModelConfig("ngp"), steps=steps, seconds=None), run / "fit")
    note("fitting")
    model.render(scene.T_world_cam[scene.test[0]], scene.camera)
    note("render")
    row["files"] = sum(path.stat().st_size for path in (run / "scenes").rglob("*.npy")) / 2**30
    return row


def peak_gib() -> float:
    """Return this program's largest resident memory so far; unlike getrusage's, not its parent's."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    return int(found[1]) / 2**20 if found else float("nan")


if __name__ == "__main__":
    main()
