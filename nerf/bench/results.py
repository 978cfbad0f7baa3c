"""Results of a bench: one table, one JSON file, and the curves drawn.

<bench>/bench.json    machine, command, every curve with its points
       /bench.md      the table, and what was typed
       /bench.svg .png  PSNR, LPIPS and AbsRel over wall time and over processor time; means over seeds
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from eval import typeset
from eval.files import write_bytes
from eval.typeset import Column, Table
from nerf.baseline import BASELINE
from nerf.bench.curve import Curve, Point
from nerf.bench.marks import READY, Mark
from nerf.split import HELD_OUT
from nerf.study import RunSpec
from nerf.study_table import COLUMNS, prior_labels
from priors.draw import lines
from priors.draw.lines import Line, Plot
from priors.errors import DataError
from priors.machine import cpu, threads

FORMAT = 1
DRAWN = ("psnr", "lpips_squeeze", "lpips_vgg", "abs_rel")
CLOCKS = {"seconds": "wall time of preparation and training, s", "processor_s": "processor time of all threads, s"}
"""What figures are drawn over: a row of plots each."""
SPREAD = "psnr_spread"
SPENT = {"seconds": 1, "processor_s": 1, "step": 0}
"""What a row says of a point's cost, and with how many digits."""
Group = tuple[RunSpec, str]
"""A run's choices but for the seed, and its variant."""


def lay_out(curves: Sequence[Curve], caption: str = "") -> Table:
    """Lay out a row a choice and mark: means over seeds; rows of one mark and as many views are ranked together.

    Raises:
        DataError: no fit has a point.
    """
    groups, rows = grouped(curves), []
    names, views = _names(list(groups)), list(dict.fromkeys(spec.views for spec, _ in groups))
    for group, members in groups.items():
        for mark, points in by_mark(members).items():
            spent = (f"{_mean(points, name):.{digits}f}" for name, digits in SPENT.items())
            at = "-" if mark == READY else str(mark)
            rows.append((mark, ((group[0].views, at, *names[group], *spent), mean_metrics(points))))
    if not rows:
        raise DataError(f"no fit has figures{''.join(f'; {c.entrant.name}: {c.error}' for c in curves[:1])}")
    rows.sort(key=lambda row: (views.index(row[1][0][0]), row[0].amount))
    have = {key for _, (_, figures) in rows for key in figures}
    columns: dict[str, Column] = {key: column for key, column in COLUMNS.items() if key in have}
    if SPREAD in have:
        columns = {"psnr": columns.pop("psnr"), SPREAD: Column("± seeds", "dB", digits=2), **columns}
    heads = ("views", "at", "field", "prior", "loss", "wall s", "processor s", "steps")
    return typeset.lay_out(heads, columns, [row for _, row in rows], caption, notes(curves), group=2)


def grouped(curves: Sequence[Curve]) -> dict[Group, list[Curve]]:
    """Put the curves together that differ in their seed or budget alone."""
    groups: dict[Group, list[Curve]] = {}
    for curve in curves:
        if curve.points:
            groups.setdefault((replace(curve.entrant.spec, seed=0), curve.entrant.variant), []).append(curve)
    return groups


def mean_metrics(points: Sequence[Point]) -> dict[str, float]:
    """Return the mean of every figure over seeds, and the spread of the PSNR where there are several."""
    keys = [key for key in points[0].metrics if all(key in point.metrics for point in points)]
    figures = {key: float(np.mean([point.metrics[key] for point in points])) for key in keys}
    spread = {SPREAD: float(np.std([point.metrics["psnr"] for point in points], ddof=1))} if len(points) > 1 else {}
    return figures | spread


def notes(curves: Sequence[Curve]) -> list[str]:
    """Say what the ceilings are, which fields end below the warp, and what failed."""
    last = {group: mean_metrics(_last(members))["psnr"] for group, members in grouped(curves).items()}
    names = _labels(list(last))
    ceilings = [
        f"ceiling of {names[group]}: {psnr:.2f} dB on the views that it was trained on"
        for group, psnr in last.items()
        if group[0].views == HELD_OUT
    ]
    failed = [f"{curve.entrant.name} failed: {curve.error}" for curve in curves if curve.error]
    return [*ceilings, *_below_the_warp(last), *failed]


def _below_the_warp(last: Mapping[Group, float]) -> list[str]:
    """Say which choices end with no better PSNR than the best warp of as many views."""
    names, found = _labels(list(last)), []
    for views in dict.fromkeys(spec.views for spec, _ in last):
        warps = [psnr for (spec, _), psnr in last.items() if spec.views == views and spec.field == BASELINE]
        fields = {group: psnr for group, psnr in last.items() if group[0].views == views and group[0].field != BASELINE}
        below = [f"{names[group]} ({psnr:.2f})" for group, psnr in fields.items() if warps and not psnr > max(warps)]
        if below:
            warp = f"the warp of the same frames, which is not trained ({max(warps):.2f} dB, {views} views)"
            found.append(f"no better than {warp}: {', '.join(below)}")
    return found


def plots(curves: Sequence[Curve]) -> list[Plot]:
    """Draw each figure over each clock: a line a choice; what is not trained, and ceilings, are dashed."""
    made = []
    for clock, x_label in CLOCKS.items():
        for key in DRAWN:
            drawn = _lines(curves, key, clock)
            label = ", ".join(part for part in (COLUMNS[key].label, COLUMNS[key].unit) if part)
            scale: Literal["log", "linear"] = "log" if key == "abs_rel" else "linear"
            if drawn:
                made.append(Plot(drawn, x_label, label, from_zero=False, y_scale=scale))
    return made


def _lines(curves: Sequence[Curve], key: str, clock: str) -> list[Line]:
    """Draw one figure over one clock; what is not trained is a level from the first point to the last."""
    groups, drawn = grouped(curves), []
    names = _labels(list(groups))
    spent = [getattr(point, clock) for curve in curves for point in curve.points if point.mark != READY] or [0.0, 1.0]
    for group, members in groups.items():
        ordered = list(by_mark(members).values())
        x = [_mean(points, clock) for points in ordered]
        y = [mean_metrics(points).get(key, math.nan) for points in ordered]
        is_ready = ordered[0][0].mark == READY
        if is_ready:
            x, y = [min(spent), max(spent)], y * 2
        if np.isfinite(y).any():
            dashed = is_ready or members[0].entrant.is_ceiling
            drawn.append(Line(f"{names[group]}, {group[0].views}", np.array(x), np.array(y), dashed))
    return drawn


def save(curves: Sequence[Curve], folder: Path, table: Table, command: str) -> list[Path]:
    """Write table, JSON and plots; returns the files."""
    records = [curve.record() for curve in curves]
    content = {"format": FORMAT, "command": command, "machine": machine(), "curves": records}
    files = {
        "bench.json": json.dumps(content, indent=1, allow_nan=False) + "\n",
        "bench.md": f"{typeset.markdown(table)}\n```bash\n{command}\n```\n",
    }
    for name, text in files.items():
        write_bytes(folder / name, text.encode())
    drawn = plots(curves)
    pictures = [folder / f"bench{suffix}" for suffix in (".svg", ".png")]
    for path in pictures:
        lines.write(path, drawn, columns=max(1, len(drawn) // len(CLOCKS)))
    return [*(folder / name for name in files), *pictures]


def machine() -> dict[str, Any]:
    """Name what the times depend on."""
    return {"cpu": cpu.mode(), "cores": threads.available(), "threads": threads.count()}


def by_mark(members: Sequence[Curve]) -> dict[Mark, list[Point]]:
    """Put the points of some curves together that are at one mark, in ascending order."""
    points = [point for curve in members for point in curve.points]
    return {mark: [each for each in points if each.mark == mark] for mark in sorted({each.mark for each in points})}


def _names(groups: Sequence[Group]) -> dict[Group, tuple[str, str, str]]:
    """Name a choice's field (with its variant), prior and loss."""
    priors = prior_labels([spec for spec, _ in groups])
    return {
        (spec, variant): (f"{spec.field} {variant}".strip(), priors[spec.prior], spec.loss or "-")
        for spec, variant in groups
    }


def _labels(groups: Sequence[Group]) -> dict[Group, str]:
    """Name a choice in one text; its loss only where losses differ."""
    losses = {spec.loss for spec, _ in groups if spec.loss}
    shown = 3 if len(losses) > 1 else 2
    return {group: " ".join(part for part in parts[:shown] if part != "-") for group, parts in _names(groups).items()}


def _last(members: Sequence[Curve]) -> list[Point]:
    """Return the points at the last mark that any of the curves has reached."""
    return list(by_mark(members).values())[-1]


def _mean(points: Sequence[Point], name: str) -> float:
    return float(np.mean([getattr(point, name) for point in points]))
