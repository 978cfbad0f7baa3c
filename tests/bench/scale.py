"""Simulation of a cluster's scheduler: drives without files, a method that sleeps, on this machine's cores.

    python tests/bench/scale.py --rows 1000 10000 100000

Prints, for each number of rows (drive, frame): wall time, time from the start of the build to its first result,
processor time of all processes until then, and a frame after then; that of the local engine on such frames; and the
driver's memory. What a frame takes more than locally is the scheduler's: once it runs, and with its start shared out.
Starting Ray itself is told apart.
"""

import argparse
import os
import resource
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from processes import processor_s

if TYPE_CHECKING:
    from priors.scale.tally import Part

FLEET = Path(__file__).resolve().parents[1] / "fleet"
os.environ["ROADPRIOR_EXTENSIONS"] = str(FLEET)
FRAMES = 100
"""Of a drive, at most: 1000 rows are ten drives."""
HEAD = """| rows | wall s | first result after s | processor s until then | ms a frame after then | locally \
| scheduler, steady | scheduler, with its start | driver MB |
|---:|---:|---:|---:|---:|---:|---:|---:|---:|"""


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


def simulate(rows: int, nap_s: float) -> None:
    from priors.methods.fragile import Fragile  # type: ignore[import-not-found]
    from priors.scale.drive_list import DriveEntry
    from priors.scale.here import build_here
    from priors.scale.on_ray import build_on_ray
    from priors.scale.order import Order
    from priors.scale.ray_session import Share

    with tempfile.TemporaryDirectory() as home:
        drives = write_drives(Path(home) / "drives", rows)

        def orders(cache: str) -> list[Order]:
            return [Order(DriveEntry(drive, "counted"), Fragile(nap_s), cache=Path(home) / cache) for drive in drives]

        began, before = time.perf_counter(), processor_s()
        first = First()
        build_on_ray(orders("ray"), 1, first, Share(1))
        wall_s, spent_s, memory_mb = time.perf_counter() - began, processor_s() - before, peak_mb()
        assert first.done == rows, f"{first.done} of {rows} rows built: {first.failed}"
        own = time.process_time()
        sample = orders("local")[: max(1, min(10, len(drives)))]
        built = sum(min(FRAMES, rows) for _ in sample)
        build_here(sample, 1, lambda part: None)
        local_ms = 1000 * (time.process_time() - own) / built
    started_s = first.processor_s - before
    steady_ms = 1000 * (spent_s - started_s) / max(rows - first.with_it, 1)
    cells = [f"{rows}", f"{wall_s:.1f}", f"{first.at_s - began:.1f}", f"{started_s:.1f}", f"{steady_ms:.2f}"]
    cells += [f"{local_ms:.2f}", f"{steady_ms - local_ms:.2f}", f"{1000 * spent_s / rows - local_ms:.2f}"]
    print(f"| {' | '.join(cells)} | {memory_mb:.0f} |", flush=True)


@dataclass
class First:
    """Notes when the first frame was built, and what had been spent by then."""

    done: int = 0
    with_it: int = 0
    """Frames that were built in the first stretch."""
    at_s: float = 0.0
    processor_s: float = 0.0
    failed: dict[str, str] = field(default_factory=dict)

    def __call__(self, part: "Part") -> None:
        """Count a part."""
        self.done += part.built
        self.failed |= part.failed
        if part.built and not self.with_it:
            self.with_it, self.at_s, self.processor_s = part.built, time.perf_counter(), processor_s()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--rows", type=int, nargs="+", default=[1000, 10_000])
    parser.add_argument("--nap-s", type=float, default=0.0)
    asked = parser.parse_args()
    from priors.scale.ray_session import session

    began = time.perf_counter()
    with session(None):
        print(f"Ray starts in {time.perf_counter() - began:.1f} s on {os.cpu_count()} cores\n\n{HEAD}", flush=True)
        for rows in asked.rows:
            simulate(rows, asked.nap_s)


if __name__ == "__main__":
    main()
