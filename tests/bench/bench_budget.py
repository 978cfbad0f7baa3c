"""Predicted against measured: what the shipped table says of a frame, and what it takes.

    ROADPRIOR_CPU=avx2 python tests/bench/bench_budget.py DRIVE --pairs 5

Probes and methods in turn, processor time of one thread, so that other work on the machine shows little. A figure is
the median over pairs of the prediction by the probes beside it, over the measured time.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from priors.bench import entrants, shipped
from priors.bench.probe import KINDS, work
from priors.bench.searched import usual
from priors.drives import open_drive
from priors.errors import DataError
from priors.machine import cpu, threads
from priors.machine.memory import keep_freed


def main() -> None:
    """Print a line a method."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drive", type=Path)
    parser.add_argument("--pairs", type=int, default=5)
    options = parser.parse_args()
    cpu.hold_down()
    keep_freed()
    with threads.limited(1):
        compare(options.drive, options.pairs)


def compare(path: Path, pairs: int) -> None:
    """Measure in turn."""
    drive = open_drive(path)
    height, width = drive[0].camera.size
    ratios: dict[str, list[float]] = {}
    methods = {}
    for entrant in entrants.field_size(["auto"]):
        try:
            methods[entrant.name] = entrant.method.resolve(drive[0])
            methods[entrant.name](drive[0])
        except DataError as error:
            print(f"without {entrant.name}: {error}")
    for number in range(pairs):
        frame = drive[number * len(drive) // pairs]
        probes = {kind: min(clock(work(kind)) for _ in range(3)) for kind in KINDS}
        predicted = shipped.times_ms(cpu.mode(), height * width, probes, usual(drive))
        if frame.has("sparse"):  # as priors.bench.candidates has it
            predicted |= {name: ms - predicted["lidar"] for name, ms in predicted.items() if "completion" in name}
        for name, method in methods.items():
            ratios.setdefault(name, []).append(predicted[name] / clock(lambda run=method, on=frame: run(on)))
    print(f"{cpu.mode()}, {drive.name}, {width}x{height}, {pairs} pairs: predicted / measured")
    for name, found in ratios.items():
        print(f"{name:24s} {np.median(found):5.2f}", flush=True)


def clock(run: Callable[[], object]) -> float:
    """Return the processor time of a call, ms."""
    start = time.process_time()
    run()
    return 1e3 * (time.process_time() - start)


if __name__ == "__main__":
    main()
