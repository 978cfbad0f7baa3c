"""Tables of results: one row a prior, the best figure bold, the second underlined. CSV holds every figure in full."""

import csv
import io
import math
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table as RichTable

from eval import typeset
from eval.files import write_bytes
from eval.protocol import ScoreError
from eval.result import Result, refuse_to_mix
from eval.typeset import Column, Table, lay_out

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
    "d1_bg": Column("D1-bg", "%", digits=2),
    "d1_fg": Column("D1-fg", "%", digits=2),
    "bad_1": Column("bad-1", "%", digits=2),
    "bad_2": Column("bad-2", "%", digits=2),
    "bad_3": Column("bad-3", "%", digits=2),
    "flicker": Column("flicker", "%", digits=2, scale=100),
    "ause_abs_rel": Column("AUSE AbsRel", digits=4),
    "ause_rmse": Column("AUSE RMSE", "m"),
}
DEPTH_COLUMNS = (
    "density",
    "abs_rel",
    "sq_rel",
    "rmse",
    "rmse_log",
    "mae",
    "delta_1",
    "delta_2",
    "delta_3",
    "flicker",
    "density_image",
)
PROTOCOL_COLUMNS = {
    "kitti-completion": ("density", "rmse", "mae", "irmse", "imae", "abs_rel", "silog", "density_image"),
    "stereo2015": ("density", "epe", "d1", "d1_bg", "d1_fg", "bad_1", "bad_2", "bad_3", "density_image"),
}
"""What the readers of a protocol expect to see; DEPTH_COLUMNS for all others."""
IF_KNOWN = ("d1_bg", "d1_fg", "flicker")
"""Columns that stand only where a result has the figure: few truths tell foreground and background apart."""
USUAL_BRIEF = ("abs_rel", "rmse", "delta_1", "density")
BRIEF_COLUMNS = {"kitti-completion": ("rmse", "mae", "density"), "stereo2015": ("epe", "d1", "density")}
"""What they look at first, where there is no room for more; USUAL_BRIEF for all others."""


def table_of(results: Sequence[Result], keys: Sequence[str] | None = None) -> Table:
    """Lay out results by keys of COLUMNS (None: the protocol's usual ones).

    Raises:
        ScoreError: there is no result, a key is unknown, or the protocols differ.
    """
    if not results:
        raise ScoreError("no results to show: score a prior first")
    refuse_to_mix(results)
    keys = keys or usual_columns(results)
    unknown = [key for key in keys if key not in COLUMNS]
    if unknown:
        raise ScoreError(f"no metric {unknown[0]!r}: choose of {', '.join(COLUMNS)}")
    caption = f"{results[0].protocol.describe()}; {counts(results[0])}"
    rows = [((result.name,), result.metrics()) for result in results]
    return lay_out(("prior",), {key: COLUMNS[key] for key in keys}, rows, caption, notes(results))


def usual_columns(results: Sequence[Result]) -> tuple[str, ...]:
    """Return the columns of the results' protocol, without those of IF_KNOWN that no result has."""
    known = {key for result in results for key in result.metrics()}
    columns = PROTOCOL_COLUMNS.get(results[0].protocol.name, DEPTH_COLUMNS)
    return tuple(key for key in columns if key in known or key not in IF_KNOWN)


def counts(result: Result) -> str:
    """Say over how much a result was scored."""
    frames = "1 frame" if len(result.rows) == 1 else f"{len(result.rows)} frames"
    return f"{frames}, {result.sums.truth:,} truth pixels"


def notes(results: Sequence[Result]) -> list[str]:
    """Say what a reader must know before comparing rows: other frames, other truth, other density."""
    remarks = []
    frames = [{row.frame for row in result.rows} for result in results]
    every = set().union(*frames)
    for result, own in zip(results, frames, strict=True):
        lacking = sorted(every - own)
        if lacking:
            more = f" and {len(lacking) - 1} more" if len(lacking) > 1 else ""
            remarks.append(f"{result.name} covers {len(own)} of {len(every)} frames: not {lacking[0]}{more}")
    truths = {result.sums.truth for result in results}
    if not remarks and len(truths) > 1:
        remarks.append(f"same frames, but {min(truths):,} to {max(truths):,} truth pixels: the truth is not the same")
    densities = [result.metrics()["density"] for result in results]
    if max(densities) - min(densities) > 0.01:
        remarks.append("errors are over each row's own pixels: with other densities, other pixels")
    return remarks


def render(results: Sequence[Result], keys: Sequence[str] | None = None, width: int | None = None) -> RichTable:
    """Make a rich table; columns that do not fit into width characters are left out, last ones first, and named."""
    return typeset.render(table_of(results, keys), width)


def show(results: Sequence[Result], keys: Sequence[str] | None = None, console: Console | None = None) -> None:
    """Print the table; plain aligned text where the output is no terminal."""
    console = console or Console()
    if console.is_terminal:
        fitting = render(results, keys, console.width)
        if keys is None and len(fitting.columns) < len(render(results).columns):
            keys = brief_first(results)
        console.print(render(results, keys, console.width))
    else:
        console.print(plain(results, keys), end="", markup=False, highlight=False, soft_wrap=True)


def brief_first(results: Sequence[Result]) -> tuple[str, ...]:
    """Return a protocol's columns with those first that its readers look at first: a narrow terminal drops the last."""
    name = results[0].protocol.name
    brief = BRIEF_COLUMNS.get(name, USUAL_BRIEF)
    return brief + tuple(key for key in usual_columns(results) if key not in brief)


def plain(results: Sequence[Result], keys: Sequence[str] | None = None) -> str:
    """Write aligned text without marks."""
    return typeset.plain(table_of(results, keys))


def markdown(results: Sequence[Result], keys: Sequence[str] | None = None) -> str:
    """Write a Markdown table."""
    return typeset.markdown(table_of(results, keys))


def latex(results: Sequence[Result], keys: Sequence[str] | None = None) -> str:
    """Write a LaTeX table; needs the booktabs package."""
    return typeset.latex(table_of(results, keys))


def as_csv(results: Sequence[Result], keys: Sequence[str] | None = None) -> str:
    """Write every figure in full, both poolings a prior: for spreadsheets and scripts."""
    refuse_to_mix(results)
    keys = keys or tuple(COLUMNS)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["prior", "drive", "protocol", "pooling", "frames", "pixels", *keys])
    for result in results:
        start = [result.name, result.info.get("drive", ""), result.protocol.name]
        for pooling in ("image", "pixel"):
            figures = result.metrics(pooling)
            values = ["" if math.isnan(value := figures.get(key, math.nan)) else repr(value) for key in keys]
            writer.writerow([*start, pooling, len(result.rows), result.sums.count, *values])
    return out.getvalue()


WRITERS: dict[str, Callable[[Sequence[Result], Sequence[str] | None], str]] = {
    ".md": markdown,
    ".tex": latex,
    ".csv": as_csv,
    ".txt": plain,
}
HEADINGS = {".md": "## {}\n\n", ".tex": "% {}\n", ".txt": "{}\n"}
"""What stands above a table where a file has several; in a .csv the drive is a column."""


def save(sections: Sequence[tuple[str, Sequence[Result]]], path: Path, keys: Sequence[str] | None = None) -> None:
    """Write one file with a table of each section's results, in the format that the path's suffix names.

    Args:
        sections: a heading and results; the heading, a drive's name, is written where there are several sections.
        path: ends in one of WRITERS; its folder is made.
        keys: of COLUMNS; None: the protocol's usual ones, in a .csv all.

    Raises:
        ScoreError: another suffix, an unknown key, or different protocols in a section.
    """
    if path.suffix not in WRITERS:
        raise ScoreError(f"{path}: expected a table ending in {', '.join(WRITERS)}")
    write_bytes(path, _joined(sections, path.suffix, keys).encode())


def _joined(sections: Sequence[tuple[str, Sequence[Result]]], suffix: str, keys: Sequence[str] | None) -> str:
    """Write the tables of all sections one below the other."""
    tables = [WRITERS[suffix](results, keys) for _, results in sections]
    if suffix == ".csv":
        return tables[0] + "".join(table.partition("\n")[2] for table in tables[1:])
    if len(tables) == 1:
        return tables[0]
    headings = [HEADINGS[suffix].format(heading) for heading, _ in sections]
    return "\n".join(heading + table for heading, table in zip(headings, tables, strict=True))
