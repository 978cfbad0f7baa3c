"""`priors build`: make depth maps for a drive and cache them."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field, make_dataclass, replace
from glob import escape
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cli.arguments import SequenceArguments, ThreadArguments, parse
from cli.console import DATA_ERROR, busy, err, out, progress
from cli.engine import EngineArguments
from cli.priors.left_open import LeftOpen, idle_flags, method_of
from cli.priors.many import Asked, build_many, is_asked
from priors import build, methods
from priors.bench.budget import Budget
from priors.build import BuildReport, Job, Plan, room
from priors.build.chains import MOST
from priors.build.temporal import MOST as MOST_NEIGHBOURS
from priors.cache import load
from priors.cache.manifest import NewerFormatError
from priors.drives import poses_of
from priors.errors import DataError, UsageError, expect_between
from priors.filters import Filters
from priors.machine.threads import MOST_THREADS
from priors.scale.drive_list import DriveEntry
from priors.selection import Selection, select
from priors.types import Drive, Method

EXAMPLES = """Make depth maps for drives and cache them; what is cached already is not made again.

examples:
  priors build --method stereo                                the drive here, or the only one below
  priors build --method auto                                  what suits it: stereo, completion or mono
  priors build street/ --method stereo
  priors build street/ --budget 100ms                         the most accurate that takes no longer for a frame
  priors build street/ --budget absrel=0.02                   the fastest that is as right
  priors build KITTI/2011_09_26 --drive 2011_09_26_drive_0001_sync --method lidar --lidar.sweeps 11
  priors build street/ --method completion --sky mask --clip 80 --frames 0:20
  priors build street/ --method mono --mono.adapt lidar       fine-tune on the drive first, a minute or two
  priors build street/ --method stereo --keep 0.9228          keep the most confident 92.28 %
  priors build street/ --method stereo --temporal 2           steady from frame to frame, by the poses
  priors build street/ --method stereo --shard 3/8            the third of eight machines
  priors build street/ --method stereo --reuse 4              a map in four is made whole: half the time
  priors build street/ --method lidar --dry-run               what would be computed, what not and why
  priors build streets/* kitti/ drives.txt --method lidar     many drives: folders, patterns, lists
  priors build drives.parquet --method stereo --engine ray --address auto      on a Ray cluster
"""


@dataclass(frozen=True)
class BuildArguments(ThreadArguments, SequenceArguments):
    """Arguments of `priors build` that do not depend on which methods there are."""

    method: Literal["auto", *methods.names()] | None = None  # type: ignore[valid-type]
    """How to make depth. auto: the most accurate of the drive's own bench (`priors bench`); without one stereo where
    there is a pair, else completion where there is a LiDAR, else mono."""
    budget: str | None = None
    """What a frame may take (100ms, 2s) or how far off it may be (absrel=0.02): the most accurate method for the time,
    or the fastest for the error, by the drive's own bench, else by a shipped table and two seconds of calibration."""
    cache: Path = Path("cache")
    """Where the maps go."""
    selection: tyro.conf.OmitArgPrefixes[Selection] = field(default_factory=Selection)
    filters: tyro.conf.OmitArgPrefixes[Filters] = field(default_factory=Filters)
    reuse: int = 1
    """Make every N-th map whole, and the N - 1 after it of the one before: moved by the poses, checked against the
    pair, made whole where that fails. For stereo, where frames lie close together; 1: make all whole."""
    temporal: int = 0
    """Join each map with those of so many frames before and after it, by the poses: 2 halves the flicker. The
    neighbours' maps are read from the cache, and built where they lack. 0: none."""
    workers: int = 2
    """Frames computed at the same time; with --reuse, chains of N frames."""
    dry_run: bool = False
    """List what would be computed and what is skipped and why; compute nothing."""
    more: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[DATA ...]")] = ()
    """More drives: folders, patterns, lists as text or Parquet (docs/scale.md)."""
    engine: tyro.conf.OmitArgPrefixes[EngineArguments] = field(default_factory=EngineArguments)

    def __post_init__(self) -> None:
        super().__post_init__()
        expect_between(1, self.workers, MOST_THREADS, "--workers")
        expect_between(1, self.reuse, MOST, "--reuse")
        expect_between(0, self.temporal, MOST_NEIGHBOURS, "--temporal")
        if self.budget is not None:
            Budget.parse(self.budget)
        self.chosen()

    def chosen(self) -> Selection:
        """Return which frames to work on."""
        return replace(self.selection, frames=self.frame_range(self.selection.frames))

    @property
    def names(self) -> list[Path]:
        """The drives' names; one where the user names none: the current folder."""
        return [self.data or Path(), *self.more]

    def settings(self, method: str) -> Method:
        """Return a method's settings; a subclass has a field for each method."""
        settings: Method = vars(self)[method]
        return settings


def run(arguments: list[str]) -> int:
    """Build; returns the exit code."""
    args = parse(ARGUMENTS["priors build"], "priors build", EXAMPLES, arguments)
    with args.limited():
        return _build(args, arguments)


def _build(args: BuildArguments, typed: list[str]) -> int:
    if args.method not in (None, "auto"):
        _refuse_idle_flags(str(args.method), typed)
        _refuse_unread(args.settings(str(args.method)), typed)
    if is_asked(args.names, args.engine.engine):
        return _build_many(args, typed)
    with busy("looking at the drive"):
        job, plan = _prepare(args, typed)
    if (line := room.told(job.prior, len(plan.todo))) is not None:
        err.print(line)
    if args.dry_run:
        _print_plan(job, plan)
        return 0
    with progress(job.method.name, len(plan.todo)) as step:
        report = job.run(plan, args.workers, step, _note)
    for frame_id, error in sorted(report.failed.items()):
        err.complain(error.removeprefix(f"frame {frame_id}: "), f"frame {frame_id}")
    _print_summary(report)
    _complain_if_nothing(report)
    return DATA_ERROR if report.failed else 0


def _build_many(args: BuildArguments, typed: list[str]) -> int:
    """Build several drives, each by the method that is asked for or suits it."""
    for flag, given in (("--sequence", args.sequence), ("--dry-run", args.dry_run or None)):
        if given is not None:
            raise UsageError(f"{flag}: is for one drive on this machine: name one, or leave this out")
    if args.engine.engine == "ray" and args.budget is not None:
        raise UsageError(f"--budget {args.budget}: is measured on this machine, not on the cluster's: name a --method")

    def choose(entry: DriveEntry, drive: Drive) -> Method:
        return _settings(args, drive, select(drive.ids, entry.frames), typed)

    chosen = args.chosen()
    usual = DriveEntry(Path(), args.dataset, args.part, chosen.frames)
    command = shlex.join(["priors", "build", *typed])
    where = args.cache, chosen, args.workers
    asked = Asked(args.names, usual, args.filters, *where, args.engine, args.reuse, args.temporal, command)
    return build_many(asked, choose)


def _prepare(args: BuildArguments, typed: list[str]) -> tuple[Job, Plan]:
    """Open the drive, decide what is left open, and find out what is to be computed."""
    drive = args.open(["priors", "build", *typed])
    indices = select(drive.ids, args.chosen().frames)  # wrong frames are told before anything is compiled
    job = build.prepare(
        drive, _settings(args, drive, indices, typed), args.filters, args.cache, args.reuse, args.temporal
    )
    for flag, reader in _unread_flags(job.method, typed).items():
        err.print(f"{flag}: not used here: it is read with {reader}")
    _tell_of_unused(job)
    return job, job.plan(args.chosen())


def _settings(args: BuildArguments, drive: Drive, indices: Sequence[int], typed: list[str]) -> Method:
    """Return the method that the user names, or that suits the drive or the budget, with its settings."""
    if args.budget is None and args.method not in (None, "auto"):
        return args.settings(str(args.method))
    left_open = LeftOpen(drive, indices, args.cache, typed)
    if args.budget is not None:
        chosen = left_open.for_budget(Budget.parse(args.budget), None if args.method == "auto" else args.method)
    else:
        chosen = left_open.for_drive(asked=args.method is not None)
    return replace(args.settings(chosen.method), **chosen.settings)


def _tell_of_unused(job: Job) -> None:
    """Say which maps of this method lie there already and are not used: of other poses, or without their manifest."""
    if job.prior.ids():
        return
    own = poses_of(job.drive.describe())
    siblings = set(job.prior.folder.parent.glob(f"{escape(job.method.name)}-*")) - {job.prior.folder}
    for folder in sorted(siblings):
        try:
            made_with = poses_of(load(folder).drive)
            if made_with != own:
                told = f"made with {made_with} poses, these are {own}"
                err.print(f"{folder}: {told}: --poses {made_with} goes on with it")
        except NewerFormatError:
            continue  # `priors list` and `priors eval` name it
        except DataError as error:
            mend = f"Where an earlier version made it, put manifest.json back from a copy, or keep {job.prior.folder}"
            err.print(f"left out: {error}. {mend}")


def _refuse_idle_flags(method: str, typed: list[str]) -> None:
    """Raise UsageError where a flag of another method was typed: it would do nothing."""
    if idle := idle_flags(method, typed):
        others = " or ".join(dict.fromkeys(str(method_of(flag)) for flag in idle))
        what = "a flag" if len(idle) == 1 else "flags"
        raise UsageError(f"{', '.join(idle)}: {what} of --method {others}, not of {method}: leave out one or the other")


def _unread_flags(method: Method, typed: list[str]) -> dict[str, str]:
    """Return the flags that were typed of a method and that its settings leave without effect, with what reads them."""
    unread, found = method.unread(), {}
    for flag in (word.partition("=")[0] for word in typed if word.startswith("--")):
        name, *parts = flag.removeprefix("--").replace("-", "_").split(".")
        if name == method.name and parts and (field := parts[0].removeprefix("no_")) in unread:
            found[flag] = unread[field]
    return found


def _refuse_unread(method: Method, typed: list[str]) -> None:
    """Raise UsageError where a flag was typed that the method's other flags leave without effect."""
    for flag, reader in _unread_flags(method, typed).items():
        raise UsageError(f"{flag}: not used as --method {method.name} is set: it is read with {reader}")


def _note(line: str) -> None:
    """Tell what a method does before the first frame."""
    err.print(line)


def _with_methods() -> type[BuildArguments]:
    """Add one group of flags for each file in priors/methods: --stereo.*, --lidar.*, ..."""
    groups = [(name, methods.config_type(name)) for name in methods.names()]
    fields: list[tuple[str, type[Method], Any]] = [(name, kind, field(default_factory=kind)) for name, kind in groups]
    return make_dataclass("Build", fields, bases=(BuildArguments,), frozen=True)


def _print_plan(job: Job, plan: Plan) -> None:
    out.print(f"{job.prior.folder}")
    for index in plan.todo:
        id_ = job.drive.ids[index]
        why = f": {plan.stale[id_]}" if id_ in plan.stale else f": {plan.damaged[id_]}" if id_ in plan.damaged else ""
        out.print(f"  {id_}  compute{why}")
    for frame_id, reason in plan.skipped.items():
        out.print(f"  {frame_id}  skip: {reason}")
    for frame_id, error in plan.failed.items():
        out.print(f"  {frame_id}  cannot be read: {error}")
    out.print(f"{len(plan.todo)} to compute, {len(plan.skipped)} skipped, {len(plan.failed)} cannot be read")


def _print_summary(report: BuildReport) -> None:
    """Print one row: counts, time a frame, density and range."""
    import numpy as np

    table = Table(title=str(report.prior.folder), title_justify="left", box=SIMPLE_HEAD)
    for heading in ("built", "cached", "skipped", "failed", "s/frame", "density", "min m", "median m", "max m"):
        table.add_column(heading, justify="right")
    cached = sum(reason == "cached" for reason in report.plan.skipped.values())
    counts = [len(report.built), cached, len(report.plan.skipped) - cached, len(report.failed)]
    columns = (("seconds", np.median, ".3f"), ("density", np.mean, ".1%"))
    ranges = (("min_m", min, ".2f"), ("median_m", np.median, ".2f"), ("max_m", max, ".2f"))
    figures = [(report.prior.figures(name), reduce, form) for name, reduce, form in (*columns, *ranges)]
    table.add_row(
        *map(str, counts), *(f"{reduce(values):{form}}" if values else "-" for values, reduce, form in figures)
    )
    out.print(table)
    _print_repaired(report)
    if report.carried:
        out.print(f"{len(report.carried)} of the built were made of the frame before, the others whole")
    too_far = sum(line["too_far"] for line in report.built)
    if too_far:
        out.print(f"{too_far} values lie beyond 255.99 m, the most the format holds: left without a value")


def _print_repaired(report: BuildReport) -> None:
    """Tell which maps were made anew, and what another build has made."""
    plan, built = report.plan, {line["id"] for line in report.built}
    for what, reasons in (("stale: the data has changed", plan.stale), ("damaged", plan.damaged)):
        anew = sorted(built & reasons.keys())
        if anew:
            out.print(f"{len(anew)} of the built were {what}, the first {anew[0]}: {reasons[anew[0]]}")
    if report.left:
        out.print(f"{len(report.left)} were left to another build, which has made them")


def _complain_if_nothing(report: BuildReport) -> None:
    """Raise DataError where no frame could be computed because every one lacks an input."""
    lacking = [reason for reason in report.plan.skipped.values() if reason != "cached" and "stood still" not in reason]
    if lacking and not report.built and not report.failed and len(lacking) == len(report.plan.skipped):
        raise DataError(f"no frame can be computed: {lacking[0]}")


ARGUMENTS = {"priors build": _with_methods()}
