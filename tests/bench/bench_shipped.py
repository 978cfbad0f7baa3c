"""The table that budgets fall back on: times of methods and probes in turn, on each kind of CPU that can be had here.

    python tests/bench/bench_shipped.py --write --machine "2 cores of AMD EPYC (Zen 4)"
    python tests/bench/bench_shipped.py --modes avx2 --rounds 3

Times are processor time of one thread, on a full-size drive and on one at half its size; each is the least of all
rounds, so that other work on the machine shows little. Two frames are timed: the one in which stereo must search the
least, and the one in which it must search the most. Classical stereo has a time for both, stereo's networks that of the
first, which is the usual one, all others the mean. Errors are means over procedural streets (protocol paper), whose
truth is no method's input.
--write puts it where `priors build --budget` reads it: priors/bench/shipped.json.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from eval.files import write_bytes
from eval.protocol import preset
from priors.bench import entrants, shipped
from priors.bench.judge import judge
from priors.bench.probe import KINDS, Probe
from priors.bench.searched import searched
from priors.drives import DriveOptions, open_drive
from priors.errors import DataError
from priors.machine import cpu, threads
from priors.machine.memory import keep_freed
from priors.types import Drive

SHARED = Path(__file__).resolve().parents[3] / "shared"
CLASSICAL = "stereo"
"""A network looks at half the size where it would have to search very far, so its time does not grow in a line."""
FULL = SHARED / "data/kitti_raw_train/2011_09_26/2011_09_26_drive_0009_sync"


def main() -> None:
    """Print the table; write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", type=Path, default=FULL, help="a drive with pairs and sweeps")
    parser.add_argument("--half", type=Path, required="--here" not in sys.argv, help="the same at half the size")
    parser.add_argument("--streets", type=Path, nargs="*", default=[], help="streets for the errors")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--modes", nargs="+", help="kinds of CPU; default: all that this machine can stand in for")
    parser.add_argument("--machine", default="unnamed")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--here", type=Path, help="measure on this drive in this process's mode, print JSON")
    options = parser.parse_args()
    if options.here:
        with threads.limited(1):
            print(json.dumps(measure(options.here, options.rounds)))
        return
    table: dict[str, Any] = shipped.table() if shipped.FILE.is_file() else {"modes": {}, "errors": {}}
    table["machine"] = options.machine
    for mode in options.modes or [mode for mode in cpu.supported() if mode not in ("amx_emulated", "plain")]:
        table["modes"][mode] = [in_process(mode, data, options.rounds) for data in (options.full, options.half)]
        print(mode, json.dumps(table["modes"][mode]), flush=True)
    if options.streets:
        table["errors"] = errors(options.streets)
        print(json.dumps(table["errors"]))
    if options.write:
        write_bytes(shipped.FILE, (json.dumps(table, indent=1) + "\n").encode())


def in_process(mode: str, data: Path, rounds: int) -> dict[str, Any]:
    """Measure a mode in a process of its own."""
    command = [sys.executable, __file__, "--here", str(data), "--rounds", str(rounds)]
    alone = {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", cpu.VARIABLE: mode}
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env={**os.environ, **alone})
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def measure(data: Path, rounds: int) -> dict[str, Any]:
    """Return the pixels of a frame, and the milliseconds that each entrant and probe takes, measured in turn."""
    cpu.hold_down()
    keep_freed()
    drive = open_drive(data, options=DriveOptions())
    makes: dict[str, Any] = {}
    for entrant in entrants.field_size(["auto"]):
        try:
            method = entrant.method.resolve(drive[0])
            method(drive[0])
        except DataError as error:
            print(f"without {entrant.name}: {error}", file=sys.stderr)
        else:
            makes[entrant.name] = method
    probes = {kind: Probe(kind) for kind in KINDS}
    for probe in probes.values():
        probe(drive[0])
    near, far = least_and_most(drive)
    took: dict[str, dict[int, float]] = {name: dict.fromkeys((near, far), float("inf")) for name in (*makes, *probes)}
    for place in rounds * (near, far):
        frame = drive[place]
        for name, make in (makes | probes).items():
            start = time.process_time()
            make(frame)
            took[name][place] = min(took[name][place], 1e3 * (time.process_time() - start))
    height, width = drive[0].camera.size
    mean = {name: round((least[near] + least[far]) / 2, 2) for name, least in took.items()}
    return {
        "pixels": height * width,
        "searched": [round(searched(drive[place]) or 0.0, 4) for place in (near, far)],
        "ms": {name: round(took[name][near], 2) if name.startswith("stereo") else mean[name] for name in makes},
        "ms_far": {CLASSICAL: round(took[CLASSICAL][far], 2)},
        "probes_ms": {name: mean[name] for name in probes},
    }


def least_and_most(drive: Drive) -> tuple[int, int]:
    """Return the frame in which stereo must search the least, and the one in which it must search the most."""
    shares = [searched(drive[index]) or 0.0 for index in range(len(drive))]
    return min(range(len(drive)), key=shares.__getitem__), max(range(len(drive)), key=shares.__getitem__)


def errors(streets: list[Path]) -> dict[str, Any]:
    """Return each entrant's AbsRel and density on streets, means over all frames."""
    found: dict[str, list[dict[str, float]]] = {}
    for street in streets:
        drive = open_drive(street)
        judged = judge(drive, range(len(drive)), 6, preset("paper"), None)
        for entrant in entrants.field_size(["auto"]):
            make = entrant.method.resolve(drive[0])
            for index in judged.frames:
                frame = drive[index]
                found.setdefault(entrant.name, []).append(judged.metrics(frame, make(frame), None))
    keys = ("abs_rel", "density", "density_image")
    return {
        name: {key: round(sum(r[key] for r in rows) / len(rows), 4) for key in keys} for name, rows in found.items()
    }


if __name__ == "__main__":
    main()
