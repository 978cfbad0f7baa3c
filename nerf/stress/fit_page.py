"""The table of fits under stress as text and as a part of docs/numerics.md."""

import math
from collections.abc import Sequence

from nerf.stress.fits import Row

NAME = "nerf stress --fits"
"""What the page's marks are called."""
HEADS = ("fit", "PSNR dB", "AbsRel", "stated", "found")


def text(rows: Sequence[Row]) -> str:
    """Return a line a fit, and how many are not as stated."""
    cells = [HEADS, *map(_cells, rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in cells]
    return "\n".join([*lines, "", _counted(rows)]) + "\n"


def markdown(rows: Sequence[Row], caption: str) -> str:
    """Return the part of a page."""
    lines = [f"| {' | '.join(row)} |" for row in (HEADS, *map(_cells, rows))]
    command, _, where = caption.partition("\n\n")
    table = "\n".join([lines[0], "|---|---:|---:|---|---|", *lines[1:]])
    return f"    {command}\n\n{where}; {_counted(rows)}.\n\n{table}\n"


def _counted(rows: Sequence[Row]) -> str:
    return f"{len(rows)} fits, {sum(bool(row.fault) for row in rows)} not as stated"


def _cells(row: Row) -> tuple[str, ...]:
    psnr, abs_rel = ("-" if math.isnan(value) else f"{value:.{digits}f}" for value, digits in _figures(row))
    found = row.fault or ("refused" if row.told else "as stated" if row.stated else "")
    return row.case, psnr, abs_rel, row.stated, found


def _figures(row: Row) -> tuple[tuple[float, int], ...]:
    return (row.psnr, 2), (row.abs_rel, 4)
