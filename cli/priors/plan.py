"""`priors plan`: what a drive has, needs and does not need, before anything is built."""

import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rich.box import SIMPLE_HEAD
from rich.table import Table

from cli.arguments import SequenceArguments, ThreadArguments, parse
from cli.console import DATA_ERROR, busy, err, out
from cli.durations import duration
from nerf.split import check_views, held_out
from priors.bench.budget import Budget, told
from priors.plan.drive_plan import DrivePlan, Wish, make_plan
from priors.plan.needs import Need
from priors.selection import parse_range, select

EXAMPLES = """Say what a drive has and what each method needs, what each takes on this machine, what can be left out
and why, and which prior a field of it should have. Nothing is built. Times are of the drive's own bench where there is
one (`priors bench`), else of a shipped table and two seconds of calibration.

examples:
  priors plan street/
  priors plan street/ --views dense --aim pictures           does it need a prior at all?
  priors plan street/ --budget 100ms                         the most accurate that takes no longer for a frame
  priors plan KITTI/2011_09_26 --drive 2011_09_26_drive_0001_sync --json
"""


@dataclass(frozen=True)
class PlanArguments(ThreadArguments, SequenceArguments):
    """Arguments of `priors plan`."""

    views: str = "sparse"
    """Training views of the field: dense, sparse, a share (1/8) or a number."""
    aim: Literal["pictures", "geometry"] = "geometry"
    """What is wanted of the field: pictures alone, or its geometry too."""
    budget: str | None = None
    """What a frame of the prior may take (100ms, 2s), or how far off it may be (absrel=0.02)."""
    frames: str | None = None
    """Range of frames, a:b."""
    cache: Path = Path("cache")
    """Where priors and the drive's bench may lie."""
    json: bool = False
    """Print JSON."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_views(self.views)
        parse_range(self.frame_range(self.frames))
        self.wish()

    def wish(self) -> Wish:
        """Return what the priors are for."""
        budget = None if self.budget is None else Budget.parse(self.budget)
        return Wish(self.views == "dense", self.aim, budget)


ARGUMENTS = {"priors plan": PlanArguments}


def run(arguments: list[str]) -> int:
    """Print the plan; returns the exit code: 1 where the budget cannot be kept."""
    args = parse(PlanArguments, "priors plan", EXAMPLES, arguments)
    with args.limited():
        drive = args.open(["priors", "plan"])
        frames = args.frame_range(args.frames)
        with busy("looking at the drive"):
            unread = held_out(len(select(drive.ids, frames)))
            plan = make_plan(drive, frames, args.cache, args.wish(), unread)
    if args.json:
        out.write(json.dumps(plan.record(), indent=1, allow_nan=False) + "\n")
    else:
        _print(plan, args)
    if plan.unmet:
        err.complain(plan.unmet)
    return DATA_ERROR if plan.unmet else 0


def _print(plan: DrivePlan, args: PlanArguments) -> None:
    height, width = plan.has.size
    shares = plan.has.shares | {"poses": plan.has.posed}
    there = [name if share == 1 else f"{name} ({share:.0%})" for name, share in shares.items() if share > 0]
    out.print(f"{plan.drive}: {plan.frames} frames of {width}x{height}; it has {', '.join(there)}")
    out.print(_methods(plan))
    if plan.skips:
        out.print(_skips(plan))
    if plan.choice is None:
        return
    out.print(f"prior: {plan.choice.name}: {plan.choice.reason}")
    out.print(f"  {plan.choice.evidence}")
    if plan.choice.candidate is not None:
        words = " ".join(["priors build", *map(shlex.quote, args.typed_drive()), *plan.choice.candidate.flags()])
        out.print(f"  {words}")


def _methods(plan: DrivePlan) -> Table:
    """Lay out what each way to make depth needs and takes, the fastest first; then those that cannot work."""
    table = Table(box=SIMPLE_HEAD, title="methods", title_justify="left")
    for heading in ("method", "needs"):
        table.add_column(heading, overflow="fold")
    for heading in ("frames", "a frame", "in all", "AbsRel", "of image"):
        table.add_column(heading, justify="right")
    table.add_column("told by", overflow="fold")
    by_name = {need.method: need for need in plan.needs}
    for each in plan.candidates:
        need = by_name[each.method.name]
        error = f"{each.abs_rel:.4f}" if each.abs_rel == each.abs_rel else "-"
        density = f"{each.density:.0%}" if each.density == each.density else "-"
        times = told(each.seconds), duration(plan.seconds(each))
        table.add_row(each.name, ", ".join(need.reads), _share(need), *times, error, density, each.source)
    for need in plan.needs:
        if need.method not in {each.method.name for each in plan.candidates}:
            why = need.lacks or "not measured: run `priors bench`"
            table.add_row(need.method, ", ".join(need.reads), _share(need), "-", "-", "-", "-", why)
    return table


def _share(need: Need) -> str:
    return "all" if need.frames == need.looked_at else f"{need.frames}/{need.looked_at}"


def _skips(plan: DrivePlan) -> Table:
    """Lay out what can be left out."""
    table = Table(box=SIMPLE_HEAD, title="left out", title_justify="left")
    for heading in ("what", "how much", "why"):
        table.add_column(heading, overflow="fold")
    for skip in plan.skips:
        table.add_row(skip.what, skip.saves, skip.why)
    return table
