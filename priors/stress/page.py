"""The table as text and as a part of docs/numerics.md."""

from collections.abc import Sequence
from itertools import count
from pathlib import Path

from eval.files import write_bytes
from priors.errors import DataError
from priors.stress import tolerances
from priors.stress.precision import PRECISIONS
from priors.stress.table import Cell, Table

NAMES = [precision.name for precision in PRECISIONS]
HEADS = ("routine", *NAMES, *(f"{name} gradient" for name in NAMES), "cells", "fail")


def text(table: Table) -> str:
    """Return a line a routine, then the cells that fail, then the tolerances."""
    rows = [HEADS, *(_summary(table, name) for name in table.routines)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join([row[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True))])
        for row in rows
    ]
    failures = [f"{cell.routine}, {cell.input}, {cell.precision}: {told(cell)}" for cell in table.failures]
    done = sum(cell.verdict != "no sense" for cell in table.cells)
    counted = f"CPU mode {table.mode}: {done} cells, {len(failures)} fail; {len(table.cells) - done} make no sense"
    return "\n".join([*lines, "", *failures, *([""] if failures else []), counted, tolerances.told()]) + "\n"


def told(cell: Cell) -> str:
    """Say what fails in a cell."""
    parts = [cell.why] if cell.why else []
    for name, found, limits in (
        ("value", cell.value, tolerances.VALUE),
        ("gradient", cell.gradient, tolerances.GRADIENT),
    ):
        if found is not None and found > limits[cell.precision]:
            parts.append(f"{name} off by {found:.2g}, more than {limits[cell.precision]:.2g}")
    return "; ".join(parts)


def markdown(tables: Sequence[Table], command: str) -> str:
    """Return the part of a page: errors by precision, tolerance used by CPU mode, errors by input; tables[0] first."""
    first = tables[0]
    parts = [
        f"    {command}",
        f"Largest errors in CPU mode `{first.mode}`. {tolerances.told().capitalize()}.",
        _bars([HEADS, *(_summary(first, name) for name in first.routines)]),
        "Share of its tolerance that a routine uses at most, over all inputs, precisions, values and gradients:",
        _bars([("routine", *(f"`{t.mode}`" for t in tables)), *(_by_mode(tables, name) for name in first.routines)]),
        f"Largest error in float32 (value, then gradient) by input, mode `{first.mode}`; a number in brackets says "
        "why a cell makes no sense:",
        _by_input(first),
    ]
    return "\n\n".join(parts) + "\n"


def around(path: Path, name: str) -> tuple[str, str]:
    """Return what stands before and after a page's tables: up to `<!-- NAME -->`, from `<!-- end of NAME -->` on.

    A page that is not there has nothing else. Raises DataError where the page lacks the marks.
    """
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    page = path.read_text(encoding="utf-8") if path.exists() else f"{begin}\n{end}\n"
    if page.count(begin) != 1 or page.count(end) != 1 or page.index(begin) > page.index(end):
        raise DataError(f"{path}: expected the lines {begin} and {end}, between which the tables go: add them")
    return page[: page.index(begin) + len(begin)], page[page.index(end) :]


def put_into(path: Path, name: str, part: str) -> None:
    """Put tables between a page's marks; the rest stays."""
    before, after = around(path, name)
    write_bytes(path, f"{before}\n\n{part}\n{after}".encode())


def _summary(table: Table, name: str) -> tuple[str, ...]:
    cells = table.of(name)
    errors = [_written(table.worst(name, precision, what)) for what in ("value", "gradient") for precision in NAMES]
    done = [cell for cell in cells if cell.verdict != "no sense"]
    return (name, *errors, str(len(done)), str(sum(cell.verdict == "fails" for cell in done)))


def _by_mode(tables: Sequence[Table], name: str) -> tuple[str, ...]:
    return (name, *(f"{table.used(name):.2g}" for table in tables))


def _by_input(table: Table) -> str:
    """Return the table of routines and inputs, and the reasons below it."""
    numbers, reasons = count(1), dict[str, int]()

    def cell(name: str, input_: str) -> str:
        found = next(c for c in table.of(name, NAMES[0]) if c.input == input_)
        if found.verdict == "no sense":
            if found.why not in reasons:
                reasons[found.why] = next(numbers)
            return f"[{reasons[found.why]}]"
        if found.value is None:
            return found.why
        return _written(found.value) + ("" if found.gradient is None else f", {_written(found.gradient)}")

    inputs = list(dict.fromkeys(c.input for c in table.cells))
    rows = [(name, *(cell(name, each) for each in inputs)) for name in table.routines]
    told = "; ".join(f"[{number}] {why}" for why, number in reasons.items())
    return _bars([("routine", *inputs), *rows]) + f"\n\n{told}"


def _written(error: float | None) -> str:
    return "-" if error is None else "0" if error == 0 else f"{error:.0e}"


def _bars(rows: Sequence[tuple[str, ...]]) -> str:
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([lines[0], f"|---|{'---:|' * (len(rows[0]) - 1)}", *lines[1:]])
