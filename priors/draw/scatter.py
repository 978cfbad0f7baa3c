"""A plot of error against time: one labelled dot a method, time on a logarithmic axis, the front of the best drawn."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from priors.draw import figure
from priors.draw.lines import MARKERS, scale_y_by_logarithm

if TYPE_CHECKING:  # matplotlib takes half a second to import
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Annotation

SIZE_IN = (7.2, 4.2)
ROOM_IN = 0.16
"""What the plot is higher for each dot beyond the first dozen: their names need room."""
DOZEN = 12
PLACES = tuple(
    (step, right)
    for steps in ((-3, 8, -14), (19, -25, 30, -36), (41, -47, 52, -58), (63, -69, 74, -80))
    for right in (True, False)
    for step in steps
)
"""Where a name may stand: its baseline above its dot, points, and on which side; the first free place is taken."""
MANY = 8
"""Times the least error from which on the largest asks for a logarithmic axis."""
BESIDE_PX = 25
"""Dots nearer in time than this are one above the other."""


@dataclass(frozen=True, slots=True)
class Dot:
    """One method."""

    label: str
    milliseconds: float
    error: float
    family: str = ""
    """Dots of one family are joined and have one colour and marker."""
    on_front: bool = False
    """Whether no other method beats it."""


@dataclass(frozen=True, slots=True)
class Scatter:
    """Dots over a logarithmic axis of time. Lower left is better."""

    dots: Sequence[Dot]
    """One or more, with finite figures."""
    error_name: str
    """With its unit."""
    title: str = ""

    def says(self) -> str:
        """Say what it shows, for those who do not see it."""
        front = ", ".join(dot.label for dot in sorted(self.dots, key=lambda dot: dot.milliseconds) if dot.on_front)
        return f"{self.error_name} over time a frame of {len(self.dots)} methods; no other beats {front or 'any'}"

    def write(self, path: Path) -> None:
        """Write it as .png, .svg or .pdf; DataError where the name ends in none of them."""
        figure.check_name(path)
        figure.save(draw(self), path)

    def svg(self) -> str:
        """Return it as an SVG file's text."""
        return figure.encode(draw(self), ".svg").decode()


def draw(plot: Scatter) -> "Figure":
    """Draw dots, the lines of their families, the front, and a name at each dot."""
    from matplotlib.figure import Figure

    families = list(dict.fromkeys(dot.family for dot in plot.dots))
    height = SIZE_IN[1] + ROOM_IN * max(0, len(plot.dots) - DOZEN)
    with figure.styled():
        made = Figure(figsize=(SIZE_IN[0], height), layout="constrained")
        axes = made.subplots()
        axes.set(title=plot.title, xlabel="time a frame", ylabel=plot.error_name, xscale="log")
        _draw_front(axes, plot.dots)
        for number, family in enumerate(families):
            own = sorted((dot.milliseconds, dot.error) for dot in plot.dots if dot.family == family)
            colour = figure.COLOURS[number % len(figure.COLOURS)]
            marker = MARKERS[(number + number // len(figure.COLOURS)) % len(MARKERS)]  # the next round has others
            x, y = zip(*own, strict=True)
            axes.plot(x, y, linewidth=1, markersize=6, color=colour, marker=marker)
        _scale_errors(axes, [dot.error for dot in plot.dots])
        _mark_times(axes, [dot.milliseconds for dot in plot.dots])
        made.draw_without_rendering()  # lays out the axes: labels are placed in pixels
        _label(axes, plot.dots)
    return made


def _draw_front(axes: "Axes", dots: Sequence[Dot]) -> None:
    """Draw what can be had for a time: the least error of the front's dots that take no longer."""
    front = sorted((dot.milliseconds, dot.error) for dot in dots if dot.on_front)
    best = [(ms, min(error for _, error in front[: number + 1])) for number, (ms, _) in enumerate(front)]
    if best:
        x, y = zip(*best, strict=True)
        axes.step(x, y, where="post", color=figure.FAINT, linewidth=1.2, linestyle=(0, (5, 3)), zorder=0)


def _scale_errors(axes: "Axes", errors: Sequence[float]) -> None:
    """Let the errors start at 0; where the largest is many times the least, on a logarithmic axis."""
    if min(errors) > 0 and max(errors) > MANY * min(errors):
        scale_y_by_logarithm(axes)
        axes.set_ylim(min(errors) / 1.3, max(errors) * 1.3)
    else:
        axes.set_ylim(0, 1.08 * max(errors) or 1)


def _mark_times(axes: "Axes", milliseconds: Sequence[float]) -> None:
    """Let the time axis start and end at a tick of 1, 2 or 5 times a power of ten, with room for labels."""
    marks = np.array([base * 10.0**power for power, base in product(range(-4, 8), (1, 2, 5))])
    first = marks[marks <= min(milliseconds)].max()
    last = marks[marks >= 1.6 * max(milliseconds)].min()
    shown = marks[(marks >= first) & (marks <= last)]
    axes.set_xlim(first, last)
    axes.set_xticks(shown, [f"{mark:g} ms" if mark < 1000 else f"{mark / 1000:g} s" for mark in shown])
    axes.minorticks_off()


def _label(axes: "Axes", dots: Sequence[Dot]) -> None:
    """Write each dot's name beside it, where it covers neither another name nor a dot.

    Names of dots that are one above the other stand in the order of the dots.
    """
    from matplotlib.transforms import Bbox

    places = axes.transData.transform([(dot.milliseconds, dot.error) for dot in dots])
    taken = [Bbox.from_extents(x - 6, y - 6, x + 6, y + 6) for x, y in places]
    named: list[tuple[float, Bbox]] = []
    for i in sorted(range(len(dots)), key=lambda i: -dots[i].error):
        above = [box for x, box in named if abs(x - places[i][0]) < BESIDE_PX]
        for step, right in PLACES:
            text = _write(axes, dots[i], step, right)
            box = text.get_window_extent()
            inside = axes.bbox.x0 <= box.x0 and box.x1 <= axes.bbox.x1 and axes.bbox.y0 <= box.y0
            sorted_ = all(box.y0 < other.y0 for other in above if (other.x0 > places[i][0]) == right)
            if inside and sorted_ and not any(box.overlaps(other) for other in taken):
                break
            text.remove()
        else:
            box = _write(axes, dots[i], 0, True).get_window_extent()  # no room is left: better on top than absent
        taken.append(box)
        named.append((places[i][0], box))


def _write(axes: "Axes", dot: Dot, step_pt: float, right: bool) -> "Annotation":
    """Write a dot's name so many points above it, to its right or left; white behind it keeps it apart from lines."""
    return axes.annotate(
        dot.label,
        (dot.milliseconds, dot.error),
        xytext=(8 if right else -8, step_pt),
        textcoords="offset points",
        ha="left" if right else "right",
        fontsize=8,
        fontweight="bold" if dot.on_front else "normal",
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5},
    )
