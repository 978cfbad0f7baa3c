"""The report page of runs: their figures, view by view, the course of their fits, pictures and settings."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from eval.typeset import Table
from nerf.config import FitConfig
from nerf.report import Report
from nerf.run import Run
from priors.draw.lines import Line, Plot
from priors.filters import Filters
from priors.report.page import Figure, Page, Picture, Section

POINTS = 40
"""Points of a fit's curve: each is a mean, since the PSNR of single batches is noise."""


def runs_page(
    runs: Sequence[Run], reports: Sequence[Report], table: Table, pictures: Sequence[Picture], command: str
) -> Page:
    """Lay out the page of runs and their reports, in one order; `command` is what made the page."""
    names = [run.name for run in runs]
    views = [Figure(by_view(names, reports), 2)] if len(reports[0].frames) > 1 else []
    courses = [line for run in runs for line in course(run)]
    fits = Plot(courses, "time, s", "PSNR of the training batch, dB", from_zero=False)
    return Page(
        f"Radiance fields: {', '.join(names)}",
        "Scored on views that were held out of training. The best figure of a column is bold, the second underlined.",
        [
            Section("Figures", table=table),
            Section("View by view", figures=views),
            Section("Fit", figures=[Figure([fits])] if courses else []),
            Section("Held-out views", pictures=pictures),
            *(Section(f"Settings of {run.name}", facts=facts(run)) for run in runs),
            Section("How it was made", commands=[command]),
        ],
    )


def by_view(names: Sequence[str], reports: Sequence[Report]) -> list[Plot]:
    """Plot PSNR and depth error of each held-out view, a line a run; the error only where there is a true depth."""
    plots = []
    for key, label, from_zero in (("psnr", "PSNR, dB", False), ("rmse", "depth RMSE, m", True)):
        lines = []
        for name, report in zip(names, reports, strict=True):
            values = np.array([frame.figures()[key] for frame in report.frames])
            lines.append(Line(name, np.arange(1.0, len(values) + 1), values))
        if any(np.isfinite(line.y).any() for line in lines):
            plots.append(
                Plot(lines, "held-out view, in the drive's order", label, from_zero=from_zero, x_scale="whole")
            )
    return plots


def course(run: Run) -> list[Line]:
    """Return the PSNR of a run's training batches over time, in POINTS means; nothing where no log is left."""
    seconds, psnr = _log(run.folder / "metrics.jsonl")
    if not len(seconds):
        return []
    parts = np.array_split(np.arange(len(seconds)), min(POINTS, len(seconds)))
    means = [(seconds[part].mean(), psnr[part].mean()) for part in parts]
    return [Line(run.name, *np.array(means).T)]


def facts(run: Run) -> dict[str, str]:
    """Name what a run was asked for: its data, and every setting that is not the usual one."""
    config = run.config
    found = {
        "drive": str(config.drive.get("path", "")),
        "prior": config.prior or "none: colours alone",
        "frames": config.frames or "all",
        "training views": config.views,
        "budget": f"{config.fit.steps} steps" if config.fit.steps is not None else f"{config.fit.seconds:g} s",
        "field": config.fit.model.family,
        "seed": str(config.fit.seed),
    }
    found |= _unusual(asdict(config.filters), asdict(Filters()), "filter ")
    usual = asdict(FitConfig(steps=config.fit.steps, seconds=config.fit.seconds, seed=config.fit.seed))
    usual["model"]["family"] = config.fit.model.family
    return found | _unusual(asdict(config.fit), usual)


def _unusual(values: Mapping[str, Any], usual: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Return the settings that differ from the usual ones, nested ones as `outer.inner`."""
    found: dict[str, str] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            found |= _unusual(value, usual.get(name) or {}, f"{prefix}{name}.")
        elif value != usual.get(name):
            found[f"{prefix}{name}"] = str(value)
    return found


def _log(path: Path) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Read seconds and PSNR of a fit's log, in the order of its steps; a resumed fit's later line replaces a step's."""
    steps: dict[int, tuple[float, float]] = {}
    for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        try:
            line = json.loads(text)
        except ValueError:
            continue  # cut off by a kill
        steps[line["step"]] = (line["seconds"], line["psnr"])
    rows = np.array([steps[step] for step in sorted(steps)]).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]
