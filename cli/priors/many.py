"""`priors build` with several drives: one progress bar, one table, summary.json."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.table import Table

from cli.console import DATA_ERROR, busy, err, growing_progress, out
from cli.engine import EngineArguments
from priors.errors import DataError
from priors.filters import Filters
from priors.scale.drive_list import DriveEntry, find_drives, stands_for_several
from priors.scale.fleet import Choose, Fleet, Member, gather
from priors.scale.here import build_here
from priors.scale.order import Order
from priors.scale.tally import Part, Tally, write_summary
from priors.selection import Selection

MOST_ROWS = 40
"""Rows of the table, and errors that are told; summary.json has all."""


@dataclass(frozen=True)
class Asked:
    """What the command says of all drives."""

    names: Sequence[Path]
    """Folders, patterns and lists."""
    usual: DriveEntry
    """What holds for a drive of which a list says nothing else."""
    filters: Filters
    cache: Path
    selection: Selection
    workers: int
    """Frames computed at the same time."""
    engine: EngineArguments
    reuse: int
    """How many frames share one map that is made whole."""
    temporal: int
    """With the maps of how many neighbours each map is joined."""
    command: str
    """As typed."""

    def order(self, member: Member) -> Order:
        """Return what is to be built of a drive."""
        selection = replace(self.selection, frames=member.entry.frames)
        made = Order(member.entry, member.method, self.filters, self.cache, selection)
        return replace(made, reuse=self.reuse, temporal=self.temporal)


def is_asked(names: Sequence[Path], engine: str) -> bool:
    """Tell whether a command is about several drives: two names, a pattern, a list, or a cluster."""
    return len(names) > 1 or engine != "local" or any(map(stands_for_several, names))


@dataclass
class Progress:
    """Adds up what comes of each drive, and moves the bar."""

    tallies: list[Tally]
    grow: Callable[[int, int], None]

    def __call__(self, part: Part) -> None:
        """Take a part in."""
        self.tallies[part.drive].add(part)
        self.grow(part.done, part.todo)


def build_many(asked: Asked, choose: Choose) -> int:
    """Build several drives; returns the exit code: 1 where something failed."""
    with busy("looking at the drives"):
        listed = find_drives(asked.names, asked.usual)
        fleet = gather(listed.entries, choose)
    refused = {**listed.refused, **fleet.refused}
    for place, why in refused.items():
        err.complain(why, place)
    if not fleet.members:
        raise DataError(f"none of {len(refused)} drives can be built" if refused else "no drive to build")
    tallies = _build(asked, fleet)
    for member in tallies:
        _complain(member)
    _print(tallies)
    for place, why in refused.items():
        tallies.append(Tally(Path(place).name, place, Part(0, error=why)))
    out.print(f"wrote {write_summary(asked.cache, asked.command, tallies)}")
    return 0 if all(tally.is_whole for tally in tallies) else DATA_ERROR


def _build(asked: Asked, fleet: Fleet) -> list[Tally]:
    orders = [asked.order(member) for member in fleet.members]
    tallies = [Tally(member.name, str(member.entry.path)) for member in fleet.members]
    label = f"{len(orders)} drives" if len(orders) > 1 else orders[0].method.name
    with growing_progress(label) as grow:
        told = Progress(tallies, grow)
        if asked.engine.engine == "ray":
            from priors.scale.on_ray import build_on_ray

            build_on_ray(orders, asked.workers, told, asked.engine.share, asked.engine.address)
        else:
            build_here(orders, asked.workers, told, err.print)
    return tallies


def _complain(tally: Tally) -> None:
    part = tally.part
    if part.error:
        err.complain(part.error, tally.place)
    for frame_id, why in list(part.failed.items())[:MOST_ROWS]:
        err.complain(why.removeprefix(f"frame {frame_id}: "), f"{tally.place}, frame {frame_id}")
    if len(part.failed) > MOST_ROWS:
        err.complain(f"{len(part.failed) - MOST_ROWS} more frames failed: summary.json names them", tally.place)
    if part.left:
        err.complain(f"{part.left} frames were not reached: run the same command again", tally.place)


def _print(tallies: Sequence[Tally]) -> None:
    """Print a row a drive, those that are not whole first where there are too many, and one of all."""
    table = Table(box=SIMPLE_HEAD)
    table.add_column("drive")
    for heading in ("built", "cached", "skipped", "failed", "s/frame", "density"):
        table.add_column(heading, justify="right")
    shown = sorted(tallies, key=lambda tally: tally.is_whole)[:MOST_ROWS] if len(tallies) > MOST_ROWS else tallies
    for tally in shown:
        table.add_row(tally.name, *_cells(tally.part, len(tally.part.failed)))
    if len(tallies) > len(shown):
        table.add_row(f"... and {len(tallies) - len(shown)} more")
    if len(tallies) > 1:
        parts = [tally.part for tally in tallies]
        table.add_row("all", *_cells(reduce(add, parts), sum(len(part.failed) for part in parts)))
    out.print(table)


def _cells(part: Part, failed: int) -> list[str]:
    """Return a row's cells; `failed` frames: ids of several drives may be the same."""
    means = part.means()
    seconds, density = means["seconds"], means["density"]
    counts = map(str, (part.built, part.cached, part.skipped, failed))
    return [*counts, "-" if seconds is None else f"{seconds:.3f}", "-" if density is None else f"{density:.1%}"]
