"""How a fit's step grows with its work: processor time and peak memory, each point a process of its own.

The module run as a program, with an errand on stdin, is the other end of `send`.
"""

import json
import pickle
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from nerf.config import FitConfig
from nerf.fit import Status
from nerf.study import FitRunner, RunSpec
from priors import drives
from priors.bench.scout import Scouted, peak_gib
from priors.bench.sweep import Growth, Measured
from priors.errors import DataError
from priors.machine import cpu, threads
from priors.machine.memory import keep_freed

Axis = Literal["rays", "samples", "table", "frames"]
AXES: tuple[Axis, ...] = get_args(Axis)
NAMES: dict[Axis, str] = {
    "rays": "rays in a step",
    "samples": "samples of a ray",
    "table": "rows of a level",
    "frames": "training views",
}
RAYS = (256, 512, 1024, 2048, 4096)
SAMPLES = (8, 16, 32, 64)
LOG2_ROWS = (13, 15, 17, 19)
VIEWS = ("1/16", "1/8", "1/4", "1/2", "dense")
COLD, STEPS = 10, 40
"""Steps of a fit, and how many of them, the first ones, are not counted: they compile and fill caches."""


@dataclass(frozen=True)
class Errand:
    """What a process is told, pickled."""

    drive: dict[str, Any]
    """As the drive describes itself."""
    spec: RunSpec
    fit: FitConfig
    frames: str | None
    threads: int


@dataclass(frozen=True)
class Answer:
    """What it found."""

    processor_s: float = 0.0
    """Processor time of a step, all threads: the median."""
    peak_gib: float = float("nan")
    """Largest resident memory of its process."""
    views: int = 0
    """Training views."""
    error: str = ""
    """Why there is no step, one line."""


def sweep(
    axis: Axis,
    runner: FitRunner,
    specs: Sequence[RunSpec],
    on_point: Callable[[str], None] = lambda name: None,
    ask: "Callable[[Errand], Answer] | None" = None,
) -> list[Growth]:
    """Measure how the step of each kind of fit grows along an axis, in turn from point to point.

    Args:
        axis: what grows.
        runner: whose drive, frames and usual settings they are.
        specs: the kinds of fits: fields, priors, losses.
        on_point: told the name of a fit after each point.
        ask: measures a point; default: a process of its own.

    Raises:
        DataError: nothing could be measured.
    """
    found: dict[str, list[Measured]] = {}
    errors: dict[str, str] = {}
    drive = {"name": runner.drive.name, **runner.drive.describe()}
    for x, changed, fit in (point for spec in specs for point in points(axis, spec, runner.fit)):
        name = replace(changed, views=specs[0].views).name
        answer = (ask or send)(Errand(drive, changed, fit, runner.frames, threads.count()))
        if answer.error:
            errors.setdefault(name, answer.error)
        else:
            told = Scouted(processor_s=answer.processor_s, peak_gib=answer.peak_gib)
            found.setdefault(name, []).append(Measured(float(answer.views if axis == "frames" else x), told))
        on_point(name)
    if not found:
        raise DataError(f"--sweep {axis}: {next(iter(errors.values()), 'nothing to measure')}")
    return [Growth(name, tuple(found.get(name, ())), errors.get(name, "")) for name in {**found, **errors}]


def points(axis: Axis, spec: RunSpec, fit: FitConfig) -> list[tuple[float, RunSpec, FitConfig]]:
    """List the points of a kind of fit: the work (of frames, 0: the run tells it), and the run with so much of it.

    All steps of a run have as many rays.
    """
    fit = replace(fit, rays_growth=1.0)
    if axis == "rays":
        return [(n, spec, replace(fit, rays=n)) for n in RAYS]
    if axis == "frames":
        return [(0.0, replace(spec, views=views), fit) for views in VIEWS]
    if axis == "table":
        return [(2.0**n, spec, replace(fit, model=replace(fit.model, log2_size=n))) for n in LOG2_ROWS]
    sampler = fit.model.sampler
    each = [(n, replace(sampler, count=n, proposed=n, free=max(48, n))) for n in SAMPLES]
    return [(float(n), spec, replace(fit, model=replace(fit.model, sampler=own))) for n, own in each]


def send(errand: Errand) -> Answer:
    """Let a process of its own make a fit; what goes wrong there is told in the answer."""
    command = [sys.executable, "-m", __name__]
    done = subprocess.run(command, input=pickle.dumps(errand), capture_output=True, check=False)
    if done.returncode:
        last = (done.stderr.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
        return Answer(error=f"its process failed: {last}")
    return Answer(**json.loads(done.stdout.splitlines()[-1]))


def run(errand: Errand) -> Answer:
    """Make a fit of a few steps, here."""
    times_s: list[float] = []

    def on_step(status: Status) -> None:
        times_s.append(time.process_time())

    fit = replace(errand.fit, steps=COLD + STEPS, seconds=None)
    try:
        with threads.limited(errand.threads), tempfile.TemporaryDirectory() as folder:
            begun = FitRunner(drives.reopen(errand.drive), fit, errand.frames, "cpu").begin(
                errand.spec, Path(folder) / "run"
            )
            begun.fit("cpu", on_step)
            views = len(begun.scene.train)
    except DataError as error:
        return Answer(error=str(error))
    if len(times_s) <= COLD + 1:
        return Answer(error=f"{errand.spec.field} takes no steps: leave it out")
    return Answer(float(np.median(np.diff(times_s)[COLD:])), peak_gib(), views)


def main() -> None:
    """Do the errand that stands on stdin; print what was found."""
    cpu.hold_down()
    keep_freed()
    print(json.dumps(asdict(run(pickle.loads(sys.stdin.buffer.read())))))


if __name__ == "__main__":
    main()
