"""Study: a grid of runs over one drive.

    <study>/<run>/...         a run each: nerf.run, nerf.report
           /table.md ...      nerf.study_table

A run whose metrics.json holds the config that is asked for is done; the others are made. So a killed study goes on,
and a study that asks for more makes what is new.
"""

import itertools
import json
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Protocol, cast

from eval.lpips import Lpips
from eval.protocol import ScoreError
from nerf.asked import RunConfig
from nerf.config import FitConfig
from nerf.fields import is_trained
from nerf.fit import OnStep
from nerf.guide import open_guide
from nerf.losses import DepthLoss, DepthMean
from nerf.prepare import ProgressBar, SceneConfig, silent
from nerf.quality import BEST
from nerf.report import Report
from nerf.run import Run, claim
from nerf.split import in_name
from priors.errors import DataError, UsageError
from priors.filters import Filters, Sorts
from priors.records import upgrade
from priors.types import Drive

NONE = "none"
"""The prior of a run by colours alone."""
SHARES = ("clip", "confidence", "keep", "density")
"""The choices that are numbers."""


@dataclass(frozen=True, order=True)
class RunSpec:
    """One run of a study."""

    field: str
    """Family of the field: ngp, mip360 or nerfpp."""
    views: str
    """dense, sparse, a share 1/N or a number of training views."""
    prior: str
    """A prior's folder, truth, or none."""
    loss: str | None = None
    """Depth loss; None without a prior, as are all that follow, and in a field that is not trained."""
    clip: float | None = None
    """Farthest depth of the prior that is used, metres."""
    confidence: float | None = None
    """Least confidence of a value that is used."""
    keep: float | None = None
    """Share of the values that is used, the most confident ones."""
    truth_mask: bool = False
    """Only pixels with a true depth are used."""
    density: float | None = None
    """Share of the values that is used, drawn at random."""
    seed: int = 0
    """Of the run."""
    over_all: bool = False
    """The depth loss is the mean over all rays, not over those with a prior."""
    keep_by: Sorts | None = None
    """What confidence and keep go by; None: the method's own confidence, and where neither is given."""

    @property
    def prior_name(self) -> str:
        """The prior's folder name, truth, or none."""
        return Path(self.prior).name

    @property
    def name(self) -> str:
        """Folder of the run: what differs from the defaults, in a fixed order."""
        parts = [self.field, in_name(self.views), self.prior_name, self.loss or ""]
        parts += [f"{key}{getattr(self, key):.10g}" for key in SHARES if getattr(self, key) is not None]
        parts += [f"by{self.keep_by}"] if self.keep_by is not None else []
        words = ["masked"] * self.truth_mask + ["overall"] * self.over_all
        return "-".join([part for part in parts if part] + [*words, f"seed{self.seed}"])

    def filters(self) -> Filters:
        """Return the filters that the prior passes."""
        return Filters(
            truth_mask=self.truth_mask,
            clip=self.clip,
            confidence=self.confidence,
            keep=self.keep,
            density=self.density,
            keep_by=self.keep_by,
        )


@dataclass(frozen=True)
class Study:
    """Every combination of what is listed; a run without a prior has neither loss nor filter and is made once."""

    priors: tuple[str, ...] = (NONE,)
    """Folders of priors in a cache, `truth` and `none`."""
    losses: tuple[str, ...] = ("l1",)
    """Depth losses."""
    views: tuple[str, ...] = ("dense", "sparse")
    """Training views: dense, sparse, a share 1/N or a number."""
    fields: tuple[str, ...] = (BEST,)
    """Families of fields."""
    clips: tuple[float | None, ...] = (None,)
    """Farthest depths that are used, metres: 40 and 80 in the paper."""
    confidences: tuple[float | None, ...] = (None,)
    """Least confidences of what is used."""
    keeps: tuple[float | None, ...] = (None,)
    """Shares that are used, the most confident values."""
    truth_masks: tuple[bool, ...] = (False,)
    """Whether only pixels with a true depth are used."""
    densities: tuple[float | None, ...] = (None,)
    """Shares that are used, drawn at random: the density curve."""
    seeds: tuple[int, ...] = (0,)
    """Every run is made once a seed; the table holds the means."""
    over_all: tuple[bool, ...] = (False,)
    """Whether the depth loss is the mean over all rays, not over those with a prior."""
    keep_bys: tuple[Sorts | None, ...] = (None,)
    """What confidences and keeps go by: None is the method's own confidence."""

    def __post_init__(self) -> None:
        for each in fields(self):
            if not getattr(self, each.name):
                raise DataError(f"study: no {each.name} given: name one or more")
        names = [Path(prior).name for prior in dict.fromkeys(self.priors)]
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise DataError(f"study: two priors are named {min(twice)}: a study is of one drive")

    def runs(self) -> list[RunSpec]:
        """List the runs, each once, in the order of the table.

        Raises:
            UsageError: there is none: a field that is not trained needs a prior.
        """
        choices = (self.fields, self.views, self.priors, self.losses, self.clips, self.confidences, self.keeps)
        grid = itertools.product(*choices, self.truth_masks, self.densities, self.seeds)
        specs = (
            replace(RunSpec(*choice), over_all=over_all, keep_by=keep_by)
            for choice, over_all, keep_by in itertools.product(grid, self.over_all, self.keep_bys)
        )
        runs = list(dict.fromkeys(made for spec in specs if (made := _reduced(spec)) is not None))
        if not runs:
            raise UsageError(f"--field {self.fields[0]}: shows frames by a prior's depth: name one by --priors cache/")
        return runs


@dataclass(frozen=True)
class Outcome:
    """What came of a run."""

    spec: RunSpec
    report: Report | None
    """None where the run failed."""
    error: str = ""
    """Why it failed, one line."""
    fresh: bool = True
    """Whether it was made now; False: it was there already."""


Runner = Callable[[RunSpec, Path, dict[str, Any]], Report]
"""Fits and reports one run in a folder; the report's info must hold the dict as its `config`."""


def unwatched(label: str) -> AbstractContextManager[OnStep]:
    """Show no progress of a fit."""
    return nullcontext(lambda status: None)


@dataclass(frozen=True)
class FitRunner:
    """The usual Runner: fits a drive and scores its held-out views, all runs by one budget."""

    drive: Drive
    fit: FitConfig
    """What the runs share; family, depth loss and seed are the run's own."""
    frames: str | None = None
    """Range of frames, a:b."""
    device: str = "auto"
    """Where to train and render."""
    lpips: Lpips | None = None
    """None leaves that figure out."""
    progress: ProgressBar = silent
    """Shows what is prepared and rendered."""
    watch: Callable[[str], AbstractContextManager[OnStep]] = unwatched
    """Opens a progress bar of a fit of this name; yields what is called after each step."""
    command: Callable[[RunSpec, Path], str] | None = None
    """Writes the command that makes one run alone."""

    @property
    def settings(self) -> dict[str, Any]:
        """What decides the figures besides a run's own choices: drive, frames and budget."""
        budget = {"seconds": self.fit.seconds} if self.fit.steps is None else {"steps": self.fit.steps}
        return {"drive": self.drive.describe(), "frames": self.frames, **budget}

    def begin(self, spec: RunSpec, folder: Path) -> Run:
        """Begin one run, or open it; a run of another budget is begun anew."""
        loss, mean = cast("DepthLoss", spec.loss or "none"), "all" if spec.over_all else "prior"
        losses = replace(self.fit.losses, loss=loss, depth_mean=cast("DepthMean", mean))
        model = replace(self.fit.model, family=spec.field)
        fitted = replace(self.fit, model=model, losses=losses, seed=spec.seed)
        prior = None if spec.prior == NONE else open_guide(spec.prior)
        scene = SceneConfig(spec.views, self.frames, spec.filters())
        run = claim(folder, RunConfig.of(self.drive, prior, scene, fitted), same_budget=True)
        return replace(run, progress=self.progress, source=self.drive)

    def __call__(self, spec: RunSpec, folder: Path, config: dict[str, Any]) -> Report:
        """Fit and score one run."""
        run = self.begin(spec, folder)
        with self.watch(spec.name) as on_step:
            run.fit(self.device, on_step)
        typed = {} if self.command is None else {"command": self.command(spec, folder)}
        return run.report(self.device, self.lpips, {"name": spec.name, "config": config, **typed})


class Grid(Protocol):
    """What runs a study makes."""

    def runs(self) -> list[RunSpec]:
        """List the runs, each once, in the order of the table."""
        ...


def left_of(study: Grid, folder: Path, settings: Mapping[str, Any]) -> list[RunSpec]:
    """List the runs that are not done."""
    return [spec for spec in study.runs() if made_before(folder / spec.name, config_of(spec, settings)) is None]


def run_study(
    study: Grid,
    folder: Path,
    run: Runner,
    settings: Mapping[str, Any],
    on_run: Callable[[Outcome], None] = lambda _: None,
) -> list[Outcome]:
    """Make the runs that are not done, one after the other; a run that fails is told and the others go on.

    Args:
        study: the grid.
        folder: the study's folder.
        run: makes one run.
        settings: everything else that decides a run's figures (drive, frames, budget); anything JSON holds.
        on_run: called after each run.
    """
    outcomes = []
    for spec in study.runs():
        config = config_of(spec, settings)
        done = made_before(folder / spec.name, config)
        outcome = Outcome(spec, done, fresh=False) if done else outcome_of(spec, folder / spec.name, config, run)
        outcomes.append(outcome)
        on_run(outcome)
    return outcomes


def config_of(spec: RunSpec, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return everything that decides a run's figures, as JSON holds it."""
    record = asdict(spec) | {"prior": spec.prior_name}  # a cache may move: the name holds the prior's key
    made: dict[str, Any] = json.loads(json.dumps({"spec": record, **settings}, allow_nan=False))
    return made


def _reduced(spec: RunSpec) -> RunSpec | None:
    """Return a run without the choices that change nothing in it; None where it cannot be made."""
    if not is_trained(spec.field):
        return None if spec.prior == NONE else replace(spec, loss=None, seed=0, over_all=False)
    if spec.keep is None and spec.confidence is None:
        spec = replace(spec, keep_by=None)
    return RunSpec(spec.field, spec.views, NONE, seed=spec.seed) if spec.prior == NONE else spec


def made_before(folder: Path, config: dict[str, Any]) -> Report | None:
    """Return the report of a run that was made with this config; None where there is none."""
    try:
        report = Report.load(folder / "metrics.json")
    except DataError:
        return None
    told = report.info.get("config")
    if isinstance(told, dict) and isinstance(told.get("spec"), dict):  # fields may have been renamed since
        told = told | {"spec": upgrade(RunSpec, told["spec"])}
    return report if told == config else None


def outcome_of(spec: RunSpec, folder: Path, config: dict[str, Any], run: Runner) -> Outcome:
    """Make a run; what a user can mend is told, anything else is raised."""
    try:
        report = run(spec, folder, config)
    except (DataError, ScoreError) as error:
        return Outcome(spec, None, str(error))
    if report.info.get("config") != config:
        raise ValueError(f"{spec.name}: the runner's report must hold the config, or the run is never found done")
    return Outcome(spec, report)
