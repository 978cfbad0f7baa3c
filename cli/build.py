"""`priors build`: make depth maps for a drive and cache them."""

from dataclasses import dataclass, field, make_dataclass
from pathlib import Path
from typing import Any, Literal

import tyro
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from cli.arguments import DriveArguments, ThreadArguments, parse
from cli.console import DATA_ERROR, err, out, progress
from priors import build, methods
from priors.errors import DataError
from priors.filters import Filters

EXAMPLES = """Make depth maps for a drive and cache them; what is cached already is not made again.

examples:
  priors build street/ --method stereo
  priors build KITTI/2011_09_26 --drive 2011_09_26_drive_0001_sync --method lidar --lidar.sweeps 11
  priors build street/ --method completion --sky mask --clip 80 --frames 0:20
  priors build street/ --method mono --mono.adapt lidar       fine-tune on the drive first, a minute or two
  priors build street/ --method stereo --keep 0.9228          keep the most confident 92.28 %
  priors build street/ --method stereo --shard 3/8            the third of eight machines
  priors build street/ --method lidar --dry-run               what would be computed, what not and why
"""


@dataclass(frozen=True)
class BuildArguments(ThreadArguments, DriveArguments):
    """Arguments of `priors build` that do not depend on which methods there are."""

    method: Literal[*methods.names()] = tyro.MISSING  # type: ignore[valid-type]
    """How to make depth."""
    cache: Path = Path("cache")
    """Where the maps go."""
    selection: tyro.conf.OmitArgPrefixes[build.Selection] = field(default_factory=build.Selection)
    filters: tyro.conf.OmitArgPrefixes[Filters] = field(default_factory=Filters)
    workers: int = 2
    """Frames computed at the same time."""
    dry_run: bool = False
    """List what would be computed and what is skipped and why; compute nothing."""


def run(arguments: list[str]) -> int:
    """Build; returns the exit code."""
    args: Any = parse(_with_methods(), "priors build", EXAMPLES, arguments)
    with args.limited():
        return _build(args)


def _build(args: Any) -> int:
    drive = args.open()
    prior, method = build.prepare(drive, args.method, getattr(args, args.method), args.filters, args.cache)
    reads = [*method.reads, *args.filters.reads]
    plan = build.plan(drive, prior, reads, args.selection)
    if args.dry_run:
        _print_plan(drive.ids, prior, plan)
        return 0
    with progress(args.method, len(plan.todo)) as step:
        report = build.build(drive, prior, method, args.filters, plan, args.workers, step, _note)
    for frame_id, error in sorted(report.failed.items()):
        err.print(f"[bold red]frame {frame_id}:[/] {escape(error)}")
    _print_summary(report)
    _complain_if_nothing(report)
    return DATA_ERROR if report.failed else 0


def _note(line: str) -> None:
    """Tell what a method does before the first frame."""
    err.print(line, markup=False)


def _with_methods() -> type[Any]:
    """Add one group of flags for each file in priors/methods: --stereo.*, --lidar.*, ..."""
    groups = [(name, methods.config_type(name)) for name in methods.names()]
    fields = [(name, kind, field(default_factory=kind)) for name, kind in groups]
    return make_dataclass("Build", fields, bases=(BuildArguments,), frozen=True)


def _print_plan(ids: Any, prior: Any, plan: build.Plan) -> None:
    out.print(f"{prior.folder}")
    for index in plan.todo:
        out.print(f"  {ids[index]}  compute")
    for frame_id, reason in plan.skipped.items():
        out.print(f"  {frame_id}  skip: {reason}", markup=False)
    for frame_id, error in plan.failed.items():
        out.print(f"  {frame_id}  cannot be read: {error}", markup=False)
    out.print(f"{len(plan.todo)} to compute, {len(plan.skipped)} skipped, {len(plan.failed)} cannot be read")


def _print_summary(report: build.Report) -> None:
    """Print one row: counts, time a frame, density and range."""
    import numpy as np

    table = Table(title=str(report.prior.folder), title_justify="left", box=SIMPLE_HEAD)
    for heading in ("built", "cached", "skipped", "failed", "s/frame", "density", "min m", "median m", "max m"):
        table.add_column(heading, justify="right")
    cached = sum(reason == "cached" for reason in report.plan.skipped.values())
    counts = [len(report.built), cached, len(report.plan.skipped) - cached, len(report.failed)]
    lines = list(report.prior.lines().values())
    values = [line for line in lines if line["min_m"] is not None]
    numbers = ["-"] * 5
    if values:
        seconds = np.median([line["seconds"] for line in lines])
        density = np.mean([line["density"] for line in lines])
        low, high = min(line["min_m"] for line in values), max(line["max_m"] for line in values)
        middle = np.median([line["median_m"] for line in values])
        numbers = [f"{seconds:.3f}", f"{density:.1%}", f"{low:.2f}", f"{middle:.2f}", f"{high:.2f}"]
    table.add_row(*map(str, counts), *numbers)
    out.print(table)
    too_far = sum(line["too_far"] for line in report.built)
    if too_far:
        out.print(f"{too_far} values lie beyond 255.99 m, the most the format holds: left without a value")


def _complain_if_nothing(report: build.Report) -> None:
    """Raise DataError where no frame could be computed because every one lacks an input."""
    lacking = [reason for reason in report.plan.skipped.values() if reason != "cached" and "stood still" not in reason]
    if lacking and not report.built and not report.failed and len(lacking) == len(report.plan.skipped):
        raise DataError(f"no frame can be computed: {lacking[0]}")
