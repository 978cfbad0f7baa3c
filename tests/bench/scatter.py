"""A plot of error against time: one labelled dot a method, time on a logarithmic axis."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

from priors.draw.figure import COLOURS, check_name, save, styled
from priors.draw.lines import MARKERS

SIZE_IN = (7.2, 4.2)
PLACES = tuple(
    (step, right)
    for steps in ((-3, 8, -14), (19, -25, 30, -36), (41, -47, 52, -58))
    for right in (True, False)
    for step in steps
)
"""Where a name may stand: its baseline above its dot, points, and on which side; the first free place is taken."""
BESIDE_PX = 25
"""Dots nearer in time than this are one above the other."""


@dataclass(frozen=True, slots=True)
class Dot:
    """One method."""

    label: str
    milliseconds: float
    error: float
    family: int = 0
    """Which colour and marker; dots of one family are joined."""


def write_scatter(path: Path, dots: Sequence[Dot], error_name: str, title: str) -> None:
    """Write the dots as .png, .svg or .pdf. Lower left is better."""
    check_name(path)
    with styled():
        made = Figure(figsize=SIZE_IN, layout="constrained")
        axes = made.subplots()
        axes.set(title=title, xlabel="time a frame", ylabel=error_name, xscale="log")
        for family in sorted({dot.family for dot in dots}):
            own = sorted((dot.milliseconds, dot.error) for dot in dots if dot.family == family)
            look = {"color": COLOURS[family % len(COLOURS)], "marker": MARKERS[family % len(MARKERS)]}
            axes.plot(*zip(*own, strict=True), linewidth=1, markersize=6, **look)
        axes.set_ylim(0, 1.08 * max(dot.error for dot in dots))
        _mark_times(axes, [dot.milliseconds for dot in dots])
        made.draw_without_rendering()  # lays out the axes: labels are placed in pixels
        _label(axes, dots)
    save(made, path)


def _mark_times(axes: Axes, milliseconds: Sequence[float]) -> None:
    """Let the time axis start and end at a tick of 1, 2 or 5 times a power of ten, with room for labels."""
    marks = np.array([base * 10.0**power for power, base in product(range(-1, 6), (1, 2, 5))])
    first = marks[marks <= min(milliseconds)].max()
    last = marks[marks >= 1.6 * max(milliseconds)].min()
    shown = marks[(marks >= first) & (marks <= last)]
    axes.set_xlim(first, last)
    axes.set_xticks(shown, [f"{mark:g} ms" if mark < 1000 else f"{mark / 1000:g} s" for mark in shown])
    axes.minorticks_off()


def _label(axes: Axes, dots: Sequence[Dot]) -> None:
    """Write each dot's name beside it, where it covers neither another name nor a dot.

    Names of dots that are one above the other stand in the order of the dots.
    """
    places = axes.transData.transform([(dot.milliseconds, dot.error) for dot in dots])
    taken = [Bbox.from_extents(x - 6, y - 6, x + 6, y + 6) for x, y in places]
    named: list[tuple[float, Bbox]] = []
    for i in sorted(range(len(dots)), key=lambda i: -dots[i].error):
        above = [box for x, box in named if abs(x - places[i][0]) < BESIDE_PX]
        for step, right in PLACES:
            text = _write(axes, dots[i], step, right)
            box = text.get_window_extent()
            inside = axes.bbox.x0 <= box.x0 and box.x1 <= axes.bbox.x1
            sorted_ = all(box.y0 < other.y0 for other in above if (other.x0 > places[i][0]) == right)
            if inside and sorted_ and not any(box.overlaps(other) for other in taken):
                break
            text.remove()
        else:
            box = _write(axes, dots[i], 0, True).get_window_extent()  # no room is left: better on top than absent
        taken.append(box)
        named.append((places[i][0], box))


def _write(axes: Axes, dot: Dot, step_pt: float, right: bool) -> Annotation:
    """Write a dot's name so many points above it, to its right or left; white behind it keeps it apart from lines."""
    place = {"xytext": (8 if right else -8, step_pt), "textcoords": "offset points", "ha": "left" if right else "right"}
    paper = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5}
    return axes.annotate(dot.label, (dot.milliseconds, dot.error), fontsize=8, bbox=paper, **place)
