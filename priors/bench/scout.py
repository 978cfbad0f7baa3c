"""Scout: a method makes one map in a process of its own, so that its time and its peak memory can be told.

The module run as a program, with an errand on stdin, is the other end of `send`. What an entrant lacks, and whether it
works here at all, is known before the bench begins.
"""

import json
import pickle
import re
import resource
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from priors import drives
from priors.bench.fewer_lines import FewerLines
from priors.errors import DataError
from priors.machine import cpu, threads
from priors.machine.memory import keep_freed
from priors.resized import Resized
from priors.types import Drive, Method

RUNS = 2
"""Maps that are made: the first is cold, the last is timed."""
STATUS = Path("/proc/self/status")


@dataclass(frozen=True)
class Errand:
    """What a scout is told, pickled."""

    method: Method
    drive: dict[str, Any]
    """As the drive describes itself."""
    frame: int
    """Index of a frame."""
    threads: int
    share: float = 1.0
    """Of the images' sides that are kept."""
    every: int = 1
    """Which of a sweep's lines are kept: every so many-th."""


@dataclass(frozen=True)
class Scouted:
    """What a scout found."""

    cold_s: float = 0.0
    """Seconds of the first map: weights read, graphs made, compiled functions loaded."""
    warm_s: float = 0.0
    """Seconds of the last one."""
    processor_s: float = 0.0
    """Processor time of the last one, all threads."""
    peak_gib: float = float("nan")
    """Largest resident memory of its process."""
    error: str = ""
    """Why it made none, one line."""


def send(
    method: Method, drive: Drive, frame: int, timeout_s: float | None = None, share: float = 1.0, every: int = 1
) -> Scouted:
    """Let a process of its own make a frame's map; what goes wrong there is told in the answer.

    Args:
        method: how.
        drive: opened again there, as it describes itself.
        frame: index of the frame.
        timeout_s: how long it may take; None: as long as it does.
        share: of the images' sides that are kept.
        every: which of a sweep's lines are kept: every so many-th.
    """
    errand = Errand(method, {"name": drive.name, **drive.describe()}, frame, threads.count(), share, every)
    command = [sys.executable, "-m", __name__]
    try:
        done = subprocess.run(command, input=pickle.dumps(errand), capture_output=True, timeout=timeout_s, check=False)
    except subprocess.TimeoutExpired:
        return Scouted(error=f"it made no map in {timeout_s:.0f} s")
    if done.returncode:
        last = (done.stderr.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
        died = f"killed by signal {-done.returncode}" if done.returncode < 0 else last
        return Scouted(error=f"its process failed: {died}")
    return Scouted(**json.loads(done.stdout.splitlines()[-1]))


def run(errand: Errand) -> Scouted:
    """Make the map, here."""
    drive = drives.reopen(errand.drive)
    if errand.share < 1:
        drive = Resized(drive, errand.share)
    if errand.every > 1:
        drive = FewerLines(drive, errand.every)
    frame, took, processor = drive[errand.frame], [], []
    try:
        with threads.limited(errand.threads), TemporaryDirectory() as folder:
            make = errand.method.resolve(drive[0]).prepare(drive, Path(folder))
            for _ in range(RUNS):
                began, worked = time.perf_counter(), time.process_time()
                make(frame)
                took.append(time.perf_counter() - began)
                processor.append(time.process_time() - worked)
    except DataError as error:
        return Scouted(error=str(error))
    return Scouted(took[0], took[-1], processor[-1], peak_gib())


def peak_gib() -> float:
    """Return the largest resident memory of this program so far, GiB.

    Linux's own figure is of this program alone; getrusage's may be of the one that started it.
    """
    if STATUS.exists() and (found := re.search(r"VmHWM:\s+(\d+) kB", STATUS.read_text("utf-8"))):
        return int(found[1]) / 2**20
    unit = 2**30 if sys.platform == "darwin" else 2**20
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def main() -> None:
    """Do the errand that stands on stdin; print what was found."""
    cpu.hold_down()
    keep_freed()
    errand: Errand = pickle.loads(sys.stdin.buffer.read())
    print(json.dumps(asdict(run(errand))))


if __name__ == "__main__":
    main()
