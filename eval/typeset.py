"""Typesetting: a table of figures is laid out once and written as text, Markdown, LaTeX or for the terminal.

The best figure of a group of rows is bold, the second underlined. Ranks are of the figures as printed, so equals share
a mark; a lone row has none.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from rich import box
from rich.table import Table as RichTable
from rich.text import Text

BEST, SECOND = "bold", "underline"
ESSENTIAL = 4
"""Columns that a narrow terminal shows before names are written on one line."""
NARROWEST = 16
"""Width of a folded name, characters."""


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


@dataclass(frozen=True, slots=True)
class Table:
    """A table before it is typeset."""

    heads: tuple[str, ...]
    """What the rows' names are, one or more leading columns."""
    columns: tuple[Column, ...]
    names: list[tuple[str, ...]]
    """One name a head for every row."""
    cells: list[list[str]]
    marks: list[list[str]]
    """BEST, SECOND or '' for every cell."""
    caption: str
    notes: list[str]
    starts: tuple[int, ...] = ()
    """Rows before which a rule is drawn: where a new group starts."""

    @property
    def remarks(self) -> list[str]:
        """Caption and notes, one line each; an empty caption is left out."""
        return [line for line in (self.caption, *self.notes) if line]


def lay_out(
    heads: Sequence[str],
    columns: Mapping[str, Column],
    rows: Sequence[tuple[tuple[str, ...], Mapping[str, float]]],
    caption: str = "",
    notes: Sequence[str] = (),
    group: int = 0,
) -> Table:
    """Lay out rows of names and figures; neighbouring rows with the same first `group` names are ranked together."""
    names = [name for name, _ in rows]
    cells = [[column.write(row.get(key, math.nan)) for key, column in columns.items()] for _, row in rows]
    starts = [i for i in range(len(names)) if i == 0 or names[i][:group] != names[i - 1][:group]]
    marks: list[list[str]] = []
    for start, end in zip(starts, [*starts[1:], len(names)], strict=True):
        ranked = [rank([row[i] for row in cells[start:end]], c.higher) for i, c in enumerate(columns.values())]
        marks += [list(row) for row in zip(*ranked, strict=True)]
    return Table(tuple(heads), tuple(columns.values()), names, cells, marks, caption, list(notes), tuple(starts[1:]))


def rank(cells: Sequence[str], higher: bool) -> list[str]:
    """Mark the best and the second of printed figures; nothing is marked among fewer than two different ones."""
    order = sorted({float(cell) for cell in cells if cell != "-"}, reverse=higher)
    names = dict(zip(order, (BEST, SECOND), strict=False)) if len(order) > 1 else {}
    return ["" if cell == "-" else names.get(float(cell), "") for cell in cells]


def render(table: Table, width: int | None = None) -> RichTable:
    """Make a rich table; columns that do not fit into width characters are left out, last ones first, and named.

    Names give way first: they are folded so that ESSENTIAL columns have room.
    """
    figures = [max(map(len, column)) for column in zip(*table.cells, strict=True)] or [0] * len(table.columns)
    widths = [max(len(column.label), widest) + 3 for column, widest in zip(table.columns, figures, strict=True)]
    leads = _lead_widths(table, None if width is None else width - sum(widths[:ESSENTIAL]))
    taken = sum(lead + 4 for lead in leads) + np.cumsum(widths)
    fit = len(widths) if width is None else max(1, int(np.count_nonzero(taken <= width)))
    hidden = [f"no room for {', '.join(column.label for column in table.columns[fit:])}"] * (fit < len(widths))
    caption = Text("\n".join([*table.remarks, *hidden]))  # names in it are no markup
    drawn = RichTable(box=box.SIMPLE_HEAD, caption=caption, caption_justify="left", padding=(0, 1, 0, 1))
    for head, lead in zip(table.heads, leads, strict=True):
        drawn.add_column(head, overflow="fold", min_width=lead, max_width=lead)
    for column in table.columns[:fit]:
        drawn.add_column(
            f"{column.label}\n{column.unit} {column.arrow}".replace("\n ", "\n"), justify="right", no_wrap=True
        )
    for i, (name, cells, marks) in enumerate(zip(table.names, table.cells, table.marks, strict=True)):
        if i in table.starts:
            drawn.add_section()
        marked = (Text.assemble((cell, mark)) for cell, mark in zip(cells[:fit], marks[:fit], strict=True))
        drawn.add_row(*map(Text, name), *marked)
    return drawn


def _lead_widths(table: Table, room: int | None) -> list[int]:
    """Return how wide the names' columns are drawn: as wide as the longest, or so that they fit into the room."""
    longest = [max(map(len, column)) for column in zip(table.heads, *table.names, strict=True)]
    if room is None or sum(longest) + 4 * len(longest) <= room:
        return longest
    widest = longest.index(max(longest))
    others = sum(longest) - longest[widest] + 4 * len(longest)
    longest[widest] = min(longest[widest], max(NARROWEST, room - others))
    return longest


def plain(table: Table) -> str:
    """Write aligned text without marks."""
    rows = [[*table.heads, *(column.title for column in table.columns)]]
    rows += [[*name, *cells] for name, cells in zip(table.names, table.cells, strict=True)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lead = len(table.heads)
    lines = [
        "  ".join(c.ljust(w) if i < lead else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True)))
        for row in rows
    ]
    return "\n".join([*lines, *table.remarks]) + "\n"


def markdown(table: Table) -> str:
    """Write a Markdown table."""
    wrap = {BEST: "**{}**", SECOND: "<u>{}</u>", "": "{}"}
    lines = [
        _bar([*table.heads, *(column.title for column in table.columns)]),
        f"|{'---|' * len(table.heads)}{'---:|' * len(table.columns)}",
    ]
    for name, cells, marks in zip(table.names, table.cells, table.marks, strict=True):
        marked = [wrap[mark].format(cell) for cell, mark in zip(cells, marks, strict=True)]
        lines.append(_bar([*(part.replace("|", "\\|") for part in name), *marked]))
    return "\n".join([*lines, "", *(f"{line}  " for line in table.remarks)]) + "\n"


def latex(table: Table) -> str:
    """Write a LaTeX table; needs the booktabs package."""
    wrap = {BEST: r"\textbf{{{}}}", SECOND: r"\underline{{{}}}", "": "{}"}
    head = " & ".join([*map(tex, table.heads), *(tex(column.title) for column in table.columns)])
    lines = [r"% \usepackage{booktabs}", *(f"% {line}" for line in table.remarks)]
    shape = "l" * len(table.heads) + "r" * len(table.columns)
    lines += [rf"\begin{{tabular}}{{{shape}}}", r"\toprule", rf"{head} \\", r"\midrule"]
    for i, (name, cells, marks) in enumerate(zip(table.names, table.cells, table.marks, strict=True)):
        marked = [wrap[mark].format(cell) for cell, mark in zip(cells, marks, strict=True)]
        lines += [r"\midrule"] * (i in table.starts)
        lines.append(" & ".join([*map(tex, name), *marked]) + r" \\")
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


def _bar(parts: Sequence[str]) -> str:
    return "| " + " | ".join(parts) + " |"
