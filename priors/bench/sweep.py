"""Sweep: how time and memory grow with the work. Each point is a process of its own, on one frame of the drive.

A slope is that of a line through the logarithms: 1 is linear growth, 2 quadratic. What does not grow with the work
(loading, a network's weights) makes slopes of memory small.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, get_args

import numpy as np

from eval import typeset
from eval.typeset import Column, Table
from priors.bench.entrants import Entrant
from priors.bench.fewer_lines import LINES
from priors.bench.scout import Scouted, send
from priors.draw.lines import Line, Plot
from priors.errors import DataError
from priors.methods.completion import Completion
from priors.methods.lidar import Lidar
from priors.methods.stereo import Stereo
from priors.types import Drive, Method

Axis = Literal["size", "disparity", "sweeps", "lines"]
AXES: tuple[Axis, ...] = get_args(Axis)
SHARES = (0.25, 0.35, 0.5, 0.7, 1.0)
"""Of an image's side."""
DISPARITIES_PX = (32, 64, 96, 128, 192, 256)
SWEEPS = (1, 3, 5, 11, 21, 41)
EVERY = (8, 4, 2, 1)
"""Which lines of a sweep are kept: every so many-th."""
NAMES: dict[Axis, str] = {
    "size": "pixels",
    "disparity": "disparities searched, px",
    "sweeps": "sweeps accumulated",
    "lines": "scan lines",
}
UNCORRECTED = (0.0, 0.0, 0.0)
"""The rectification is not measured: it would be at every point."""
FEWEST = 3
"""Points that a slope is made of."""


@dataclass(frozen=True)
class Measured:
    """A point of a sweep."""

    x: float
    found: Scouted


@dataclass(frozen=True)
class Growth:
    """How one way to make depth grows along an axis."""

    name: str
    points: tuple[Measured, ...]
    """Those that could be measured, ascending."""
    error: str = ""
    """Why the others could not be."""

    def slope(self, what: Callable[[Scouted], float]) -> float:
        """Return the slope of a figure's logarithm over that of the work; NaN with fewer than FEWEST points."""
        if len(self.points) < FEWEST:
            return float("nan")
        work = np.log([point.x for point in self.points])
        figure = np.log([what(point.found) for point in self.points])
        return float(np.polyfit(work, figure, 1)[0])


def sweep(
    axis: Axis,
    entrants: Sequence[Entrant],
    drive: Drive,
    frame: int,
    on_point: Callable[[str], None] = lambda name: None,
    scout: Callable[..., Scouted] = send,
) -> list[Growth]:
    """Measure how entrants grow along an axis, in turn from point to point.

    Args:
        axis: the image's size, the disparities that stereo searches, the sweeps that LiDAR accumulates, or their lines.
        entrants: who takes part in a sweep of the size; the others are one method's.
        drive: whose frame it is.
        frame: its index.
        on_point: told the name of an entrant after each point.
        scout: measures a point.

    Raises:
        DataError: nobody could be measured.
    """
    height, width = drive[frame].camera.size
    found: dict[str, list[Measured]] = {}
    errors: dict[str, str] = {}
    for x, share, name, method in points(axis, entrants, (height, width)):
        told = scout(method, drive, frame, None, share, round(LINES / x) if axis == "lines" else 1)
        if told.error:
            errors.setdefault(name, told.error)
        else:
            found.setdefault(name, []).append(Measured(x, told))
        on_point(name)
    if not found:
        raise DataError(f"--sweep {axis}: {next(iter(errors.values()), 'nothing to measure')}")
    return [Growth(name, tuple(found.get(name, ())), errors.get(name, "")) for name in {**found, **errors}]


def points(axis: Axis, entrants: Sequence[Entrant], size: tuple[int, int]) -> list[tuple[float, float, str, Method]]:
    """List the points of a sweep: the work, the share of the image's side, who does it, and how."""
    height, width = size
    if axis == "size":
        return [(round(height * s) * round(width * s), s, each.name, each.method) for s in SHARES for each in entrants]
    if axis == "disparity":
        makes = [partial(Stereo, model, offset_px=UNCORRECTED) for model in ("classical", "cfnet")]
        fitting = [most_px for most_px in DISPARITIES_PX if most_px < width]
        return [(n, 1.0, _name(make()), make(max_disparity_px=n)) for n in fitting for make in makes]
    if axis == "lines":
        of_lines: tuple[tuple[str, Method], ...] = (("lidar", Lidar()), ("completion", Completion(source="lidar")))
        return [(LINES / every, 1.0, name, method) for every in EVERY for name, method in of_lines]
    return [(count, 1.0, "lidar", Lidar(sweeps=count)) for count in SWEEPS]


def lay_out(over: str, grown: Sequence[Growth], caption: str) -> Table:
    """Lay out a row a way to make depth: slopes of processor time and of peak memory, and both ends."""
    columns = {
        "time": Column("slope of time", digits=2),
        "memory": Column("slope of memory", digits=2),
        "first": Column("least", "ms", digits=1),
        "last": Column("most", "ms", digits=1),
        "peak": Column("peak", "GiB", digits=2),
    }
    rows = [((growth.name,), _row(growth)) for growth in grown]
    notes = [f"{growth.name}: {growth.error}" for growth in grown if growth.error]
    return typeset.lay_out(("method",), columns, rows, f"{caption}; over {over}, processor time", notes)


def plots(over: str, grown: Sequence[Growth]) -> list[Plot]:
    """Draw time and memory over the work, both axes logarithmic."""
    figures: dict[str, Callable[[Scouted], float]] = {
        "processor time, ms": lambda told: 1e3 * told.processor_s,
        "peak memory, GiB": lambda told: told.peak_gib,
    }
    return [
        Plot(
            [
                Line(each.name, np.array([p.x for p in each.points]), np.array([what(p.found) for p in each.points]))
                for each in grown
                if each.points
            ],
            over,
            label,
            x_scale="log",
            y_scale="log",
        )
        for label, what in figures.items()
    ]


def _name(method: Stereo) -> str:
    return "stereo" if method.network is None else f"stereo {method.model}-{method.size}"


def _row(growth: Growth) -> dict[str, float]:
    if not growth.points:
        return {}
    times_ms = [1e3 * point.found.processor_s for point in growth.points]
    slopes = {"time": growth.slope(lambda told: told.processor_s), "memory": growth.slope(lambda told: told.peak_gib)}
    return slopes | {"first": times_ms[0], "last": times_ms[-1], "peak": growth.points[-1].found.peak_gib}
