"""A node dies in the middle of a build: python tests/bench/killed_node.py [--drives 12] [--frames 20] [--method stereo]

A street is written and cut into drives. They are built by the local engine, on a Ray cluster of two nodes of this
machine, and on such a cluster of which one node is killed with SIGKILL, all its processes at once, when a third of the
frames are built. Prints times, whether the maps are the same bytes, and how many frames were made twice. Needs the
extra `cluster`; --home keeps the street.
"""

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

from processes import below, kill, processor_s, spent_s

from priors import methods
from priors.build.work import CLAIMS
from priors.scale.drive_list import DriveEntry
from priors.scale.here import build_here
from priors.scale.on_ray import build_on_ray
from priors.scale.order import Order
from priors.scale.ray_session import Share, import_ray
from priors.scale.tally import Part
from priors.street.write import write_street

ROOT = Path(__file__).resolve().parents[2]
Took: TypeAlias = tuple[float, float]
"""Wall and processor time, seconds."""
CORES = 1
"""Of a node; each process of the build has them all."""


def cut(source: Path, out: Path, frames: int, count: int) -> list[Path]:
    """Link a KITTI raw drive's files into drives of so many frames each."""
    made = []
    for number in range(count):
        drive = out / f"{number:02d}" / "street" / f"street_{number:04d}_sync"
        own = range(number * frames, (number + 1) * frames)
        for path in source.parent.rglob("*"):
            if path.is_file() and (not path.stem.isdigit() or int(path.stem) in own):
                inside = path.is_relative_to(source)
                link = drive / path.relative_to(source) if inside else drive.parent / path.relative_to(source.parent)
                link.parent.mkdir(parents=True, exist_ok=True)
                if not link.exists():
                    os.link(path, link)
        made.append(drive)
    return made


@dataclass
class Killer:
    """Ends a node's processes once so many frames are built."""

    after: int
    cache: Path
    raylet: int = 0
    built: int = 0
    in_hand: int | None = None
    """Frames that the node was computing; None: it lives."""
    spent_s: float = 0.0
    """Processor time of what was ended."""

    def __call__(self, part: Part) -> None:
        """Count a part."""
        self.built += part.built
        if self.built < self.after or self.in_hand is not None:
            return
        ended = [*below(self.raylet), self.raylet]
        self.spent_s = spent_s(ended)
        kill(ended)
        self.in_hand = sum(owner(path) in ended for path in self.cache.glob(f"*/*/{CLAIMS}/[!.]*"))


def owner(claim: Path) -> int | None:
    try:
        return int(json.loads(claim.read_text("utf-8"))["pid"])
    except (OSError, ValueError, KeyError):
        return None


@dataclass
class Built:
    """What a build came to."""

    name: str
    maps: dict[str, bytes]
    twice: int
    """Lines of journals beyond one a frame."""
    wall_s: float
    processor_s: float
    failed: dict[str, str] = field(default_factory=dict)

    def row(self, local: "Built") -> str:
        same = "yes" if self.maps == local.maps else "NO"
        return (
            f"| {self.name} | {len(self.maps)} | {same} | {self.twice} | {self.wall_s:.1f} | {self.processor_s:.1f} |"
        )


def timed(work: Callable[[], None]) -> Took:
    """Return the wall and processor time of some work, of this process and those below it that live."""
    began, before = time.perf_counter(), processor_s()
    work()
    return time.perf_counter() - began, processor_s() - before


def build(name: str, cache: Path, run: Callable[[Callable[[Part], None]], Took]) -> Built:
    shutil.rmtree(cache, ignore_errors=True)
    failed: dict[str, str] = {}

    def note(part: Part) -> None:
        failed.update(part.failed | ({"drive": part.error} if part.error else {}))

    wall_s, took_s = run(note)
    maps = {str(path.relative_to(cache)): path.read_bytes() for path in sorted(cache.glob("*/*/depth/*.png"))}
    lines = Counter[str]()
    for journal in cache.glob("*/*/frames.jsonl"):
        lines.update(f"{journal} {json.loads(line)['id']}" for line in journal.read_text("utf-8").splitlines())
    return Built(name, maps, sum(lines.values()) - len(lines), wall_s, took_s, failed)


def on_two_nodes(orders: list[Order], note: Callable[[Part], None], killer: Killer | None = None) -> Took:
    """Build on a cluster of two nodes of this machine; its own start is not timed."""
    from ray.cluster_utils import Cluster

    given = {"num_cpus": CORES, "object_store_memory": 100 * 2**20, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=given)
    try:
        node = cluster.add_node(num_cpus=CORES, object_store_memory=100 * 2**20)
        cluster.wait_for_nodes()
        if killer is not None:
            killer.raylet = node.all_processes["raylet"][0].process.pid

        def tell(part: Part) -> None:
            note(part)
            if killer is not None:
                killer(part)

        wall_s, took_s = timed(lambda: build_on_ray(orders, 1, tell, Share(CORES), cluster.address))
        return wall_s, took_s + (killer.spent_s if killer else 0.0)
    finally:
        cluster.shutdown()


def measure(home: Path, frames: int, drives: list[Path], method: str) -> None:
    total = frames * len(drives)

    def orders(cache: str) -> list[Order]:
        how = methods.config_type(method)()
        return [Order(DriveEntry(drive), how, cache=home / cache) for drive in drives]

    build_here(orders("warm")[:1], 1, lambda part: None)  # what is compiled is compiled then
    local = build(
        "local, one frame at a time",
        home / "local",
        lambda note: timed(lambda: build_here(orders("local"), 1, note)),
    )
    whole = build("Ray, two nodes", home / "ray", lambda note: on_two_nodes(orders("ray"), note))
    killer = Killer(total // 3, home / "killed")
    killed = build(
        "Ray, one of two nodes killed", home / "killed", lambda note: on_two_nodes(orders("killed"), note, killer)
    )
    print(f"{len(drives)} drives x {frames} frames, {method}; nodes of {CORES} core")
    print("| engine | maps | same bytes | made twice | wall s | processor s |\n|---|---:|---|---:|---:|---:|")
    for each in (local, whole, killed):
        print(each.row(local))
        for id_, why in each.failed.items():
            print(f"    failed: {id_}: {why}")
    hand = killer.in_hand
    print("the node was not killed: too few frames" if hand is None else f"in hand on the node that was killed: {hand}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--home", type=Path, help="folder to work in; its street/ is used again")
    parser.add_argument("--drives", type=int, default=12)
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--method", default="stereo")
    asked = parser.parse_args()
    os.environ["PYTHONPATH"] = str(ROOT)
    import_ray()
    with tempfile.TemporaryDirectory() as temporary:
        home = (asked.home or Path(temporary)).absolute()
        if not list(home.glob("street/*/*_sync")):
            write_street(home / "street", asked.frames * asked.drives, 7, (64, 208))
        source = next(home.glob("street/*/*_sync"))
        measure(home, asked.frames, cut(source, home / "drives", asked.frames, asked.drives), asked.method)
    sys.stdout.flush()


if __name__ == "__main__":
    main()
