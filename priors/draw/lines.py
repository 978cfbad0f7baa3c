"""Line plots: sparsification curves, errors over a choice, the course of a fit."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from priors.draw import figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

WIDTH_IN, HEIGHT_IN = 4.4, 3.2
"""Size of one plot, inches."""
LETTERS, TITLE_LETTERS = 56, 42
"""About how many letters of a legend and of a title are as wide as a plot."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
"""Tell lines apart without colours."""
FEW = 20
"""Lines of at most so many points have a marker on each, longer ones a few."""


@dataclass(frozen=True, slots=True)
class Line:
    """One curve."""

    label: str
    x: npt.NDArray[np.floating]
    """(n,)"""
    y: npt.NDArray[np.floating]
    """(n,); points that are not finite are left out."""
    dashed: bool = False
    """Draw it as a reference, not as a result."""


@dataclass(frozen=True, slots=True)
class Plot:
    """Curves over common axes."""

    lines: Sequence[Line]
    x_label: str
    """With its unit."""
    y_label: str
    """With its unit."""
    title: str = ""
    from_zero: bool = True
    """Start the y axis at 0 where nothing is negative; else (decibels) near the smallest value."""
    x_scale: Literal["linear", "whole", "log"] = "linear"
    """whole: linear, with ticks at whole numbers only; log: logarithmic, with ticks at the points' places."""
    y_scale: Literal["linear", "log"] = "linear"


@dataclass(frozen=True, slots=True)
class Look:
    """How a line looks: what a legend beside a plot shows."""

    label: str
    colour: str
    marker: str
    """One of MARKERS; empty: the line is dashed."""


def looks(plot: Plot) -> list[Look]:
    """Return how each of a plot's lines looks."""
    return [
        Look(line.label, colour, "" if line.dashed else marker)
        for line, colour, marker in zip(plot.lines, cycle(figure.COLOURS), cycle(MARKERS))
    ]


def draw(plots: Sequence[Plot], columns: int = 1, legend: bool = True) -> "Figure":
    """Draw plots in rows of `columns`, all of one size; one legend above where all have the same lines."""
    from matplotlib.figure import Figure

    rows = max(1, -(-len(plots) // columns))
    with figure.styled():
        made = Figure(figsize=(WIDTH_IN * columns, HEIGHT_IN * rows), layout="constrained")
        places = made.subplots(rows, columns, squeeze=False).ravel()
        drawn = [_draw(axes, plot) for axes, plot in zip(places, plots, strict=False)]
        for axes in places[len(plots) :]:
            axes.set_axis_off()
        labels = [[line.label for line in plot.lines] for plot in plots]
        if not legend:
            return made
        if len(plots) > 1 and all(names == labels[0] for names in labels):
            names = labels[0]
            fit = int(LETTERS * columns / (max(map(len, names), default=0) + 6))
            made.legend(drawn[0], names, loc="outside upper left", ncols=max(1, min(len(names), fit)))
        else:
            for axes, handles, names in zip(places, drawn, labels, strict=False):
                axes.legend(handles, names) if names else None
    return made


def write(path: Path, plots: Sequence[Plot], columns: int = 1) -> None:
    """Write plots as .png, .svg or .pdf; DataError where the name ends in none of them."""
    figure.check_name(path)
    figure.save(draw(plots, columns), path)


def svg(plots: Sequence[Plot], columns: int = 1, legend: bool = True) -> str:
    """Return plots as an SVG file's text."""
    return figure.encode(draw(plots, columns, legend), ".svg").decode()


def _draw(axes: "Axes", plot: Plot) -> "list[Line2D]":
    """Draw one plot; returns what a legend shows of its lines."""
    axes.set(title=textwrap.fill(plot.title, TITLE_LETTERS), xlabel=plot.x_label, ylabel=plot.y_label)
    drawn: list[Line2D] = []
    for line, look in zip(plot.lines, looks(plot), strict=True):
        finite = np.isfinite(line.x) & np.isfinite(line.y)
        every = max(1, np.count_nonzero(finite) // 10) if len(line.x) > FEW else 1
        marks = {"marker": look.marker, "markersize": 4.0, "markevery": every}
        more = marks if look.marker else {"linestyle": (0, (5, 3))}
        drawn += axes.plot(line.x[finite], line.y[finite], color=look.colour, linewidth=1.6, **more)
    values = [line.y[np.isfinite(line.y)] for line in plot.lines]
    if not any(each.size for each in values):
        axes.text(0.5, 0.5, "no values", transform=axes.transAxes, ha="center", color=figure.FAINT)
    elif plot.y_scale == "log":
        scale_y_by_logarithm(axes)
    elif plot.from_zero and min(float(each.min()) for each in values if each.size) >= 0:
        axes.set_ylim(bottom=0)
    _scale_x(axes, plot)
    return drawn


def scale_y_by_logarithm(axes: "Axes") -> None:
    """Set a logarithmic y axis, its ticks plain numbers: text is not parsed for mathematics."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _scale_x(axes: "Axes", plot: Plot) -> None:
    """Set the x axis's scale and ticks."""
    from matplotlib.ticker import MaxNLocator

    if plot.x_scale == "whole":
        axes.xaxis.set_major_locator(MaxNLocator("auto", integer=True))
    elif plot.x_scale == "log":
        marks = np.unique(np.concatenate([line.x for line in plot.lines]))
        axes.set_xscale("log")
        axes.set_xticks(marks, [f"{mark:g}" for mark in marks])
        axes.minorticks_off()
