"""Blocks of a page: text, tables, key figures, plots, videos, records. The comparison by a divider is in wipe.py."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from eval.typeset import Table
from priors.draw import figure, lines
from priors.draw.lines import Look, Plot
from priors.report.page import data_url

MARKS = {
    "o": "M11 6a3 3 0 1 0 6 0a3 3 0 1 0 -6 0",
    "s": "M11 3h6v6h-6z",
    "^": "M14 2.5l3.5 6.5h-7z",
    "D": "M14 2l4 4l-4 4l-4 -4z",
    "v": "M14 9.5l3.5 -6.5h-7z",
    "P": "M12.5 2.5h3v2h2v3h-2v2h-3v-2h-2v-3h2z",
    "X": "M11 4l1.5 -1.5l1.5 1.5l1.5 -1.5l1.5 1.5l-2 2l2 2l-1.5 1.5l-1.5 -1.5l-1.5 1.5l-1.5 -1.5l2 -2z",
}
"""The markers of priors.draw.lines as paths in a legend of 28 x 12."""


@dataclass(frozen=True, slots=True)
class Paragraph:
    """Text."""

    text: str
    template: ClassVar[str] = "paragraph.html.j2"


@dataclass(frozen=True, slots=True)
class Ranking:
    """A table; a click on a head sorts it."""

    table: Table
    template: ClassVar[str] = "ranking.html.j2"

    def value(self, row: int, column: int) -> str:
        """Return what a cell is sorted by: its number; empty where it has none."""
        cell = self.table.cells[row][column]
        try:
            return repr(float(cell)) if not math.isnan(float(cell)) else ""
        except ValueError:
            return ""


@dataclass(frozen=True, slots=True)
class KeyFigure:
    """A figure that a reader sees first: before and after."""

    label: str
    before: str
    after: str
    unit: str
    note: str
    """What changed, in words."""


@dataclass(frozen=True, slots=True)
class KeyFigures:
    """Key figures side by side."""

    figures: Sequence[KeyFigure]
    template: ClassVar[str] = "key_figures.html.j2"


@dataclass(frozen=True, slots=True)
class Figure:
    """Plots that stand together, under one legend where all have the same lines."""

    plots: Sequence[Plot]
    columns: int = 2
    """In a row, where a window is wide enough."""
    caption: str = ""
    template: ClassVar[str] = "figure.html.j2"

    @property
    def legend(self) -> list[Look]:
        """Return the lines that all plots have; empty where the plots differ."""
        each = [lines.looks(plot) for plot in self.plots]
        return each[0] if all(looks == each[0] for looks in each) else []

    def legend_of(self, plot: Plot) -> list[Look]:
        """Return the lines of one plot, where the plots differ."""
        return [] if self.legend else lines.looks(plot)

    def svg(self, plot: Plot, number: int) -> str:
        """Return a plot as an <svg> element in the page's colours; `number` makes its ids different from others'."""
        return coloured_svg(lines.svg([plot], legend=False), number)

    def says(self, plot: Plot) -> str:
        """Say what a plot shows, for those who do not see it."""
        title = f"{plot.title}: " if plot.title else ""
        return f"{title}{plot.y_label} over {plot.x_label}, of {', '.join(line.label for line in plot.lines)}"

    def mark(self, look: Look) -> str:
        """Return the path of a line's marker; empty for a dashed line."""
        return MARKS.get(look.marker, "")

    def colour(self, look: Look) -> str:
        """Return a line's colour as the page has it."""
        return _in_colours_of_the_page(look.colour)


@dataclass(frozen=True, slots=True)
class Clip:
    """A video with its caption."""

    caption: str
    data: bytes
    """An MP4 file."""
    template: ClassVar[str] = "clip.html.j2"

    @property
    def url(self) -> str:
        """Return the video as a data URL."""
        return data_url(self.data, "video/mp4")


@dataclass(frozen=True, slots=True)
class Record:
    """How one thing was made."""

    name: str
    facts: Mapping[str, str] = field(default_factory=dict)
    """Names and values, a line each."""
    commands: Sequence[str] = ()
    """As typed."""


@dataclass(frozen=True, slots=True)
class Records:
    """Records, each of which opens by a click."""

    records: Sequence[Record]
    template: ClassVar[str] = "records.html.j2"


@dataclass(frozen=True, slots=True)
class Commands:
    """Commands as they were typed."""

    lines: Sequence[str]
    template: ClassVar[str] = "commands.html.j2"


def coloured_svg(svg: str, number: int) -> str:
    """Return an SVG file's text as an element in the page's colours; `number` makes its ids different from others'."""
    text = svg[svg.index("<svg") :].strip()
    text = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>s{number}-", text)
    return _in_colours_of_the_page(text).replace("<svg ", '<svg aria-hidden="true" ', 1)


def _in_colours_of_the_page(svg: str) -> str:
    """Replace a drawing's colours by the page's own, which differ by day and by night."""
    names = {figure.INK: "ink", figure.FAINT: "faint", figure.GRID: "rule", "#ffffff": "paper"}
    names |= {colour: f"line-{number}" for number, colour in enumerate(figure.COLOURS, 1)}
    return re.sub(r"#[0-9a-f]{6}\b", lambda found: f"var(--{names[found[0]]})" if found[0] in names else found[0], svg)
