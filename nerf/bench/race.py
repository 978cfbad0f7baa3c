"""Race: the fits of a bench take turns from mark to mark, so that a slow moment of the machine slows all alike.

Every kernel is compiled before the clock starts. A curve that was made with the same settings is not made again; a fit
that was killed between two marks is begun anew, for what it had spent is not known.
"""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from eval.protocol import ScoreError
from nerf import checkpoint
from nerf.bench.curve import Curve, Entrant, Point, load
from nerf.bench.lap import Lap, go
from nerf.bench.marks import READY, Mark
from nerf.forecast import Cost, Forecast, cost
from nerf.run import Run, forget
from nerf.study import FitRunner
from priors.errors import DataError

START = Point(READY, 0, 0.0, 0.0, 0.0)
"""Nothing is spent."""


@dataclass
class Race:
    """The entrants of a bench, and how far each has come."""

    runner: FitRunner
    """Begins the fits; its own settings are each entrant's."""
    folder: Path
    """The bench's folder: a folder a fit in it."""
    entrants: Sequence[Entrant]
    curves: list[Curve] = field(init=False)
    _runs: dict[str, Run] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.curves = [load(self.folder / each.name, each, self._config(each)) for each in self.entrants]

    def warm_up(self) -> Forecast:
        """Compile what the fits need, a few steps and a view of each kind, and say what is left to do."""
        training_s = scoring_s = 0.0
        costs: dict[tuple[object, ...], Cost] = {}
        for curve in self.curves:
            spec = curve.entrant.spec
            kind = (spec.field, spec.loss, spec.prior == "none", curve.entrant.variant)
            if curve.is_done:
                continue
            try:
                costs[kind] = own = costs.get(kind) or self._cost(curve.entrant)
                _ = self._run(curve.entrant).scene  # what cannot be is told before the first fit
            except DataError as error:
                curve.error = str(error)
                continue
            before = curve.points[-1].mark.amount if curve.points else 0
            last = curve.entrant.marks[-1]
            training_s += (last.amount - before) * (1 if last.unit == "s" else own.step_s)
            scoring_s += (len(curve.entrant.marks) - len(curve.points)) * own.scoring_s
        left = sum(not curve.is_done for curve in self.curves)
        return Forecast(len(self.curves), left, training_s, scoring_s)

    def run(self, on_point: Callable[[Curve], None] = lambda curve: None) -> list[Curve]:
        """Take all fits to all their marks; a fit that fails is told in its curve, and the others go on."""
        turns = max((len(each.marks) for each in self.entrants), default=0)
        for turn in range(turns):
            for curve in sorted(self.curves, key=lambda curve: curve.entrant.spec.seed):
                while not curve.is_done and len(curve.points) <= turn:
                    try:
                        self._advance(curve)
                    except (DataError, ScoreError) as error:
                        curve.error = str(error)
                    on_point(curve)
        return self.curves

    def _advance(self, curve: Curve) -> None:
        """Take a fit to its next mark, and score it there."""
        entrant, run = curve.entrant, self._run(curve.entrant)
        before = curve.points[-1] if curve.points else START
        if checkpoint.spent(run.folder).step != before.step:
            forget(run.folder)  # it was killed on its way, or its curve is gone
            curve.points.clear()
            before = START
        point = self._lap(run, entrant.marks[len(curve.points)], before)
        config = self._config(entrant)
        report = run.report(self.runner.device, self.runner.lpips, {"name": entrant.name, "config": config})
        curve.points.append(replace(point, metrics=report.metrics()))
        curve.save(run.folder, config)

    def _lap(self, run: Run, mark: Mark, before: Point) -> Point:
        """Train to a mark; returns what is spent by then."""
        _ = run.scene  # reading the drive's files is none of a fit's work
        if mark == READY:
            began_s, processor_s = time.perf_counter(), time.process_time()
            run.fit(self.runner.device)
            return Point(mark, 0, time.perf_counter() - began_s, 0.0, time.process_time() - processor_s)
        with self.runner.watch(f"{run.name} to {mark}") as watch:
            lap = Lap(mark, before.step == 0, watch)
            go(run, self.runner.device, lap)
        if lap.status is None:
            raise DataError(f"{run.folder}: the fit ended before {mark}: delete the folder and begin anew")
        prepared_s, processor_s = before.prepared_s + lap.prepared_s, before.processor_s + lap.processor_s
        return Point(mark, lap.status.step, prepared_s, lap.status.elapsed_s, processor_s)

    def _run(self, entrant: Entrant) -> Run:
        """Begin an entrant's run, or return it: its scene is opened once."""
        if entrant.name not in self._runs:
            runner = replace(self.runner, fit=entrant.config)
            self._runs[entrant.name] = runner.begin(entrant.spec, self.folder / entrant.name)
        return self._runs[entrant.name]

    def _cost(self, entrant: Entrant) -> Cost:
        """Return what a fit of an entrant's kind takes."""
        return cost(replace(self.runner, fit=entrant.fit), entrant.spec, self.folder)

    def _config(self, entrant: Entrant) -> dict[str, Any]:
        """Return everything that decides a curve, as JSON holds it."""
        spec = asdict(entrant.spec) | {"prior": entrant.spec.prior_name}  # a cache may move: the name holds its key
        lpips = None if self.runner.lpips is None else self.runner.lpips.net
        settings = replace(self.runner, fit=entrant.config).settings | {"lpips": lpips}
        marks = [asdict(mark) for mark in entrant.marks]
        config = {"spec": spec, "fit": asdict(entrant.config), "marks": marks, "variant": entrant.variant, **settings}
        return json.loads(json.dumps(config, allow_nan=False))
