"""Forecast: what a list of fits will take, by a few steps and a view of each kind of them."""

import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from nerf.study import NONE, FitRunner, RunSpec
from priors.errors import DataError

WARM = ".warm"
"""Folder of the fits that nobody scores."""
WARM_STEPS = 3
"""Steps of each: they compile its kernels, and the last is timed."""
SCORED_S = 0.3
"""Seconds to score a rendered view and to write its pictures, about."""


@dataclass(frozen=True)
class Cost:
    """What a fit of one kind takes."""

    step_s: float
    view_s: float
    """To render a view."""
    views: int
    """How many are scored."""

    @property
    def scoring_s(self) -> float:
        """To render and to score all of them."""
        return self.views * (self.view_s + SCORED_S)


@dataclass(frozen=True)
class Forecast:
    """What is left to do."""

    fits: int
    """In all."""
    left: int
    """Those that are not done."""
    training_s: float
    scoring_s: float

    def __str__(self) -> str:
        if not self.left:
            return "no fit is left to do"
        fits = f"{self.fits} fit{'s' * (self.fits > 1)}"
        left = fits if self.left == self.fits else f"{self.left} of {fits}"
        training, scoring = (_duration(seconds) for seconds in (self.training_s, self.scoring_s))
        return f"{left}: {training} of training, about {scoring} of scoring"


def cost(runner: FitRunner, spec: RunSpec, folder: Path) -> Cost:
    """Fit for a few steps and render a view; DataError where nothing is held out, or the fit cannot be made."""
    home = folder / WARM
    shutil.rmtree(home, ignore_errors=True)
    fit = replace(runner.fit, steps=WARM_STEPS, seconds=None)
    run = replace(runner, fit=fit).begin(spec, home)
    times_s = [0.0]
    model = run.fit(runner.device, lambda status: times_s.append(status.step_s))
    scene = run.scene
    if not scene.test:
        raise DataError(f"{scene.name}: none of the {len(scene.ids)} frames is held out: take 10 frames or more")
    views = run.viewpoints()
    view_s = 0.0
    for _ in range(2):  # the first one compiles
        began_s = time.perf_counter()
        model.render(views.T_world_cam[scene.test[0]], views.camera)
        view_s = time.perf_counter() - began_s
    shutil.rmtree(home, ignore_errors=True)
    return Cost(times_s[-1], view_s, len(scene.test))


def forecast(runner: FitRunner, specs: Sequence[RunSpec], left: Sequence[RunSpec], folder: Path) -> Forecast:
    """Say what the runs that are left will take; a kind that cannot be made counts nothing, and is told when it fails.

    Args:
        runner: makes them.
        specs: all of them.
        left: those that are not done.
        folder: the study's.
    """
    costs: dict[tuple[object, ...], Cost] = {}
    training_s = scoring_s = 0.0
    for spec in left:
        kind = (spec.field, spec.loss, spec.prior == NONE)
        try:
            costs[kind] = own = costs.get(kind) or cost(runner, spec, folder)
        except DataError:
            continue
        training_s += (runner.fit.seconds or 0.0) if runner.fit.steps is None else runner.fit.steps * own.step_s
        scoring_s += own.scoring_s
    return Forecast(len(specs), len(left), training_s, scoring_s)


def _duration(seconds: float) -> str:
    return f"{seconds / 3600:.1f} h" if seconds >= 3600 else f"{seconds / 60:.1f} min"
