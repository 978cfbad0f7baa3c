"""The page of runs: their figures, held-out views to compare, the course of their fits, videos, settings, commands."""

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eval import typeset
from eval.typeset import Column, Table
from nerf import journal
from nerf.baseline import unbeaten
from nerf.config import FitConfig
from nerf.report import Report
from nerf.run import Run, names_of
from nerf.study_table import COLUMNS
from priors.draw.lines import Line, Plot
from priors.filters import Filters
from priors.report.blocks import Clip, Figure, KeyFigure, KeyFigures, Paragraph, Ranking, Record, Records
from priors.report.page import Chapter, Section
from priors.report.scores import BEST
from priors.report.typed import flags
from priors.report.wipe import Wipe

POINTS = 40
"""Points of a fit's curve: each is a mean, since the figures of single batches are noise."""
KEYS = ("psnr", "rmse", "abs_rel")
"""What a reader sees first."""
NO_FLAG = ("model.log2_size", "model.finest", "optimiser.")
"""Settings that only a program in Python can choose."""
COURSES = (
    ("psnr", "step", "step", "PSNR of the training batch, dB"),
    ("loss", "step", "step", "loss, all terms"),
    ("depth", "step", "step", "depth loss"),
)
"""What is drawn of a fit's log: y, x and their labels."""
NONE = np.zeros(0)
"""The course of what a fit does not log, as a depth loss without a prior: its line keeps its colour."""
VIDEO = "video.mp4"


@dataclass(frozen=True)
class FieldScores:
    """The runs of one drive, and what a page shows of them; runs and reports are in one order."""

    runs: Sequence[Run]
    reports: Sequence[Report]
    wipe: Wipe | None = None
    videos: bool = True
    """Whether the runs' videos have room."""

    @property
    def names(self) -> list[str]:
        """Return the runs' names, each different."""
        return names_of(self.runs)

    @property
    def drive(self) -> str:
        """Return the drive's name."""
        return str(self.runs[0].config.drive.get("name") or Path(str(self.runs[0].config.drive.get("path"))).name)

    @property
    def figures(self) -> dict[tuple[str, str], dict[str, float]]:
        """Return every view's figures, by run and frame."""
        made = zip(self.names, self.reports, strict=True)
        return {(name, frame.frame): frame.figures() for name, report in made for frame in report.frames}

    @property
    def video_files(self) -> list[tuple[str, Path]]:
        """List the runs' names and videos, where `nerf video` has written them."""
        files = [(name, run.folder / VIDEO) for name, run in zip(self.names, self.runs, strict=True)]
        return [(name, path) for name, path in files if path.is_file()]


def fields_chapter(scored: FieldScores) -> Chapter:
    """Lay out the runs of one drive."""
    names, reports = scored.names, scored.reports
    table = Ranking(lay_out(names, reports))
    first = key_figures(scored)
    views = by_view(names, reports) if len(reports[0].frames) > 1 else []
    fits = courses(names, scored.runs)
    return Chapter(
        f"Radiance fields of {scored.drive}",
        f"Scored on views that were held out of training. {BEST}",
        [
            Section("Table", [first, table] if first else [table]),
            Section("Held-out views", [] if scored.wipe is None else [scored.wipe]),
            Section("View by view", [Figure(views)] if views else []),
            Section("Course of the fits", [Figure(fits, 3)] if fits else []),
            Section("Videos", videos(scored)),
            Section("How the fields were made", [Records(list(map(_record, names, scored.runs)))]),
        ],
    )


def lay_out(names: Sequence[str], reports: Sequence[Report]) -> Table:
    """Lay out a row a run."""
    rows = [((name,), each.metrics()) for name, each in zip(names, reports, strict=True)]
    have = {key for _, figures in rows for key in figures}
    columns = {key: column for key, column in COLUMNS.items() if key in have}
    caption = f"{reports[0].protocol.describe()}; {len(reports[0].frames)} held-out views"
    remarks = list(dict.fromkeys(remark for each in reports for remark in each.remarks))
    return typeset.lay_out(("run",), columns, rows, caption, remarks + unbeaten(names, reports))


def key_figures(scored: FieldScores) -> KeyFigures | None:
    """Say what a prior brings: a run by colours alone against the best one of the same views, field and budget."""
    made = list(zip(scored.names, scored.runs, scored.reports, strict=True))
    for name, run, report in made:
        if run.config.prior is not None:
            continue
        guided = [
            (other_name, found.metrics())
            for other_name, other, found in made
            if other.config.prior is not None and _task(other) == _task(run)
        ]
        if guided:
            best, after = max(guided, key=lambda pair: pair[1]["psnr"])
            before = report.metrics()
            shown = [key for key in KEYS if math.isfinite(before[key]) and math.isfinite(after[key])]
            note = f"{name} → {best}"
            return KeyFigures([_key_figure(COLUMNS[key], before[key], after[key], note) for key in shown])
    return None


def _key_figure(column: Column, before: float, after: float, note: str) -> KeyFigure:
    which = "" if column.label == "PSNR" else "depth "
    label = f"{which}{column.label}, {'more' if column.higher else 'less'} is better"
    return KeyFigure(label, column.write(before), column.write(after), column.unit, note)


def _task(run: Run) -> tuple[object, ...]:
    """Return what must be equal for two runs to be compared by their prior alone."""
    fit = run.config.fit
    return run.config.views, run.config.frames, fit.model, fit.steps, fit.seconds, fit.rays, fit.rays_growth


def videos(scored: FieldScores) -> list[Clip | Paragraph]:
    """Embed the runs' videos, or say what makes them and where they are."""
    files = scored.video_files
    if not scored.videos and files:
        where = ", ".join(str(path) for _, path in files)
        return [Paragraph(f"Too large for this page (--megabytes makes room): {where}")]
    return [Clip(f"{name}: colour over depth, along the drive's path", path.read_bytes()) for name, path in files]


def courses(names: Sequence[str], runs: Sequence[Run]) -> list[Plot]:
    """Plot the fits' logs, a line a run: what is drawn of each stands in COURSES."""
    logs = [(name, _log(run.folder)) for name, run in zip(names, runs, strict=True)]
    plots = []
    for y, x, x_label, y_label in COURSES:
        drawn = [Line(name, *_means(log.get(x, NONE), log.get(y, NONE))) for name, log in logs]
        if any(line.y.size for line in drawn):
            plots.append(Plot(drawn, x_label, y_label, from_zero=False, y_scale="linear" if y == "psnr" else "log"))
    return plots


def _means(x: np.ndarray[Any, Any], y: np.ndarray[Any, Any]) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return at most POINTS means of neighbouring points."""
    if not x.size or not y.size:
        return NONE, NONE
    parts = np.array_split(np.arange(len(x)), min(POINTS, len(x)))
    return np.array([x[part].mean() for part in parts]), np.array([y[part].mean() for part in parts])


def _record(name: str, run: Run) -> Record:
    return Record(name, facts(run), [fit_command(run)])


def fit_command(run: Run) -> str:
    """Return the `nerf fit` that makes a run anew."""
    config = run.config
    words = ["nerf", "fit", str(config.drive.get("path", "DATA"))]
    words += ["--camera", str(config.drive["camera"])] if config.drive.get("camera") else []
    words += ["--truth", str(config.drive["truth"])] if config.drive.get("truth") else []
    words += ["--prior", config.prior] if config.prior else []
    words += ["--views", config.views, *(["--frames", config.frames] if config.frames else [])]
    fit = config.fit
    words += ["--steps", str(fit.steps)] if fit.steps is not None else ["--time", f"{fit.seconds:g}s"]
    words += ["--field", fit.model.family]
    words += ["--seed", str(fit.seed)] if fit.seed else []
    settings = _unusual(asdict(config.filters), asdict(Filters())) | _unusual_fit(fit)
    named = {name.rpartition(".")[2]: value for name, value in settings.items() if not name.startswith(NO_FLAG)}
    return shlex.join([*words, *flags(named), "--run", str(run.folder)])


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
    found |= {
        f"filter {name}": str(value) for name, value in _unusual(asdict(config.filters), asdict(Filters())).items()
    }
    return found | {name: str(value) for name, value in _unusual_fit(config.fit).items()}


def _unusual_fit(fit: FitConfig) -> dict[str, Any]:
    """Return a fit's settings that differ from the usual ones, but budget, seed and family."""
    usual = asdict(FitConfig(steps=fit.steps, seconds=fit.seconds, seed=fit.seed))
    usual["model"]["family"] = fit.model.family
    return _unusual(asdict(fit), usual)


def _unusual(values: Mapping[str, Any], usual: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the settings that differ from the usual ones, nested ones as `outer.inner`."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            found |= _unusual(value, usual.get(name) or {}, f"{prefix}{name}.")
        elif value != usual.get(name):
            found[f"{prefix}{name}"] = value
    return found


def _log(run: Path) -> dict[str, np.ndarray[Any, Any]]:
    """Read the columns of a fit's journal."""
    rows = journal.read(run)
    common = set.intersection(*map(set, rows)) if rows else set()
    return {key: np.array([row[key] for row in rows], float) for key in sorted(common)}
