"""The page of drives' priors: their figures, pictures, errors by distance and by confidence, and how they were made."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from eval import table
from eval.curves import Curves
from eval.reliability import BINS, Reliability
from eval.result import Result
from priors.cache import Prior
from priors.draw.lines import Line, Plot
from priors.report.blocks import Figure, Paragraph, Ranking, Record, Records
from priors.report.page import Block, Chapter, Page, Section
from priors.report.typed import build_command
from priors.report.wipe import Wipe, fit_into

BY_RANGE = ("abs_rel", "rmse")
"""What is drawn by true distance."""
BEST = "The best figure of a column stands out, the second is underlined. A click on a head sorts."


@dataclass(frozen=True)
class DriveScores:
    """What one drive's priors score, and what a page shows beside it."""

    results: list[Result]
    """A row of the table each, scored by one protocol; none where there is no truth."""
    curves: dict[str, list[Curves]] = field(default_factory=dict)
    """By a prior's name, of those with a confidence, where curves were asked for."""
    reliability: dict[str, list[Reliability]] = field(default_factory=dict)
    """By a prior's name, of those that state a probability, where it was asked for."""
    wipe: Wipe | None = None
    """Where a page was asked for."""
    priors: dict[str, Prior] = field(default_factory=dict)
    """By name; none where only result files are left."""
    left_out: dict[str, str] = field(default_factory=dict)
    """What could not be scored or kept -> why."""
    name: str = ""
    """The drive's name; empty: what the results say."""

    @property
    def drive(self) -> str:
        """Return the drive's name; empty where nothing says it."""
        return self.name or (str(self.results[0].info.get("drive", "")) if self.results else "")


def scores_page(scored: Sequence[DriveScores], keys: Sequence[str] | None, command: str, room: int) -> Page:
    """Lay out the page of drives' priors.

    Args:
        scored: of each drive.
        keys: the tables' columns; None: the protocol's usual ones.
        command: what made the page.
        room: how many bytes the pictures may take.

    Raises:
        ScoreError: the protocols of one drive's results differ, or a key is unknown.
    """
    drives = [each.drive for each in scored if each.drive]
    chapters = [priors_chapter(each, keys) for each in within(scored, room)]
    title = f"Depth priors of {', '.join(drives)}" if drives else "Depth priors"
    return Page(title, "Depth maps of a drive, made from its sensors, and what they are worth.", chapters, command)


def within(scored: Sequence[DriveScores], room: int) -> list[DriveScores]:
    """Leave pictured frames out, evenly, until all pictures fit into `room` bytes."""
    wipes = iter(fit_into([each.wipe for each in scored if each.wipe is not None], room))
    return [each if each.wipe is None else replace(each, wipe=next(wipes)) for each in scored]


def priors_chapter(scored: DriveScores, keys: Sequence[str] | None) -> Chapter:
    """Lay out one drive's priors."""
    plots = [plot for name, made in scored.curves.items() for plot in sparsification(name, made)]
    columns = max(map(len, scored.curves.values()), default=1)
    diagrams = [plot for name, found in scored.reliability.items() for plot in reliability_plots(name, found)]
    missing = [f"{what}: {why}" for what, why in scored.left_out.items()]
    figures: list[Block] = []
    if scored.results:
        figures = [
            Ranking(table.table_of(scored.results, keys or table.brief_first(scored.results))),
            *(Paragraph(f"Left out: {line}") for line in missing),
        ]
    elif missing:
        figures = [Paragraph(f"Not scored: {line}") for line in missing]
    return Chapter(
        f"Depth priors of {scored.drive}" if scored.drive else "Depth priors",
        BEST if scored.results else "",
        [
            Section("Table" if scored.results else "Scores", figures),
            Section("Frames", [] if scored.wipe is None else [scored.wipe]),
            Section("Error by true distance", [Figure(by_range(scored.results))] if scored.results else []),
            Section("Sparsification", [Paragraph(SPARSIFICATION), Figure(plots, columns)] if plots else []),
            Section(
                "Reliability", [Paragraph(RELIABILITY), Figure(diagrams, min(len(diagrams), 4))] if diagrams else []
            ),
            Section("How the priors were made", [records(scored.priors)] if scored.priors else []),
        ],
    )


SPARSIFICATION = (
    "The error of what is kept as the least confident pixels are dropped. A useful confidence lies below 'farthest "
    "first' and near the oracle, which drops the largest errors first."
)

RELIABILITY = (
    "The share of values that is right, for each probability that a prior states. On the diagonal what is said comes "
    "true; below it the prior is too sure. The bins' own line is the share of values that lie in each."
)


def records(priors: Mapping[str, Prior]) -> Records:
    """Say how each prior was made: its settings, and the command that makes it anew."""
    return Records([Record(name, facts(prior), [build_command(prior)]) for name, prior in priors.items()])


def facts(prior: Prior) -> dict[str, str]:
    """Name what a manifest says of a prior: method, settings, filters, weights, drive."""
    manifest = prior.manifest
    found = {
        "method": f"{prior.method}, version {manifest.get('version', 1)}",
        "drive": f"{prior.drive.get('path', prior.drive['name'])}, camera {prior.drive.get('camera')}",
        "maps": f"{len(prior.ids())} frames in {prior.folder}",
        **{name: _text(value) for name, value in manifest.get("config", {}).items() if value is not None},
        **{f"filter {name}": _text(value) for name, value in manifest.get("filters", {}).items()},
    }
    weights = manifest.get("weights")
    return found | ({"weights": _text(weights)} if weights else {})


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


def reliability_plots(name: str, made: Sequence[Reliability]) -> list[Plot]:
    """Plot what came true against what was stated, and how many values each bin holds, one plot a reading."""
    middles = (np.arange(BINS) + 0.5) / BINS
    return [
        Plot(
            [
                Line("right", 100 * one.stated, 100 * one.right),
                Line("share of the values in the bin", 100 * middles, 100 * one.share),
                Line("as stated", np.array([0.0, 100.0]), np.array([0.0, 100.0]), dashed=True),
            ],
            f"stated probability of an error within {one.within}, %",
            "values, %",
            f"{name}: calibration error {one.error:.3f}",
        )
        for one in made
    ]


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


def _text(value: object) -> str:
    """Write a setting."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {_text(inner)}" for name, inner in value.items()) or "-"
    if isinstance(value, list | tuple):
        return " ".join(map(_text, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
