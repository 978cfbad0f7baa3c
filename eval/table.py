"""Tables of results: one row a prior, the best figure bold, the second underlined.

Ranks are of the figures as printed, so equals share a mark; a lone row has none. CSV holds every figure in full.
"""

import csv
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from eval.protocol import ScoreError
from eval.result import Result, refuse_to_mix

BEST, SECOND = "bold", "underline"


@dataclass(frozen=True, slots=True)
class Column:
    """How one figure is printed."""

    label: str
    unit: str = ""
    higher: bool = False
    """Whether more is better."""
    digits: int = 3
    scale: float = 1.0
    """Printed = figure * scale."""

    @property
    def arrow(self) -> str:
        """Which way is better."""
        return "↑" if self.higher else "↓"

    @property
    def title(self) -> str:
        """Label, unit and arrow."""
        return f"{self.label}{f' {self.unit}' if self.unit else ''} {self.arrow}"

    def write(self, value: float) -> str:
        """Write a figure; '-' where there is none."""
        return "-" if math.isnan(value) else f"{value * self.scale:.{self.digits}f}"


COLUMNS = {
    "density": Column("density", "%", higher=True, digits=1, scale=100),
    "density_image": Column("of image", "%", higher=True, digits=1, scale=100),
    "abs_rel": Column("AbsRel", digits=4),
    "sq_rel": Column("SqRel", "m"),
    "rmse": Column("RMSE", "m"),
    "rmse_log": Column("RMSElog", digits=4),
    "silog": Column("SILog"),
    "log10": Column("log10", digits=4),
    "mae": Column("MAE", "m"),
    "irmse": Column("iRMSE", "1/km"),
    "imae": Column("iMAE", "1/km"),
    "delta_1": Column("δ<1.25", higher=True, digits=4),
    "delta_2": Column("δ<1.25²", higher=True, digits=4),
    "delta_3": Column("δ<1.25³", higher=True, digits=4),
    "epe": Column("EPE", "px"),
    "d1": Column("D1", "%", digits=2),
    "bad_1": Column("bad-1", "%", digits=2),
    "bad_2": Column("bad-2", "%", digits=2),
    "bad_3": Column("bad-3", "%", digits=2),
    "ause_abs_rel": Column("AUSE AbsRel", digits=4),
    "ause_rmse": Column("AUSE RMSE", "m"),
}
DEPTH = ("density", "abs_rel", "sq_rel", "rmse", "rmse_log", "mae", "delta_1", "delta_2", "delta_3", "density_image")
USUAL = {
    "kitti-completion": ("density", "rmse", "mae", "irmse", "imae", "abs_rel", "silog", "density_image"),
    "stereo2015": ("density", "epe", "d1", "bad_1", "bad_2", "bad_3", "density_image"),
}
"""What a protocol's readers expect to see; DEPTH for all others."""


@dataclass(frozen=True, slots=True)
class Sheet:
    """A table before it is typeset."""

    columns: tuple[Column, ...]
    names: list[str]
    cells: list[list[str]]
    marks: list[list[str]]
    """BEST, SECOND or '' for every cell."""
    caption: str
    notes: list[str]


def sheet(results: Sequence[Result], keys: Sequence[str] | None = None) -> Sheet:
    """Lay out results by keys of COLUMNS (None: the protocol's usual ones).

    Raises:
        ScoreError: there is no result, a key is unknown, or the protocols differ.
    """
    if not results:
        raise ScoreError("no results to show: score a prior first")
    refuse_to_mix(results)
    keys = keys or USUAL.get(results[0].protocol.name, DEPTH)
    unknown = [key for key in keys if key not in COLUMNS]
    if unknown:
        raise ScoreError(f"no metric {unknown[0]!r}: choose of {', '.join(COLUMNS)}")
    columns = tuple(COLUMNS[key] for key in keys)
    figures = [result.metrics() for result in results]
    cells = [
        [column.write(row.get(key, math.nan)) for key, column in zip(keys, columns, strict=True)] for row in figures
    ]
    ranked = [rank([row[i] for row in cells], column.higher) for i, column in enumerate(columns)]
    marks = [list(row) for row in zip(*ranked, strict=True)]
    caption = f"{results[0].protocol.describe()}; {counts(results[0])}"
    return Sheet(columns, [result.name for result in results], cells, marks, caption, notes(results))


def rank(cells: Sequence[str], higher: bool) -> list[str]:
    """Mark the best and the second of printed figures; nothing is marked among fewer than two different ones."""
    order = sorted({float(cell) for cell in cells if cell != "-"}, reverse=higher)
    names = dict(zip(order, (BEST, SECOND), strict=False)) if len(order) > 1 else {}
    return ["" if cell == "-" else names.get(float(cell), "") for cell in cells]


def counts(result: Result) -> str:
    """Say over how much a result was scored."""
    return f"{len(result.rows)} frame{'s' * (len(result.rows) != 1)}, {result.sums.truth:,} truth pixels"


def notes(results: Sequence[Result]) -> list[str]:
    """Say what a reader must know before comparing rows: other frames, other truth, other density."""
    found = []
    frames = [{row.frame for row in result.rows} for result in results]
    every = set().union(*frames)
    for result, own in zip(results, frames, strict=True):
        lacking = sorted(every - own)
        if lacking:
            more = f" and {len(lacking) - 1} more" if len(lacking) > 1 else ""
            found.append(f"{result.name} covers {len(own)} of {len(every)} frames: not {lacking[0]}{more}")
    truths = {result.sums.truth for result in results}
    if not found and len(truths) > 1:
        found.append(f"same frames, but {min(truths):,} to {max(truths):,} truth pixels: the truth is not the same")
    densities = [result.metrics()["density"] for result in results]
    if max(densities) - min(densities) > 0.01:
        found.append("errors are over each row's own pixels: with other densities, other pixels")
    return found


def render(results: Sequence[Result], keys: Sequence[str] | None = None, width: int | None = None) -> Table:
    """Make a rich table; columns that do not fit into width characters are left out, last ones first, and named."""
    laid = sheet(results, keys)
    widths = [max(len(column.label), *(len(row[i]) for row in laid.cells)) + 3 for i, column in enumerate(laid.columns)]
    taken = max(map(len, [*laid.names, "prior"])) + 4 + np.cumsum(widths)
    fit = len(widths) if width is None else max(1, int(np.count_nonzero(taken <= width)))
    hidden = [f"no room for {', '.join(column.label for column in laid.columns[fit:])}"] * (fit < len(widths))
    caption = "\n".join([laid.caption, *laid.notes, *hidden])
    table = Table(box=box.SIMPLE_HEAD, caption=caption, caption_justify="left", padding=(0, 1, 0, 1))
    table.add_column("prior", no_wrap=True)
    for column in laid.columns[:fit]:
        table.add_column(
            f"{column.label}\n{column.unit} {column.arrow}".replace("\n ", "\n"), justify="right", no_wrap=True
        )
    for name, cells, marks in zip(laid.names, laid.cells, laid.marks, strict=True):
        table.add_row(name, *(Text.assemble((cell, mark)) for cell, mark in zip(cells[:fit], marks[:fit], strict=True)))
    return table


def show(results: Sequence[Result], keys: Sequence[str] | None = None, console: Console | None = None) -> None:
    """Print the table; plain aligned text where the output is no terminal."""
    console = console or Console()
    if console.is_terminal:
        console.print(render(results, keys, console.width))
    else:
        console.file.write(plain(results, keys))


def plain(results: Sequence[Result], keys: Sequence[str] | None = None) -> str:
    """Write aligned text without marks."""
    laid = sheet(results, keys)
    rows = [["prior", *(column.title for column in laid.columns)]]
    rows += [[name, *cells] for name, cells in zip(laid.names, laid.cells, strict=True)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))])
        for row in rows
    ]
    return "\n".join([*lines, laid.caption, *laid.notes]) + "\n"


def markdown(results: Sequence[Result], keys: Sequence[str] | None = None) -> str:
    """Write a Markdown table."""
    laid = sheet(results, keys)
    wrap = {BEST: "**{}**", SECOND: "<u>{}</u>", "": "{}"}
    lines = [
        "| prior | " + " | ".join(column.title for column in laid.columns) + " |",
        "|---|" + "---:|" * len(laid.columns),
    ]
    for name, cells, marks in zip(laid.names, laid.cells, laid.marks, strict=True):
        marked = [wrap[mark].format(cell) for cell, mark in zip(cells, marks, strict=True)]
        lines.append(f"| {name.replace('|', chr(92) + '|')} | " + " | ".join(marked) + " |")
    return "\n".join([*lines, "", *(f"{line}  " for line in [laid.caption, *laid.notes])]) + "\n"


def latex(results: Sequence[Result], keys: Sequence[str] | None = None) -> str:
    """Write a LaTeX table; needs the booktabs package."""
    laid = sheet(results, keys)
    wrap = {BEST: r"\textbf{{{}}}", SECOND: r"\underline{{{}}}", "": "{}"}
    head = " & ".join(["prior", *(tex(column.title) for column in laid.columns)])
    lines = [r"% \usepackage{booktabs}", *(f"% {line}" for line in [laid.caption, *laid.notes])]
    lines += [rf"\begin{{tabular}}{{l{'r' * len(laid.columns)}}}", r"\toprule", rf"{head} \\", r"\midrule"]
    for name, cells, marks in zip(laid.names, laid.cells, laid.marks, strict=True):
        marked = [wrap[mark].format(cell) for cell, mark in zip(cells, marks, strict=True)]
        lines.append(" & ".join([tex(name), *marked]) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"


def tex(text: str) -> str:
    """Escape a title or a name for LaTeX."""
    escapes = {"\\": r"\textbackslash{}", "δ<": r"$\delta<$", "²": "$^2$", "³": "$^3$", "↑": r"$\uparrow$"}
    escapes |= {"↓": r"$\downarrow$", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    escapes |= {sign: f"\\{sign}" for sign in "%_&#${}"}
    out, rest = "", text
    while rest:
        sign = next((sign for sign in escapes if rest.startswith(sign)), rest[0])
        out, rest = out + escapes.get(sign, sign), rest[len(sign) :]
    return out


def as_csv(results: Sequence[Result], keys: Sequence[str] | None = None) -> str:
    """Write every figure in full, both poolings a prior: for spreadsheets and scripts."""
    refuse_to_mix(results)
    keys = keys or tuple(COLUMNS)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["prior", "protocol", "pooling", "frames", "pixels", *keys])
    for result in results:
        for pooling in ("image", "pixel"):
            figures = result.metrics(pooling)
            values = ["" if math.isnan(value := figures.get(key, math.nan)) else repr(value) for key in keys]
            writer.writerow([result.name, result.protocol.name, pooling, len(result.rows), result.sums.count, *values])
    return out.getvalue()


WRITERS: dict[str, Callable[[Sequence[Result]], str]] = {
    ".md": markdown,
    ".tex": latex,
    ".csv": as_csv,
    ".txt": plain,
}


def save(results: Sequence[Result], path: Path) -> None:
    """Write the table in the format that the path's suffix names.

    Raises:
        ScoreError: the suffix is none of .md, .tex, .csv, .txt.
    """
    if path.suffix not in WRITERS:
        raise ScoreError(f"{path}: expected a table ending in {', '.join(WRITERS)}")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(WRITERS[path.suffix](results))
