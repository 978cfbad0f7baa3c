"""Race: the methods take turns frame by frame, so that a slow moment of the machine slows all of them alike.

Each is scouted first (scout.py), which tells whether it works, and what the race will take. Then each makes a map that
is not counted, and then a map of every frame. What was measured is written after each frame: a bench that was stopped
goes on.
"""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from priors.bench.entrants import Entrant
from priors.bench.judge import Judge
from priors.bench.results import Bench, Standing, Trial, earlier
from priors.bench.schedule import Need, Schedule, schedule
from priors.bench.scout import Scouted, send
from priors.errors import DataError
from priors.machine import cpu, threads
from priors.records import record
from priors.types import Depth, Frame, Method

BUSY = 0.3
"""Share of the cores that others use, above which a machine counts as busy."""
Scout = Callable[[Method, Any, int, float | None], Scouted]


@dataclass(eq=False)
class Runner:
    """An entrant in the race."""

    entrant: Entrant
    standing: Standing
    make: Callable[[Frame], Depth] | None = None
    """Makes a frame's map, once it has warmed up."""


@dataclass(frozen=True)
class Entered:
    """A race that can begin: who takes part, and what it will take."""

    runners: tuple[Runner, ...]
    plan: Schedule
    busy: float
    """As in Bench."""
    ends_s: float
    """When no new round begins, on the clock of time.perf_counter: a machine may be slower than it was scouted."""


@dataclass(frozen=True)
class Race:
    """A bench to be made: `enter`, then `run`."""

    judge: Judge
    entrants: Sequence[Entrant]
    folder: Path
    """The bench's folder."""
    limit_s: float = 600.0
    """How long it may take in all; a map of each is made even so."""
    command: str = ""
    """As typed."""
    scout: Scout = send

    @cached_property
    def asked(self) -> dict[str, Any]:
        """Return what must be equal for two figures to compare."""
        drive, frames = self.judge.drive, self.judge.frames
        return {
            "drive": drive.name,
            "fingerprint": drive.fingerprint(),
            "frames": [drive.ids[index] for index in frames],
            "size": list(drive[frames[0]].camera.size),
            "protocol": None if self.judge.truth is None else asdict(self.judge.protocol),
            "machine": {"cpu": cpu.mode(), "cores": threads.available(), "threads": threads.count()},
        }

    def enter(self, on_scouted: Callable[[str], None] = lambda name: None) -> Entered:
        """Find out who can take part, and what the race will take; told the name of each that was looked at.

        Raises:
            DataError: nobody can.
        """
        began, busy, known, runners = time.perf_counter(), load(), earlier(self.folder, self.asked), []
        frame = self.judge.drive[self.judge.frames[0]]
        for entrant in self.entrants:
            standing = self._standing(entrant, frame)
            if standing.identity in known:
                standing = replace(known[standing.identity], name=entrant.name)
            elif not standing.error:
                self._scout(entrant, standing, self.limit_s - (time.perf_counter() - began))
            runners.append(Runner(entrant, standing))
            on_scouted(entrant.name)
        if all(runner.standing.error for runner in runners):
            raise DataError(f"no entrant can work on {self.judge.drive.name}: {runners[0].standing.error}")
        ends_s = began + self.limit_s
        plan = schedule(self._needs(runners), ends_s - time.perf_counter())
        return Entered(tuple(runners), plan, busy, ends_s)

    def run(self, entered: Entered, on_trial: Callable[[str], None] = lambda name: None) -> Bench:
        """Make the maps, and write what was measured after each frame; told the name of an entrant after each map."""
        bench = Bench(self.asked, tuple(runner.standing for runner in entered.runners), self.command, entered.busy)
        kept = bench.beside(earlier(self.folder, self.asked))
        running = [runner for runner in entered.runners if runner.entrant.name in entered.plan.frames]
        for runner in running:
            self._warm_up(runner)
        for number in range(max(entered.plan.frames.values(), default=0)):
            if number and time.perf_counter() > entered.ends_s:
                break
            for runner in running:
                if number < entered.plan.frames[runner.entrant.name] and runner.make is not None:
                    self._go(runner)
                    on_trial(runner.entrant.name)
            kept.save(self.folder)
        kept.save(self.folder)
        return bench

    def _standing(self, entrant: Entrant, frame: Frame) -> Standing:
        error, identity = entrant.lacks(frame) or "", ""
        try:
            identity = entrant.identity()
        except DataError as reason:
            error = str(reason)
        method = entrant.method
        config = record(method)
        return Standing(entrant.name, entrant.family, entrant.kind, method.name, config, identity, error=error)

    def _scout(self, entrant: Entrant, standing: Standing, left_s: float) -> None:
        if left_s <= 0:
            standing.error = f"no time was left for it in {self.limit_s:.0f} s: give more by --at-most"
            return
        found = self.scout(entrant.method, self.judge.drive, self.judge.frames[0], left_s)
        standing.error, standing.peak_gib = found.error, found.peak_gib
        standing.cold_s, standing.warm_s = found.cold_s, found.warm_s

    def _needs(self, runners: Sequence[Runner]) -> dict[str, Need]:
        """Tell what each has still to do."""
        left = {runner: len(self._left(runner.standing)) for runner in runners if not runner.standing.error}
        return {
            runner.entrant.name: Need(frames, runner.standing.warm_s, runner.standing.cold_s)
            for runner, frames in left.items()
            if frames
        }

    def _left(self, standing: Standing) -> list[int]:
        """Return the frames that an entrant has not made yet."""
        done = {trial.frame for trial in standing.trials}
        return [index for index in self.judge.frames if self.judge.drive.ids[index] not in done]

    def _warm_up(self, runner: Runner) -> None:
        drive = self.judge.drive
        try:
            make = runner.entrant.method.resolve(drive[0]).prepare(drive, self.folder.parent / "weights")
            make(drive[self.judge.frames[0]])
        except DataError as error:
            runner.standing.error = str(error)
        else:
            runner.make = make

    def _go(self, runner: Runner) -> None:
        """Make a map of the next frame, and note what it took and what it is worth."""
        frame = self.judge.drive[self._left(runner.standing)[0]]
        clock = Clock(frame)
        assert runner.make is not None
        try:
            depth = clock.run(runner.make)
        except DataError as error:
            runner.standing.error, runner.make = str(error), None
            return
        metrics = self.judge.metrics(frame, depth, runner.entrant.method.sure_within)
        runner.standing.trials.append(Trial(frame.id, clock.seconds, clock.read_s, clock.processor_s, metrics))


class Clock:
    """Measures what a map takes, and how much of it is reading the frame."""

    def __init__(self, frame: Frame) -> None:
        self.seconds = self.read_s = self.processor_s = 0.0
        readers = {what: self._timed(reader) for what, reader in frame.readers.items()}
        self.frame = replace(frame, readers=readers)

    def run(self, make: Callable[[Frame], Depth]) -> Depth:
        """Make the frame's map."""
        wall, processor = time.perf_counter(), time.process_time()
        depth = make(self.frame)
        self.seconds, self.processor_s = time.perf_counter() - wall, time.process_time() - processor
        return depth

    def _timed(self, reader: Callable[..., Any]) -> Callable[..., Any]:
        def read(*args: Any) -> Any:
            began = time.perf_counter()
            try:
                return reader(*args)
            finally:
                self.read_s += time.perf_counter() - began

        return read


def load() -> float:
    """Return the load of this machine over the last minute for each core this process may use; NaN where unknown."""
    try:
        return os.getloadavg()[0] / threads.available()
    except (OSError, AttributeError):  # no such figure on this system
        return float("nan")
