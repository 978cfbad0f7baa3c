"""`nerf study`: a grid of runs and its table."""

import shlex
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from dataclasses import field as made_by
from functools import partial
from pathlib import Path
from typing import Any, Literal

import tyro

from cli.arguments import Device, SequenceArguments, ThreadArguments, parse
from cli.console import DATA_ERROR, busy, err, fit_progress, out, progress
from cli.durations import seconds
from cli.engine import EngineArguments
from cli.nerf.eval import LpipsArguments
from cli.nerf.fit import FieldName
from cli.nerf.sources import named_priors
from eval import typeset
from nerf import study_table
from nerf.config import FitConfig
from nerf.fields import is_trained
from nerf.forecast import forecast
from nerf.guide import TRUTH, TrueMaps
from nerf.losses import LossConfig
from nerf.paper import page
from nerf.paper.measured import Measured
from nerf.paper.numbers import FIELDS
from nerf.paper.plan import FEW_VIEWS, Plan
from nerf.quality import BEST
from nerf.split import check_views, held_out, split
from nerf.study import NONE, SHARES, FitRunner, Grid, Outcome, RunSpec, Study, left_of, run_study
from priors.errors import LARGEST_SEED, UsageError, expect_between
from priors.filters import Filters
from priors.selection import parse_range, select
from priors.types import Drive

AS_IT_IS = partial(LossConfig, trim=0.0)
"""The study takes its priors as they are."""
EXAMPLES = """Fit a grid of priors, views, losses, filters and fields, one run after the other; one table.
Runs that are done are not made again; with another --time or --steps they are begun anew.
A choice given several values is a dimension of the grid.

examples:
  nerf study street/ --priors none cache/ --views dense sparse --field ngp
  nerf study street/ --priors cache/DRIVE/stereo-KEY --loss mse l1 kl urf --views sparse
  nerf study street/ --priors none cache/DRIVE/completion-KEY --density 0.01 0.05 0.2 1 --time 30s
  nerf study street/ --priors none truth cache/ --preset paper --steps 1500       the study's tables and findings
"""

STUDY = Path("study")
MANY = 6
"""So many runs are worth a forecast, which takes a few steps of each kind."""
DECIDED = ("loss", "views", "clip", "confidence", "keep", "keep_by", "density", "truth_mask")
"""What a preset says."""


@dataclass(frozen=True)
class StudyArguments(ThreadArguments, SequenceArguments):
    """Arguments of `nerf study`."""

    priors: tuple[Path, ...] = (Path(NONE),)
    """Priors' folders, folders that hold several, truth: the drive's own maps, and none: colours alone."""
    loss: tuple[Literal["mse", "l1", "kl", "urf"], ...] = ("mse",)
    """Depth losses."""
    views: tuple[str, ...] = ("dense", "sparse")
    """Training views: dense, sparse, shares (1/8: every 8th) or numbers."""
    preset: Literal["none", "paper"] = "none"
    """paper: all tables and findings of the study of docs/study.md, by fields that learn no frame's exposure, as its
    fields do not; says what it takes, goes on after a kill."""
    field: tuple[FieldName, ...] = ()
    """Families of fields; default: mip360, with --preset paper the study's three."""
    clip: tuple[float, ...] = ()
    """Farthest depths of the prior that are used, metres."""
    confidence: tuple[float, ...] = ()
    """Least confidences of what is used."""
    keep: tuple[float, ...] = ()
    """Shares of the prior's values that are used, the most confident ones."""
    keep_by: tuple[Literal["own", "metres", "relative", "pixels"], ...] = ("own",)
    """What --confidence and --keep go by: the method's own confidence, or the probability of an error within 1 m, of
    5 % of the depth, or of 1 px."""
    density: tuple[float, ...] = ()
    """Shares of the prior's values that are used, drawn at random."""
    truth_mask: Literal["no", "yes", "both"] = "no"
    """Use only pixels with a true depth."""
    seed: tuple[int, ...] = ()
    """Every run is made once a seed; the table has the means. Default: 0, with --preset paper 0 1 2."""
    frames: str | None = None
    """Range of frames, a:b."""
    time: str = "60s"
    """How long each run trains."""
    steps: int | None = None
    """Train each run so many steps instead."""
    device: Device = "auto"
    """Where to train and render; auto: a GPU where there is one."""
    losses: tyro.conf.OmitArgPrefixes[tyro.conf.Suppress[LossConfig]] = made_by(default_factory=AS_IT_IS)
    engine: tyro.conf.OmitArgPrefixes[EngineArguments] = made_by(default_factory=EngineArguments)
    out: Path = STUDY
    """The study's folder; default with --sequence: study/<sequence>."""
    lpips: tyro.conf.OmitArgPrefixes[LpipsArguments] = made_by(default_factory=LpipsArguments)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.fit()
        parse_range(self.frame_range(self.frames))
        for views in self.views:
            check_views(views)
        for seed in self.seed:
            expect_between(0, seed, LARGEST_SEED, "--seed")
        for name in SHARES:
            for value in vars(self)[name]:
                Filters(**{name: value})
        if self.keep_by != ("own",) and not (self.keep or self.confidence):
            given = " ".join(self.keep_by)
            raise UsageError(f"--keep-by {given}: expected --keep or --confidence beside it: it says what they go by")
        for each in fields(self) if self.preset != "none" else ():
            if each.name in DECIDED and getattr(self, each.name) != each.default:
                flag = f"--{each.name.replace('_', '-')}"
                raise UsageError(f"{flag}: --preset {self.preset} says it: leave out one or the other")

    @property
    def folder(self) -> Path:
        """The study's folder: sequences of one drive lie apart."""
        return self.out / self.sequence if self.sequence is not None and self.out == STUDY else self.out

    def fit(self) -> FitConfig:
        """Return what all fits have in common."""
        timed = None if self.steps is not None else seconds(self.time)
        fit = FitConfig(losses=self.losses, steps=self.steps, seconds=timed, align="none")
        return fit if self.preset == "none" else _as_the_paper(fit)

    def plan(self, drive: Drive, positions: Sequence[int]) -> Plan:
        """Return the study's runs on some frames of a drive."""
        masked = any(drive[position].has("truth") for position in positions)
        trained = len(positions) - len(held_out(len(positions)))
        few = tuple(views for views in FEW_VIEWS if int(views.removeprefix("1/")) <= trained)
        return Plan(named_priors(self.priors), self.field or tuple(FIELDS), self.seed or (0, 1, 2), masked, few)

    def grid(self) -> Study:
        """Return the grid that was asked for."""
        masks = {"no": (False,), "yes": (True,), "both": (False, True)}[self.truth_mask]
        return Study(
            priors=named_priors(self.priors),
            losses=self.loss,
            views=self.views,
            fields=self.field or (BEST,),
            clips=self.clip or (None,),
            confidences=self.confidence or (None,),
            keeps=self.keep or (None,),
            truth_masks=masks,
            densities=self.density or (None,),
            seeds=self.seed or (0,),
            keep_bys=tuple(None if by == "own" else by for by in self.keep_by),
        )


ARGUMENTS = {"nerf study": StudyArguments}


def _as_the_paper(fit: FitConfig) -> FitConfig:
    """Return a fit without what the study's fields do not have.

    That is the colours of frames, doubt beyond a prior's own confidence, and batches that grow.
    """
    model = replace(fit.model, gaussians=replace(fit.model.gaussians, appearance=False))
    return replace(fit, model=model, losses=replace(fit.losses, opacity_power=1.0, weigh="confidence"), rays_growth=1.0)


def _words_of_the_paper(field: str) -> list[str]:
    """Return the same as flags, of those that a family reads."""
    words = ["--no-appearance"] if is_trained(field) else []
    return [*words, "--opacity-power", "1", "--weigh", "confidence", "--rays-growth", "1"] if field in FIELDS else words


def run(arguments: list[str]) -> int:
    """Make the study; returns the exit code: 1 where a run failed."""
    args = parse(StudyArguments, "nerf study", EXAMPLES, arguments)
    with args.limited():
        return _make(args, shlex.join(["nerf", "study", *arguments]))


def _make(args: StudyArguments, command: str) -> int:
    drive = args.open(["nerf", "study"])
    positions = select(drive.ids, args.frame_range(args.frames))
    for views in args.views:  # what no run can have is told before the first
        split(len(positions), views)
    grid = args.grid() if args.preset == "none" else args.plan(drive, positions)
    if TRUTH.name in grid.priors:
        ids = [drive.ids[position] for position in positions]
        TrueMaps(drive).stamps(ids, [ids[position] for position in held_out(len(ids))])

    def command_of(spec: RunSpec, folder: Path) -> str:
        return _command(args, spec, folder)

    lpips = args.lpips.open()
    runner = FitRunner(
        drive, args.fit(), args.frame_range(args.frames), args.device, lpips, progress, fit_progress, command_of
    )
    left = left_of(grid, args.folder, runner.settings)
    if len(left) >= MANY and args.engine.engine == "local":  # another machine takes another time
        with busy("a few steps of each kind, to say what it takes"):
            told = str(forecast(runner, grid.runs(), left, args.folder))
        err.print(told)
    made: list[Outcome] = []

    def tell(outcome: Outcome) -> None:
        _tell(outcome)
        made.append(outcome)
        if isinstance(grid, Plan):  # a study that is killed has its page too
            page.write(Measured(grid, made), args.folder, command)

    outcomes = _run(args, grid, runner, tell)
    laid = study_table.lay_out(outcomes)
    out.print(typeset.render(laid, out.width)) if out.is_terminal else out.write(typeset.plain(laid))
    for path in study_table.save(outcomes, args.folder, command):
        out.print(f"wrote {path}")
    if isinstance(grid, Plan):
        out.print(f"wrote {page.write(Measured(grid, outcomes), args.folder, command)}")
    return DATA_ERROR if any(outcome.report is None for outcome in outcomes) else 0


def _run(args: StudyArguments, grid: Grid, runner: FitRunner, tell: Callable[[Outcome], None]) -> list[Outcome]:
    """Make the runs here, or on a cluster."""
    if args.engine.engine == "local":
        return run_study(grid, args.folder, runner, runner.settings, tell)
    from nerf.study_on_ray import Cell, run_study_on_ray
    from priors.scale.ray_session import session

    def cell_of(spec: RunSpec, config: dict[str, Any]) -> Cell:
        there = replace(spec, prior=str(Path(spec.prior).absolute())) if spec.prior not in (NONE, TRUTH.name) else spec
        folder, drive = (args.folder / spec.name).absolute(), runner.drive.describe()
        weights = tuple(path.absolute() for path in args.lpips.lpips_weights)
        command = _command(args, spec, args.folder / spec.name)
        return Cell(there, folder, config, command, drive, runner.fit, runner.frames, args.device, weights)

    with session(args.engine.address) as ray:
        return run_study_on_ray(grid, cell_of, runner.settings, (ray, args.engine.share), tell)


def _tell(outcome: Outcome) -> None:
    if outcome.report is None:
        err.complain(outcome.error, outcome.spec.name)
    elif not outcome.fresh:
        err.print(f"{outcome.spec.name}: done before")


def _command(args: StudyArguments, spec: RunSpec, folder: Path) -> str:
    """Write the command that makes one run alone."""
    parts = ["nerf", "fit", *args.typed_drive()]
    parts += ["--field", spec.field, "--views", spec.views, "--run", str(folder)]
    parts += ["--steps", str(args.steps)] if args.steps is not None else ["--time", args.time]
    parts += ["--frames", args.frames] if args.frames else []
    parts += ["--align", "none", "--trim", "0"]
    parts += [] if args.preset == "none" else _words_of_the_paper(spec.field)
    if spec.prior != NONE:
        parts += ["--prior", spec.prior, *(["--loss", spec.loss] if spec.loss else [])]
        record = {name: value for name, value in asdict(spec).items() if name in SHARES}
        parts += [word for name, value in record.items() if value is not None for word in (f"--{name}", f"{value:g}")]
        parts += ["--keep-by", spec.keep_by] if spec.keep_by is not None else []
        parts += ["--truth-mask"] if spec.truth_mask else []
        parts += ["--depth-mean", "all"] if spec.over_all else []
    return shlex.join([*parts, "--seed", str(spec.seed)])
