"""The report page of a drive's priors: their figures, their errors by distance and by confidence, pictures."""

from collections.abc import Mapping, Sequence

import numpy as np

from eval import table
from eval.curves import Curves
from eval.result import Result
from priors.cache import Prior
from priors.draw.comparison import compare
from priors.draw.lines import Line, Plot
from priors.report.page import PICTURED, Figure, Page, Picture, Section
from priors.selection import pick_middles, select
from priors.types import Drive

BY_RANGE = ("abs_rel", "rmse")
"""What is drawn by true distance."""
TILE_PX = 400
"""Width of each map there."""


def scores_page(
    results: Sequence[Result],
    keys: Sequence[str] | None,
    curves: Mapping[str, Sequence[Curves]],
    pictures: Sequence[Picture],
    command: str,
) -> Page:
    """Lay out the page of one drive's results.

    Args:
        results: a row of the table each, scored by one protocol.
        keys: the table's columns; None: the protocol's usual ones.
        curves: by a prior's name, of the priors that have a confidence.
        pictures: of some frames.
        command: what made the page.

    Raises:
        ScoreError: the protocols differ, or a key is unknown.
    """
    drives = sorted({str(result.info["drive"]) for result in results if "drive" in result.info})
    rows = [plot for name, made in curves.items() for plot in sparsification(name, made)]
    columns = max((len(made) for made in curves.values()), default=1)
    sparsified = [Figure(rows, columns)] if rows else []
    return Page(
        f"Depth priors of {', '.join(drives)}" if drives else "Depth priors",
        "Depth maps scored against the truth. The best figure of a column is bold, the second underlined.",
        [
            Section("Figures", table=table.table_of(results, keys)),
            Section("Error by true distance", figures=[Figure(by_range(results), len(BY_RANGE))]),
            Section("Sparsification: the error as the least confident pixels are dropped", figures=sparsified),
            Section("Frames", pictures=pictures),
            Section("How it was made", commands=[command]),
        ],
    )


def picture_frames(
    drive: Drive, priors: Sequence[Prior], names: Sequence[str], frames: str | None = None
) -> list[Picture]:
    """Draw the maps of some frames that are spread evenly over those with maps.

    Args:
        drive: the drive of all the priors.
        priors: whose maps.
        names: what to call each.
        frames: only of this range of frames, a:b.
    """
    cached = {id_ for prior in priors for id_ in prior.ids()}
    indices = [index for index in select(drive.ids, frames) if drive.ids[index] in cached]
    pictures = []
    for index in pick_middles(indices, PICTURED):
        frame = drive[index]
        rows = [(name, prior.read(frame.id)) for name, prior in zip(names, priors, strict=True) if prior.has(frame.id)]
        pictures.append(Picture(f"frame {frame.id}", compare(frame, rows, TILE_PX)))
    return pictures


def sparsification(name: str, made: Sequence[Curves]) -> list[Plot]:
    """Plot how a prior's errors fall as the least confident pixels are dropped, one plot a metric."""
    plots = []
    for curve in made:
        kept = 100 * curve.kept
        lines = [
            Line("by confidence", kept, curve.by_confidence),
            Line("farthest first", kept, curve.farthest_first),
            Line("oracle", kept, curve.oracle, dashed=True),
        ]
        plots.append(Plot(lines, "pixels kept, %", _axis(curve.metric), name))
    return plots


def by_range(results: Sequence[Result]) -> list[Plot]:
    """Plot each prior's errors over the true distance: a point a range, at its middle."""
    edges = results[0].protocol.bins()
    middles = np.array([(low + high) / 2 if np.isfinite(high) else low for low, high in edges])
    ends = ", ".join(f"{low:g}-{high:g}" if np.isfinite(high) else f"from {low:g}" for low, high in edges)
    plots = []
    for key in BY_RANGE:
        lines = [
            Line(result.name, middles, np.array([figures[key] for _, figures in result.by_range()]))
            for result in results
        ]
        plots.append(Plot(lines, f"true distance, m (ranges {ends})", _axis(key)))
    return plots


def _axis(key: str) -> str:
    """Name a metric as an axis does: with its unit."""
    column = table.COLUMNS[key]
    return f"{column.label}, {column.unit}" if column.unit else column.label
