"""A long drive as one field, in blocks, and as short drives: python tests/bench/long_drive.py [--frames 300]

A street is written and its LiDAR made a prior; all is kept in the folder --home, and a run that was killed goes on.
Every row spends the same number of steps: one field all of them, blocks and short drives an equal part each. A short
drive is the stretch of one block, fitted as if there were nothing else. All are scored on the same held-out views.
"""

import argparse
import itertools
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from eval.image import mean
from nerf.config import FitConfig, ModelConfig
from nerf.prepare import SceneConfig
from nerf.quality import BEST
from nerf.report import FrameScore, Report
from nerf.run import Run, begin
from priors import build, cache
from priors.drives import open_drive
from priors.methods.lidar import Lidar
from priors.motion import trajectory
from priors.street.write import write_street
from priors.types import Drive

HEAD = """| fitted as | fields | PSNR dB | SSIM | AbsRel | processor s | peak MB |
|---|---:|---:|---:|---:|---:|---:|"""
KINDS = ("one field", "blocks", "short drives")
HELD_OUT = 10
"""Every so many-th frame is held out: stretches that begin at multiples have the held-out views of the whole."""


@dataclass(frozen=True)
class Long:
    """A street that is cut into `parts`, and how it is fitted."""

    home: Path
    parts: int
    steps: int
    """Of each row, all its fields together."""
    family: str
    guided: bool
    seed: int

    @property
    def drive(self) -> Drive:
        return open_drive(self.home / "street")

    def fit(self, kind: str) -> list[Report]:
        """Fit all fields of a row, or go on; returns their reports."""
        count = len(self.drive)
        if kind == "one field":
            return [self._fit("one", FitConfig(steps=self.steps))]
        share = self.steps // self.parts
        if kind == "blocks":
            return [self._fit("blocks", FitConfig(steps=share, blocks_m=length_m(self.drive) / self.parts))]
        borders = [HELD_OUT * round(count * part / self.parts / HELD_OUT) for part in range(self.parts + 1)]
        ranges = [f"{first}:{end}" for first, end in itertools.pairwise(borders)]
        return [self._fit(f"short-{frames.replace(':', '-')}", FitConfig(steps=share), frames) for frames in ranges]

    def _fit(self, name: str, budget: FitConfig, frames: str | None = None) -> Report:
        drive = self.drive
        prior = cache.only(self.home / "cache") if self.guided else None
        config = FitConfig(
            ModelConfig(self.family), steps=budget.steps, seconds=None, seed=self.seed, blocks_m=budget.blocks_m
        )
        guide = "lidar" if self.guided else "colours"
        folder = self.home / "runs" / f"{self.family}-{guide}-{self.steps}-{self.seed}-{name}"
        run: Run = begin(drive, prior, SceneConfig(frames=frames), config, folder)
        if not (folder / "metrics.json").exists():
            run.fit("cpu")
            run.report("cpu")
        return Report.load(folder / "metrics.json")


def length_m(drive: Drive) -> float:
    """Return how long the drive's path is, metres."""
    return float(trajectory(drive).steps_m.sum())


def prepare(home: Path, frames: int, size: tuple[int, int]) -> None:
    """Write the street and its prior where they are not there."""
    write_street(home / "street", frames, 7, size)
    build.prepare(open_drive(home / "street"), Lidar(), folder=home / "cache").run()


def row(kind: str, scores: Sequence[FrameScore], fields: int, spent: str) -> str:
    image = mean([score.image for score in scores])
    depth = [score.depth.metrics()["abs_rel"] for score in scores if score.depth is not None]
    figures = f"{image['psnr']:.2f} | {image['ssim_gauss11']:.4f} | {sum(depth) / len(depth):.4f}"
    return f"| {kind} | {fields} | {figures} | {spent} |"


def measure(long: Long, kind: str) -> None:
    """Fit one row in this process and print it."""
    began = time.process_time()
    reports = long.fit(kind)
    spent_s, peak_mb = time.process_time() - began, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    scores = [score for report in reports for score in report.frames]
    fields = 1 if kind == "one field" else long.parts
    print(row(kind, scores, fields, f"{spent_s:.0f} | {peak_mb:.0f}"), flush=True)
    print("    by view: " + " ".join(f"{score.figures()['psnr']:.1f}" for score in scores), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--home", type=Path, default=Path("long-drive"))
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--size", default="208x64")
    parser.add_argument("--parts", type=int, default=5)
    parser.add_argument("--steps", type=int, nargs="+", default=[5000])
    parser.add_argument("--field", default=BEST)
    parser.add_argument("--colours-alone", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=KINDS, help="one row, in this process")
    asked = parser.parse_args()
    width, height = map(int, asked.size.split("x"))
    if asked.only:
        guided = not asked.colours_alone
        measure(Long(asked.home, asked.parts, asked.steps[0], asked.field, guided, asked.seed), asked.only)
        return
    prepare(asked.home, asked.frames, (height, width))
    given = [sys.executable, __file__, "--home", str(asked.home), "--parts", str(asked.parts), "--field", asked.field]
    given += ["--seed", str(asked.seed), *(["--colours-alone"] if asked.colours_alone else [])]
    for steps in asked.steps:
        guide = "colours alone" if asked.colours_alone else "LiDAR prior"
        print(f"{asked.frames} frames of {asked.size}, {asked.field}, {guide}, {steps} steps a row")
        print(HEAD)
        for kind in KINDS:  # each in a process of its own, so that its memory is its own
            sys.stdout.flush()
            subprocess.run([*given, "--steps", str(steps), "--only", kind], check=True)


if __name__ == "__main__":
    main()
