"""The table, the plot and the page's chapter of a bench."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from eval import table, typeset
from eval.files import write_bytes
from eval.protocol import Protocol
from eval.typeset import Column, Table
from priors.bench.front import on_front
from priors.bench.judge import CALIBRATION
from priors.bench.race import BUSY
from priors.bench.results import Bench, Standing, measured
from priors.draw.scatter import Dot, Scatter
from priors.report.blocks import Paragraph, Ranking, coloured_svg
from priors.report.page import Block, Chapter, Section

ERROR = "abs_rel"
SHOWN = (ERROR, "rmse", "mae", "delta_1", "epe", "d1", "density", "density_image", "ause_abs_rel")
COLUMNS = {
    "ms": Column("ms", digits=1),
    "spread_ms": Column("± ms", digits=1),
    "processor_ms": Column("processor", "ms", digits=1),
    "read_ms": Column("reading", "ms", digits=1),
    "peak_gib": Column("peak", "GiB", digits=2),
    **{key: table.COLUMNS[key] for key in SHOWN},
    CALIBRATION: Column("calibration", digits=3),
}
"""What a row shows; a column without a figure is left out."""
MARK = "*"
"""Stands before the name of what no other beats in time, error and density together."""


def lay_out(bench: Bench) -> Table:
    """Lay out a row an entrant, the fastest first."""
    shown = measured(bench.standings)
    marks = on_front([standing.worth(ERROR) for standing in shown])
    rows = [
        ((f"{MARK} {standing.name}" if mark else standing.name,), standing.figures())
        for standing, mark in zip(shown, marks, strict=True)
    ]
    have = {key for _, figures in rows for key, value in figures.items() if not math.isnan(value)}
    columns = {key: column for key, column in COLUMNS.items() if key in have}
    return typeset.lay_out(("prior",), columns, rows, caption(bench), notes(bench, any(marks)))


def caption(bench: Bench) -> str:
    """Say what was measured, on what."""
    asked, machine = bench.asked, bench.asked["machine"]
    height, width = asked["size"]
    frames = f"{len(asked['frames'])} frame{'s' * (len(asked['frames']) > 1)}"
    scored = "times alone" if asked["protocol"] is None else _protocol(asked["protocol"]).describe()
    busy = f", busy: load {bench.busy:.1f} a core" if bench.busy > BUSY else ""
    where = f"CPU mode {machine['cpu']}, {machine['threads']} of {machine['cores']} cores{busy}"
    return f"{asked['drive']}, {frames} of {width}x{height}; {scored}; {where}"


def notes(bench: Bench, has_front: bool) -> list[str]:
    """Say what a reader must know before comparing rows, and who did not take part."""
    frames = len(bench.asked["frames"])
    told = [f"{MARK} no other is as fast, as accurate and as dense"] if has_front else []
    fewer = [f"{each.name} {len(each.trials)}" for each in measured(bench.standings) if len(each.trials) < frames]
    told += [f"on fewer frames: {', '.join(fewer)}"] if fewer else []
    if any("calibration" in each.metrics() for each in bench.standings):
        told.append("calibration: gap of the stated probability and the share that is right, of those that state one")
    reasons: dict[str, list[str]] = {}
    for standing in bench.standings:
        if standing.error:
            reasons.setdefault(standing.error, []).append(standing.name)
    return told + [f"without {', '.join(names)}: {why}" for why, names in reasons.items()]


def scatter(bench: Bench) -> Scatter | None:
    """Draw error over time; None where nothing was scored.

    The front that is drawn is of those that are as dense as any, to a hundredth: the others leave pixels out.
    """
    shown = [each for each in measured(bench.standings) if not math.isnan(each.worth(ERROR).error)]
    if not shown:
        return None
    densest = max(each.worth().density for each in shown)
    dense = [each for each in shown if each.worth().density >= densest - 0.01]
    front = dict(zip((each.name for each in dense), on_front([each.worth() for each in dense]), strict=True))
    dots = [
        Dot(
            _label(each, shown) + ("" if each in dense else f" ({each.worth().density:.0%} dense)"),
            1e3 * each.seconds,
            each.worth().error,
            each.family,
            front.get(each.name, False),
        )
        for each in shown
    ]
    return Scatter(dots, table.COLUMNS[ERROR].label, f"{bench.asked['drive']}, {len(bench.asked['frames'])} frames")


def _label(standing: Standing, shown: Sequence[Standing]) -> str:
    """Name an entrant; of those that differ from a faster one in their runtime alone, by the runtime."""
    *words, last = standing.name.split()
    faster = shown[: shown.index(standing)]
    alike = [each for each in faster if words and each.family == standing.family and each.name.split()[:-1] == words]
    return last if alike else standing.name


def save(bench: Bench, folder: Path, laid: Table) -> list[Path]:
    """Write the table and the plot beside bench.json; returns the files."""
    files = [folder / "bench.md"]
    write_bytes(files[0], f"{typeset.markdown(laid)}\n```bash\n{bench.command}\n```\n".encode())
    drawn = scatter(bench)
    for suffix in (".svg", ".png") if drawn is not None else ():
        files.append(folder / f"bench{suffix}")
        drawn.write(files[-1])  # type: ignore[union-attr]
    return files


@dataclass(frozen=True, slots=True)
class Drawn:
    """A scatter plot on a page."""

    plot: Scatter
    template: ClassVar[str] = "drawn.html.j2"

    def svg(self, number: int) -> str:
        """Return the plot as an <svg> element in the page's colours; `number` makes its ids different from others'."""
        return coloured_svg(self.plot.svg(), number)


def chapter(bench: Bench) -> Chapter:
    """Lay out a bench as a chapter of a report page."""
    laid, drawn = lay_out(bench), scatter(bench)
    plot: Sequence[Block] = [] if drawn is None else [Drawn(drawn)]
    lead = [Paragraph(line) for line in (laid.caption, *laid.notes)]
    return Chapter(
        f"Run time against error of {bench.asked['drive']}",
        "Every way to make depth on the same frames, in turn.",
        [Section("Error against time", plot), Section("Times and errors", [Ranking(laid), *lead])],
    )


def _protocol(entry: dict[str, object]) -> Protocol:
    return Protocol(**{**entry, "ranges_m": tuple(entry["ranges_m"])})  # type: ignore[arg-type]
