"""One process with two threads against two with one each: python tests/bench/two_processes.py [--drive D --prior P]

Equal rays a step altogether. The runs take turns, so that other load meets both. Prints the wall time of a step (the
median over stretches of 20 steps, the first left out), the loss curves beside each other, and whether two runs of two
processes are the same bits. Without --drive a small street is written, and its LiDAR made a prior.
"""

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file

from nerf import checkpoint, journal
from priors import build
from priors.drives import open_drive
from priors.methods.lidar import Lidar
from priors.street.write import write_street

LAUNCH = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m", "cli.nerf", "--"]
ALONE = ["-m", "cli.nerf"]


@dataclass(frozen=True)
class Setting:
    """What all runs have in common."""

    home: Path
    drive: Path
    prior: Path
    rays: int
    """Of a step, all processes together."""
    steps: int

    def run(self, name: str, processes: int) -> tuple[Path, float]:
        """Fit, and return the run's folder and its processor time; no view is held out: nothing is rendered."""
        folder = self.home / "runs" / name
        words = ["fit", self.drive, "--prior", self.prior, "--frames", "0:9", "--rays", self.rays // processes]
        words += ["--steps", self.steps, "--threads", 2 // processes, "--device", "cpu", "--run", folder]
        command = [sys.executable, *(ALONE if processes == 1 else LAUNCH), *map(str, words)]
        before = spent_s()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env={**os.environ})
        return folder, spent_s() - before


def spent_s() -> float:
    """Return the processor time of all processes that were started here and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def step_ms(lines: list[dict[str, Any]]) -> list[float]:
    """Return the time of a step in each stretch of a journal but the first."""
    pairs = list(pairwise(lines))[1:]
    return [1000 * (now["seconds"] - before["seconds"]) / (now["step"] - before["step"]) for before, now in pairs]


def state(run: Path) -> dict[str, torch.Tensor]:
    return load_file(run / checkpoint.NAME)


def measure(setting: Setting, turns: int) -> None:
    runs: dict[int, list[Path]] = {1: [], 2: []}
    spent: dict[int, list[float]] = {1: [], 2: []}
    for turn in range(turns):
        for processes, made in runs.items():
            folder, took_s = setting.run(f"{processes}-{turn}", processes)
            made.append(folder)
            spent[processes].append(took_s)
    print(f"{setting.rays} rays a step, {setting.steps} steps, {turns} turns\n")
    print("| processes x threads | ms a step | processor s of a run | same bits each time |\n|---|---:|---:|---|")
    for processes, made in runs.items():
        times = [ms for run in made for ms in step_ms(journal.read(run))]
        first, *others = map(state, made)
        same = all(torch.equal(first[name], other[name]) for other in others for name in first)
        took = f"{statistics.median(times):.1f} | {statistics.median(spent[processes]):.1f}"
        print(f"| {processes} x {2 // processes} | {took} | {'yes' if same else 'NO'} |")
    print("\n| step | loss of one | loss of two | PSNR of one | PSNR of two |\n|---:|---:|---:|---:|---:|")
    for one, two in zip(journal.read(runs[1][0]), journal.read(runs[2][0]), strict=True):
        print(f"| {one['step']} | {one['loss']:.5f} | {two['loss']:.5f} | {one['psnr']:.2f} | {two['psnr']:.2f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--drive", type=Path)
    parser.add_argument("--prior", type=Path)
    parser.add_argument("--rays", type=int, default=1024)
    parser.add_argument("--steps", type=int, default=120)
    parser.add_argument("--turns", type=int, default=2)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        home = Path(temporary)
        drive, prior = asked.drive, asked.prior
        if drive is None:
            drive, prior = home / "street", home / "cache"
            write_street(drive, 10, 7, (64, 208))
            build.prepare(open_drive(drive), Lidar(), folder=prior).run()
        measure(Setting(home, drive, prior, asked.rays, asked.steps), asked.turns)


if __name__ == "__main__":
    main()
