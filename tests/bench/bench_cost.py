"""What a frame costs by method, and a million of them: python tests/bench/bench_cost.py [--data DRIVE] [--frames 6]

Each method builds frames of a drive in this process, one at a time, after a first one that is not counted. Processor
time is that of all threads; bytes are those that the process asked the system to read and write (/proc/self/io), in
the file cache or not. Then what follows of a million frames on some kinds of machines; and the same for fields.
`--price` is what an hour of a core costs you.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from nerf.checkpoint import NAME, spent
from nerf.config import FitConfig
from nerf.prepare import SceneConfig
from nerf.run import begin
from priors import build, methods
from priors.build import Plan
from priors.drives import DriveOptions, open_drive
from priors.machine import threads
from priors.motion import trajectory
from priors.scale.drive_list import DriveEntry
from priors.types import Drive, Method

DATA = Path(__file__).resolve().parents[3] / "shared/data/kitti_raw_train/2011_09_26"
PART = "2011_09_26_drive_0009_sync"
MILLION = 1_000_000
MACHINES = (("a laptop", 4, 2.0), ("a workstation", 16, 3.0), ("a server", 96, 1.25), ("20 servers", 1920, 1.25))
"""Name, cores, and GB/s of all its storage: an SSD, an NVMe disk, file servers on a network of 10 Gbit/s."""
BLOCK_M, WARM_STEPS = 60.0, 5


@dataclass(frozen=True)
class Cost:
    """What something took, or takes a frame."""

    processor_s: float
    read_mb: float
    written_mb: float

    @classmethod
    def now(cls) -> Self:
        """Return what this process has taken so far."""
        lines = dict(line.split(": ") for line in Path("/proc/self/io").read_text("utf-8").splitlines())
        return cls(time.process_time(), int(lines["rchar"]) / 1e6, int(lines["wchar"]) / 1e6)

    def since(self, before: "Cost", count: int) -> "Cost":
        """Return what each of `count` took since then."""
        own, other = vars(self).values(), vars(before).values()
        return Cost(*((mine - theirs) / count for mine, theirs in zip(own, other, strict=True)))


def costs(drive: Drive, method: Method, cache: Path, count: int) -> tuple[Cost, float]:
    """Return what a frame of a method costs, and which processor time of that is reading and decoding its inputs."""
    job = build.prepare(drive, method, folder=cache)
    job.run(Plan([0]), 1)
    before = Cost.now()
    made = job.run(Plan(list(range(1, count + 1))), 1)
    cost = Cost.now().since(before, count)
    assert len(made.built) == count, made.failed
    began = time.process_time()
    for index in range(1, count + 1):
        for what in job.method.reads:
            drive[index].read(what)
    return cost, (time.process_time() - began) / count


def print_methods(drive: Drive, names: Sequence[str], count: int) -> dict[str, Cost]:
    print(f"\nA frame of {drive.name}, {count} frames:\n")
    print("| method | processor s | of it reading inputs | MB read | MB written |\n|---|---:|---:|---:|---:|")
    found = {}
    for name in names:
        with tempfile.TemporaryDirectory() as cache:
            kind, _, value = name.partition("=")
            method_name, _, setting = kind.partition(".")
            given = {setting: value} if setting else {}
            cost, decoding_s = costs(drive, methods.config_type(method_name)(**given), Path(cache), count)
        found[name] = cost
        share = f"{decoding_s / cost.processor_s:.0%}"
        print(f"| {name} | {cost.processor_s:.3f} | {share} | {cost.read_mb:.2f} | {cost.written_mb:.2f} |", flush=True)
    return found


def print_million(found: dict[str, Cost], price: float | None) -> None:
    """Print the bill: core hours, terabytes, hours by machine; what is full first: cores or storage."""
    heads = " | ".join(f"{name}, {cores} cores, {speed:g} GB/s: hours" for name, cores, speed in MACHINES)
    print("\nA million frames:\n")
    bill = "" if price is None else f" at {price:g} an hour |"
    print(f"| method | core hours |{bill} TB read | TB written | {heads} | cores that fill 1.25 GB/s |")
    print("|---|" + "---:|" * (3 + (price is not None) + len(MACHINES) + 1))
    for name, cost in found.items():
        hours = cost.processor_s * MILLION / 3600
        moved_mb = cost.read_mb + cost.written_mb
        cells = [f"{hours:.0f}", *([] if price is None else [f"{hours * price:.0f}"])]
        cells += [f"{cost.read_mb * MILLION / 1e6:.2f}", f"{cost.written_mb * MILLION / 1e6:.2f}"]
        for _, cores, gb_s in MACHINES:
            by_cores, by_storage = hours / cores, moved_mb * MILLION / (1000 * gb_s) / 3600
            full = "storage" if by_storage > by_cores else "cores"
            cells.append(f"{max(by_cores, by_storage):.1f} ({full})")
        cells.append(f"{1250 / moved_mb * cost.processor_s:.0f}")
        print(f"| {name} | {' | '.join(cells)} |")


def print_fields(drive: Drive, count: int, steps: int, budget: int) -> None:
    """Print what the fields of a kilometre cost: frames are prepared once, each block is trained `budget` steps."""
    length_m = float(trajectory(drive).steps_m.sum())
    frames_km = 1000 / length_m * (len(drive) - 1)
    with tempfile.TemporaryDirectory() as home:
        before = Cost.now()
        views, folder = SceneConfig(frames=f"0:{count}"), Path(home) / "runs" / "a"
        run = begin(drive, None, views, FitConfig(steps=WARM_STEPS, seconds=None), folder)
        scene = run.scene
        prepared = Cost.now().since(before, count)
        run.fit("cpu")
        before = Cost.now()
        begin(drive, None, views, FitConfig(steps=steps, seconds=None), folder).fit("cpu")
        step = Cost.now().since(before, steps - WARM_STEPS)
        kept_mb = (run.folder / NAME).stat().st_size / 1e6
        assert spent(run.folder).step == steps
    height, width = scene.camera.size
    blocks = 1000 / BLOCK_M
    print(f"\nFields of {drive.name}, {width}x{height}, {frames_km:.0f} frames a kilometre at its speed:\n")
    print(f"- to prepare a frame: {prepared.processor_s:.3f} s of processor, {prepared.written_mb:.2f} MB written")
    print(f"- a step of {run.config.fit.rays} rays: {step.processor_s * 1000:.1f} ms of processor")
    hours = (frames_km * prepared.processor_s + blocks * budget * step.processor_s) / 3600
    disk_gb, fields_mb = frames_km * prepared.written_mb / 1000, blocks * kept_mb
    print(f"- a kilometre: {blocks:.1f} blocks of {BLOCK_M:g} m, {budget} steps each: {hours:.1f} core hours, ", end="")
    print(f"{disk_gb:.1f} GB of scene, {fields_mb:.0f} MB of checkpoints")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--drive", default=PART)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--methods", nargs="+", default=["lidar", "completion", "stereo", "mono"])
    parser.add_argument("--steps", type=int, default=105, help="of the fit that is timed, 5 of them before it")
    parser.add_argument("--budget", type=int, default=3000, help="steps of a block")
    parser.add_argument("--price", type=float, help="of a core for an hour")
    asked = parser.parse_args()
    entry = DriveEntry(asked.data, part=DriveOptions(drive=asked.drive))
    drive = open_drive(entry.path, entry.dataset, entry.part)
    with threads.limited(threads.count()):
        print_million(print_methods(drive, asked.methods, asked.frames), asked.price)
        print_fields(drive, asked.frames + 4, asked.steps, asked.budget)


if __name__ == "__main__":
    main()
