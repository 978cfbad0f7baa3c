"""Simulation of a cluster's scheduler: drives without files, a method that sleeps, on this machine's cores.

    python tests/bench/scale.py --rows 1000 10000 100000

Prints, for each number of rows (drive, frame): wall time, time from the start of the build to its first result,
processor time a frame of all processes with Ray and of the local engine on the same frames, and the driver's memory.
Their difference is what the scheduler costs a frame. Starting Ray is told apart.
"""

import argparse
import os
import resource
import sys
import tempfile
import time
from pathlib import Path

from processes import processor_s

FLEET = Path(__file__).resolve().parents[1] / "fleet"
os.environ["ROADPRIOR_EXTENSIONS"] = str(FLEET)
FRAMES = 100
"""Of a drive, at most: 1000 rows are ten drives."""


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def write_drives(folder: Path, rows: int) -> list[Path]:
    drives = []
    while rows > 0:
        drive = folder / f"drive{len(drives):05d}"
        drive.mkdir(parents=True)
        (drive / "counted.txt").write_text(str(min(rows, FRAMES)), "utf-8")
        drives.append(drive)
        rows -= FRAMES
    return drives


def simulate(rows: int, nap_s: float, cpus: int) -> None:
    from priors.methods.fragile import Fragile  # type: ignore[import-not-found]
    from priors.scale.drive_list import DriveEntry
    from priors.scale.here import build_here
    from priors.scale.on_ray import build_on_ray
    from priors.scale.order import Order
    from priors.scale.ray_session import Share
    from priors.scale.tally import Part

    with tempfile.TemporaryDirectory() as home:
        drives = write_drives(Path(home) / "drives", rows)

        def orders(cache: str) -> list[Order]:
            return [Order(DriveEntry(drive, "counted"), Fragile(nap_s), cache=Path(home) / cache) for drive in drives]

        began, first, done = time.perf_counter(), 0.0, 0

        def count(part: Part) -> None:
            nonlocal first, done
            done += part.built
            if part.built and not first:
                first = time.perf_counter() - began

        before = processor_s()
        build_on_ray(orders("ray"), 1, count, Share(1))
        wall_s, spent_s, memory_mb = time.perf_counter() - began, processor_s() - before, peak_mb()
        assert done == rows, f"{done} of {rows} rows built"
        own = time.process_time()
        sample = orders("local")[: max(1, min(10, len(drives)))]
        built = sum(min(FRAMES, rows) for _ in sample)
        build_here(sample, 1, lambda part: None)
        local_ms = 1000 * (time.process_time() - own) / built
    ray_ms = 1000 * spent_s / rows
    print(
        f"{rows:7d} rows of {len(drives):4d} drives: {wall_s:7.1f} s, first result {first:5.1f} s, processor a frame: "
        f"{ray_ms:.2f} ms with Ray, {local_ms:.2f} ms locally, scheduler {ray_ms - local_ms:.2f} ms; "
        f"driver {memory_mb:.0f} MB",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--rows", type=int, nargs="+", default=[1000, 10_000])
    parser.add_argument("--nap-s", type=float, default=0.0)
    parser.add_argument("--cpus", type=int, default=os.cpu_count() or 1)
    asked = parser.parse_args()
    sys.path.insert(0, str(FLEET.parents[1]))
    from priors.scale.ray_session import import_ray

    ray = import_ray()
    began = time.perf_counter()
    passed = {"ROADPRIOR_EXTENSIONS": str(FLEET), "PYTHONPATH": str(FLEET.parents[1])}
    given = {"log_to_driver": False, "logging_level": 40, "runtime_env": {"env_vars": passed}}
    ray.init(num_cpus=asked.cpus, include_dashboard=False, object_store_memory=100 * 2**20, **given)
    print(f"Ray starts in {time.perf_counter() - began:.1f} s on {asked.cpus} cores", flush=True)
    for rows in asked.rows:
        simulate(rows, asked.nap_s, asked.cpus)
    ray.shutdown()


if __name__ == "__main__":
    main()
