"""Table of a study, in the shape of the paper's: one row a choice, one figure a column; and its density curve.

<study>/table.md .tex .csv .txt
       /report.html            the same as a page, with the plots
       /density.png .svg .pdf  PSNR against the share of the prior's values kept, where that varies
"""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np

from eval import typeset
from eval.files import write_bytes
from eval.protocol import ScoreError
from eval.result import refuse_to_mix
from eval.typeset import Column, Table
from nerf.baseline import unbeaten
from nerf.guide import TRUTH
from nerf.report import Report
from nerf.study import NONE, SHARES, Outcome, RunSpec
from priors import cache
from priors.draw import lines
from priors.draw.lines import Line, Plot
from priors.errors import DataError
from priors.naming import labels
from priors.report.blocks import Commands, Figure, Ranking
from priors.report.page import Chapter, Page, Section

COLUMNS = {
    "psnr": Column("PSNR", "dB", higher=True, digits=2),
    "ssim_uniform7": Column("SSIM-uniform7", higher=True),
    "lpips": Column("LPIPS"),
    "lpips_squeeze": Column("LPIPS-squeeze"),
    "lpips_vgg": Column("LPIPS-vgg"),
    "rmse": Column("RMSE", "m"),
    "abs_rel": Column("AbsRel", digits=4),
    "ssim_gauss11": Column("SSIM-gauss11", higher=True),
}
"""In a narrow terminal the last ones are left out first."""
LEAD = ("field", "views", "prior")
"""What every table names first; rows of one field and one choice of views are ranked together."""
_CHOICES = ("loss", *SHARES, "keep_by", "truth_mask", "over_all")
_HEADS = {"keep_by": "keep by", "truth_mask": "pixels", "over_all": "mean over"}


def lay_out(outcomes: Sequence[Outcome]) -> Table:
    """Lay out a study's table: a row a choice, means over seeds, ranked among one field's same views.

    Raises:
        ScoreError: no run has figures, or they were scored by different protocols or truths.
    """
    made = [(outcome.spec, outcome.report) for outcome in outcomes if outcome.report is not None]
    if not made:
        raise ScoreError(f"no run has figures{''.join(f'; {o.spec.name}: {o.error}' for o in outcomes[:1])}")
    refuse_to_mix([report.depth() for _, report in made])
    groups: dict[RunSpec, list[Report]] = {}
    for spec, report in made:
        groups.setdefault(replace(spec, seed=0), []).append(report)
    labels = prior_labels(list(groups))
    guided = [spec for spec in groups if spec.prior != NONE]
    choices = {key: {getattr(spec, key) for spec in guided} for key in _CHOICES}
    varied = [key for key, values in choices.items() if len(values) > 1]
    fixed = [f"{_HEADS.get(key, key)} {_write(guided[0], key)}" for key, values in choices.items()
             if key not in varied and values - {None, False}]  # fmt: skip
    rows = [
        ((spec.field, spec.views, labels[spec.prior], *(_write(spec, key) for key in varied)), _mean(reports))
        for spec, reports in groups.items()
    ]
    have = {key for _, figures in rows for key in figures}
    if not any(key.startswith("lpips_") for key in have):
        have.add("lpips")  # an empty column: a remark says what it needs
    present = {key: column for key, column in COLUMNS.items() if key in have}
    first = made[0][1]
    caption = "; ".join([first.protocol.describe(), f"{len(first.frames)} held-out views", *fixed])
    heads = (*LEAD, *(_HEADS.get(key, key) for key in varied))
    return typeset.lay_out(heads, present, rows, caption, _notes(outcomes, groups), group=2)


def commands(outcomes: Sequence[Outcome], command: str) -> list[str]:
    """List what was typed for a study, and what makes each of its runs alone."""
    reports = [outcome.report for outcome in outcomes if outcome.report is not None]
    return [command, *dict.fromkeys(str(made.info["command"]) for made in reports if "command" in made.info)]


def save(outcomes: Sequence[Outcome], folder: Path, command: str) -> list[Path]:
    """Write the table in four formats and as a page, each with its commands, and the plots; returns the files."""
    laid, typed = lay_out(outcomes), commands(outcomes, command)
    texts = {
        ".md": typeset.markdown(laid) + "\n```bash\n" + "\n".join(typed) + "\n```\n",
        ".tex": "".join(f"% {line}\n" for line in typed) + typeset.latex(laid),
        ".txt": typeset.plain(laid) + "".join(f"$ {line}\n" for line in typed),
        ".csv": as_csv(outcomes),
    }
    paths = [folder / f"table{suffix}" for suffix in texts]
    for path, text in zip(paths, texts.values(), strict=True):
        write_bytes(path, text.encode())
    plots = density_plots(outcomes)
    for path in [folder / f"density{suffix}" for suffix in (".png", ".svg", ".pdf") if plots]:
        lines.write(path, plots)
        paths.append(path)
    title, lead = f"Study {folder.resolve().name}", "Scored on views that no run was trained on."
    sections = [
        Section("Table", [Ranking(laid)]),
        Section("PSNR over the density of the prior", [Figure(plots)] if plots else []),
        Section("How the runs were made", [Commands(typed[1:])] if typed[1:] else []),
    ]
    page = Page(title, f"{len(outcomes)} runs. {lead}", [Chapter(title, "", sections)], command)
    page.write(folder / "report.html")
    return [*paths, folder / "report.html"]


def density_plots(outcomes: Sequence[Outcome]) -> list[Plot]:
    """Make the plots of `density_curves`."""
    x_label, y_label = "share of the prior's values kept, %", "PSNR, dB"
    curves = density_curves(outcomes)
    return [Plot(drawn, x_label, y_label, title, from_zero=False) for title, drawn in curves.items()]


def as_csv(outcomes: Sequence[Outcome]) -> str:
    """Write every figure of every run in full: for spreadsheets and scripts."""
    keys = list(dict.fromkeys(key for o in outcomes if o.report is not None for key in o.report.metrics()))
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*(each.name for each in fields(RunSpec)), "protocol", "truth", "views_scored", *keys])
    for outcome in outcomes:
        if outcome.report is not None:
            report, figures = outcome.report, outcome.report.metrics()
            values = ["" if math.isnan(value := figures.get(key, math.nan)) else repr(value) for key in keys]
            what = ["" if value is None else value for value in asdict(outcome.spec).values()]
            writer.writerow([*what, report.protocol.name, report.protocol.truth, len(report.frames), *values])
    return out.getvalue()


def density_curves(outcomes: Sequence[Outcome]) -> dict[str, list[Line]]:
    """Make the curves of PSNR against density: a plot for one field's same views, in it a line for all else.

    Runs without a prior are a dashed level. Empty where no choice has two densities.
    """
    groups: dict[RunSpec, dict[float, list[float]]] = {}
    for outcome in outcomes:
        if outcome.report is not None:
            spec = replace(outcome.spec, density=None, seed=0)
            share = 100.0 if outcome.spec.density is None else 100 * outcome.spec.density
            groups.setdefault(spec, {}).setdefault(share, []).append(outcome.report.metrics()["psnr"])
    labels = prior_labels(list(groups))
    guided = {spec: points for spec, points in groups.items() if spec.prior != NONE and len(points) > 1}
    varied = [key for key in _CHOICES if len({getattr(spec, key) for spec in guided}) > 1]
    plots: dict[str, list[Line]] = {}
    for spec, points in guided.items():
        shares = sorted(points)
        label = ", ".join([labels[spec.prior], *(_write(spec, key) for key in varied)])
        line = Line(label, np.array(shares), np.array([np.mean(points[share]) for share in shares]))
        plots.setdefault(f"{spec.field}, {spec.views} views", []).append(line)
    for spec, points in groups.items():
        title = f"{spec.field}, {spec.views} views"
        if spec.prior == NONE and title in plots:
            ends = [float(end) for line in plots[title] for end in line.x[[0, -1]]]
            level = np.full(2, np.mean(points[100.0]))
            plots[title].append(Line(NONE, np.array([min(ends), max(ends)]), level, dashed=True))
    return plots


def prior_labels(specs: Sequence[RunSpec]) -> dict[str, str]:
    """Name each prior shortly, each differently; by its folder where that cannot be read any more."""
    own = {NONE: NONE, TRUTH.name: TRUTH.name}
    priors = list(dict.fromkeys(spec.prior for spec in specs if spec.prior not in own))
    try:
        names = labels([cache.load(Path(prior)) for prior in priors])
    except DataError:
        names = [Path(prior).name for prior in priors]
    return {**own, **dict(zip(priors, names, strict=True))}


def _write(spec: RunSpec, key: str) -> str:
    """Write a choice as the table has it."""
    value = getattr(spec, key)
    if spec.prior == NONE:
        return "-"
    if key == "truth_mask":
        return "with truth" if value else "all"
    if key == "over_all":
        return "all rays" if value else "rays with a prior"
    if key == "keep_by":
        return value or "its own"
    if key == "loss":
        return value or "-"
    if value is None:
        return "all"
    return f"{value:g} m" if key == "clip" else f"{value:g}"


def _mean(reports: Sequence[Report]) -> dict[str, float]:
    """Average the figures that all reports of a row have; NaN counts as none."""
    rows = [report.metrics() for report in reports]
    return {key: float(np.mean([row[key] for row in rows])) for key in rows[0] if all(key in row for row in rows)}


def _notes(outcomes: Sequence[Outcome], groups: Mapping[RunSpec, Sequence[Report]]) -> list[str]:
    """Say what a reader must know: seeds and their spread, what is absent, what failed, what does not compare."""
    found = []
    counts = {len(reports) for reports in groups.values()}
    if max(counts) > 1:
        spread = max(float(np.std([made.metrics()["psnr"] for made in reports])) for reports in groups.values())
        several = f"{min(counts)} to {max(counts)}" if len(counts) > 1 else f"{max(counts)}"
        found.append(f"means over {several} seeds; the largest standard deviation of a row's PSNR is {spread:.2f} dB")
    reports = [report for group in groups.values() for report in group]
    found += dict.fromkeys(remark for report in reports for remark in report.remarks)
    if len({tuple(frame.frame for frame in report.frames) for report in reports}) > 1:
        found.append("the rows were not scored on the same held-out views")
    made = [(outcome.spec.name, outcome.report) for outcome in outcomes if outcome.report is not None]
    found += unbeaten([name for name, _ in made], [report for _, report in made])
    return found + [f"{o.spec.name} failed: {o.error}" for o in outcomes if o.report is None]
