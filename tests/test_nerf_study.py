"""The study: which runs it makes, which it skips, and the table it writes, with a runner whose figures are known."""

import csv
import json
import math

import cv2
import numpy as np
import pytest

from eval import typeset
from eval.image import ImageScore
from eval.protocol import ScoreError, preset
from eval.result import Comparison, score_frame
from nerf.report import FrameScore, Report
from nerf.study import NONE, Outcome, RunSpec, Study, run_study
from nerf.study_table import commands, density_curves, lay_out, save
from priors.errors import DataError

SETTINGS = {"drive": "wall", "fit": {"seconds": 60.0}}
LIDAR, STEREO = "cache/wall/lidar-0123456789", "cache/wall/stereo-abcdef0123"


def quality(spec):
    """PSNR and relative depth error by what a run has: known, and all different."""
    psnr = 20 + 2 * (spec.views == "dense") + {NONE: 0, LIDAR: 1, STEREO: 3}[spec.prior]
    psnr += {"kl": -0.5}.get(spec.loss, 0) + (spec.density or 1) + spec.seed + (spec.clip or 0) / 100
    return psnr, 0.5 if spec.prior == NONE else 0.1 / (psnr - 19)


class Runner:
    """Makes a run's report with known figures; counts, and fails or stops where told to."""

    def __init__(self, stop_at=None, fails=()):
        self.made, self.stop_at, self.fails = [], stop_at, fails

    def quality(self, spec):
        return quality(spec)

    def __call__(self, spec, folder, config):
        if len(self.made) == self.stop_at:
            raise KeyboardInterrupt
        if spec.prior in self.fails:
            raise DataError(f"{spec.prior}: no map")
        self.made.append(spec.name)
        psnr, abs_rel = self.quality(spec)
        truth = np.full((3, 4), 10.0)
        rules = preset("paper")
        frames = tuple(
            FrameScore(
                id_,
                ImageScore(10 ** (-psnr / 10), 65025 * 10 ** (-psnr / 10), 0.8, 0.7),
                score_frame(Comparison(id_, truth * (1 + abs_rel), None, truth), rules),
                None,
                0.5,
            )
            for id_ in ("000009", "000019")
        )
        report = Report(rules, frames, {"name": spec.name, "config": config, "command": f"nerf fit {spec.name}"})
        report.save(folder)
        return report


def made(study, tmp_path, runner=None, settings=SETTINGS, **more):
    return run_study(study, tmp_path, runner or Runner(), settings, **more)


def test_the_grid_is_every_combination_with_stable_names():
    study = Study(priors=(NONE, LIDAR), losses=("mse", "l1"), fields=("ngp", "nerfpp"))
    names = [spec.name for spec in study.runs()]
    assert names[:4] == [
        "ngp-dense-none-seed0",
        "ngp-dense-lidar-0123456789-mse-seed0",
        "ngp-dense-lidar-0123456789-l1-seed0",
        "ngp-sparse-none-seed0",
    ]
    assert len(names) == len(set(names)) == 2 * 2 * (1 + 2)
    one = RunSpec("ngp", "9", STEREO, "kl", 40.0, 0.5, 0.9228, True, 0.1, 3)
    assert one.name == "ngp-9-stereo-abcdef0123-kl-clip40-confidence0.5-keep0.9228-density0.1-masked-seed3"


def test_filters_vary_with_a_prior_only():
    study = Study(
        priors=(NONE, STEREO), views=("dense",), clips=(40.0, 80.0), keeps=(None, 0.9), truth_masks=(False, True),
        densities=(None, 0.1), confidences=(None, 0.5), seeds=(0, 1),
    )  # fmt: skip
    runs = study.runs()
    assert len(runs) == len({spec.name for spec in runs}) == 2 + 2**6
    assert {spec.filters() for spec in runs if spec.prior == NONE} == {RunSpec("ngp", "dense", NONE).filters()}
    filters = runs[-1].filters()
    assert (filters.clip, filters.keep, filters.truth_mask) == (80.0, 0.9, True)
    assert (filters.density, filters.confidence) == (0.1, 0.5)


def test_grids_that_cannot_be_made_are_refused():
    with pytest.raises(DataError, match="no views given"):
        Study(views=()).runs()
    with pytest.raises(DataError, match=r"two priors are named lidar-0123456789"):
        Study(priors=(LIDAR, "cache/other/lidar-0123456789")).runs()


def test_done_runs_are_skipped_and_a_killed_study_goes_on(tmp_path):
    study = Study(priors=(NONE, LIDAR, STEREO))
    with pytest.raises(KeyboardInterrupt):
        made(study, tmp_path, Runner(stop_at=2))
    rest, seen = Runner(), []
    outcomes = made(study, tmp_path, rest, on_run=seen.append)
    assert rest.made == [spec.name for spec in study.runs()][2:]
    assert seen == outcomes
    assert [outcome.fresh for outcome in outcomes] == [False] * 2 + [True] * 4
    again = Runner()
    assert [o.report for o in made(study, tmp_path, again)] == [o.report for o in outcomes]
    assert again.made == []
    moved = Study(priors=(NONE, f"elsewhere/{LIDAR}", f"elsewhere/{STEREO}"))
    made(moved, tmp_path, again)
    assert again.made == []
    more = Runner()
    made(Study(priors=(NONE, LIDAR, STEREO), losses=("l1", "kl")), tmp_path, more)
    assert len(more.made) == 4
    assert all("-kl-" in name for name in more.made)


def test_other_settings_or_damaged_metrics_are_run_again(tmp_path):
    study = Study(views=("dense",))
    made(study, tmp_path)
    longer = Runner()
    made(study, tmp_path, longer, {**SETTINGS, "fit": {"seconds": 120.0}})
    assert len(longer.made) == 1
    (tmp_path / "mip360-dense-none-seed0" / "metrics.json").write_text('{"form')
    repaired = Runner()
    made(study, tmp_path, repaired)
    assert len(repaired.made) == 1


def test_a_failed_run_is_told_and_the_others_go_on(tmp_path):
    outcomes = made(Study(priors=(NONE, LIDAR, STEREO), views=("dense",)), tmp_path, Runner(fails=(LIDAR,)))
    assert [outcome.error for outcome in outcomes] == ["", f"{LIDAR}: no map", ""]
    laid = lay_out(outcomes)
    assert len(laid.cells) == 2
    assert laid.notes == [f"mip360-dense-lidar-0123456789-l1-seed0 failed: {LIDAR}: no map"]
    with pytest.raises(ScoreError, match=r"no run has figures; .*no map"):
        lay_out([outcomes[1]])


def test_a_runner_that_forgets_the_config_is_found_out(tmp_path):
    runner = Runner()
    with pytest.raises(ValueError, match="must hold the config"):
        made(Study(), tmp_path, lambda spec, folder, config: runner(spec, folder, {}))


def test_the_table_has_the_paper_s_shape_and_ranks_within_views(tmp_path):
    laid = lay_out(made(Study(priors=(NONE, LIDAR, STEREO)), tmp_path))
    assert laid.heads == ("field", "views", "prior")
    assert [column.title for column in laid.columns] == [
        "PSNR dB ↑", "SSIM-uniform7 ↑", "LPIPS ↓", "RMSE m ↓", "AbsRel ↓", "SSIM-gauss11 ↑"
    ]  # fmt: skip
    assert [name[1:] for name in laid.names] == [
        ("dense", "none"), ("dense", "lidar-0123456789"), ("dense", "stereo-abcdef0123"),
        ("sparse", "none"), ("sparse", "lidar-0123456789"), ("sparse", "stereo-abcdef0123"),
    ]  # fmt: skip
    assert [row[0] for row in laid.cells] == ["23.00", "24.00", "26.00", "21.00", "22.00", "24.00"]
    assert [row[0] for row in laid.marks] == ["", "underline", "bold"] * 2
    assert [row[4] for row in laid.marks] == ["", "underline", "bold"] * 2
    assert laid.starts == (3,)
    assert laid.caption.endswith("mean over images; 2 held-out views; loss l1")


def test_varied_choices_have_a_column_each(tmp_path):
    study = Study(priors=(NONE, STEREO), views=("sparse",), losses=("l1", "kl"), clips=(None, 40.0))
    laid = lay_out(made(study, tmp_path))
    assert laid.heads == ("field", "views", "prior", "loss", "clip")
    assert [name[3:] for name in laid.names] == [
        ("-", "-"),
        ("l1", "all"),
        ("l1", "40 m"),
        ("kl", "all"),
        ("kl", "40 m"),
    ]
    assert [row[0] for row in laid.marks] == ["", "underline", "bold", "", ""]
    masked = Study(priors=(STEREO,), clips=(80.0,), truth_masks=(False, True), views=("dense",))
    laid = lay_out(made(masked, tmp_path))
    assert laid.heads[3:] == ("pixels",)
    assert [name[3:] for name in laid.names] == [("all",), ("with truth",)]
    assert laid.caption.endswith("; loss l1; clip 80 m")


def test_seeds_are_averaged_and_their_spread_is_told(tmp_path):
    laid = lay_out(made(Study(seeds=(0, 1, 2), views=("dense",)), tmp_path))
    assert [row[0] for row in laid.cells] == ["24.00"]
    spread = math.sqrt(2 / 3)
    assert laid.notes[0] == f"means over 3 seeds; the largest standard deviation of a row's PSNR is {spread:.2f} dB"


def test_every_format_is_written_with_its_commands(tmp_path):
    study = Study(priors=(NONE, LIDAR), densities=(0.1, 0.3, None))
    outcomes = made(study, tmp_path)
    typed = "nerf study DATA --priors cache/wall/*"
    paths = save(outcomes, tmp_path, typed)
    tables = ["table.md", "table.tex", "table.txt", "table.csv"]
    assert [path.name for path in paths] == [*tables, "density.png", "density.svg", "density.pdf", "report.html"]
    markdown, latex, plain, table = (path.read_text() for path in paths[:4])
    assert markdown.startswith("| field | views | prior | density | PSNR dB ↑ |")
    assert "| mip360 | dense | lidar-0123456789 | all | **24.00** |" in markdown
    fits = [f"nerf fit {spec.name}" for spec in study.runs()]
    assert markdown.endswith("\n```bash\n" + "\n".join([typed, *fits]) + "\n```\n")
    assert latex.startswith(f"% {typed}\n")
    assert r"\textbf{24.00}" in latex
    assert latex.count(r"\midrule") == 2
    assert f"$ {typed}\n" in plain
    rows = list(csv.DictReader(table.splitlines()))
    assert len(rows) == len(study.runs())
    assert rows[1]["prior"] == LIDAR
    assert float(rows[1]["psnr"]) == pytest.approx(quality(study.runs()[1])[0])
    assert rows[1]["truth"] == "annotated"
    height, width, _ = cv2.imread(str(paths[4])).shape
    assert height > width, "two plots, one above the other: dense and sparse views"
    page = paths[7].read_text()
    assert page.count('class="plot"') == 2
    assert all(line in page for line in [typed, *fits])
    assert commands(outcomes, typed)[0] == typed


def test_the_density_curve_has_a_plot_a_view_setting_and_a_level_without_prior(tmp_path):
    study = Study(priors=(NONE, LIDAR), densities=(0.3, 0.1, None), seeds=(0, 1))
    plots = density_curves(made(study, tmp_path))
    assert list(plots) == ["mip360, dense views", "mip360, sparse views"]
    curve, level = plots["mip360, dense views"]
    assert (curve.label, curve.x.tolist()) == ("lidar-0123456789", [10, 30, 100])
    assert curve.y == pytest.approx([23.6, 23.8, 24.5])  # means over seeds
    assert (level.label, level.dashed, level.x.tolist()) == (NONE, True, [10, 100])
    assert level.y == pytest.approx([23.5, 23.5])
    losses = density_curves(made(Study(priors=(LIDAR,), densities=(0.1, None), losses=("l1", "kl")), tmp_path))
    assert [line.label for line in losses["mip360, sparse views"]] == ["lidar-0123456789, l1", "lidar-0123456789, kl"]
    assert density_curves(made(Study(priors=(NONE, LIDAR)), tmp_path / "other")) == {}


def test_other_truths_and_other_views_are_not_compared_silently(tmp_path):
    outcomes = made(Study(priors=(NONE, LIDAR), views=("dense",)), tmp_path)
    path = tmp_path / outcomes[0].spec.name / "metrics.json"
    content = json.loads(path.read_text())
    content["frames"] = content["frames"][:1]
    path.write_text(json.dumps(content))
    fewer = [Outcome(outcomes[0].spec, Report.load(path)), outcomes[1]]
    assert lay_out(fewer).notes == ["the rows were not scored on the same held-out views"]
    content["protocol"]["truth"] = "lidar"
    path.write_text(json.dumps(content))
    with pytest.raises(ScoreError, match="different protocols"):
        lay_out([Outcome(outcomes[0].spec, Report.load(path)), outcomes[1]])


def test_what_is_absent_is_said_once(tmp_path):
    outcomes = made(Study(), tmp_path)
    lacking = []
    for outcome in outcomes:
        report = outcome.report
        lacking.append(Outcome(outcome.spec, Report(report.protocol, report.frames, report.info, ("LPIPS needs it",))))
    laid = lay_out(lacking)
    assert laid.notes == ["LPIPS needs it"]
    at = [column.label for column in laid.columns].index("LPIPS")
    assert [row[at] for row in laid.cells] == ["-", "-"]


def test_a_sheet_in_a_terminal_has_sections_and_all_heads(tmp_path):
    from rich.console import Console

    console = Console(width=120)
    with console.capture() as capture:
        console.print(typeset.render(lay_out(made(Study(priors=(NONE, LIDAR)), tmp_path)), 120))
    lines = capture.get().splitlines()
    assert [word in lines[1] + lines[2] for word in ("field", "views", "prior", "PSNR", "AbsRel")] == [True] * 5
    assert sum("24.00" in line for line in lines) == 1
    with console.capture() as capture:
        console.print(typeset.render(lay_out(made(Study(priors=(NONE, LIDAR)), tmp_path)), 60))
    assert "no room for" in capture.get()
    assert "AbsRel" in capture.get().split("no room for")[1]


def test_what_keep_goes_by_makes_runs_where_something_is_kept(tmp_path):
    runs = Study(priors=(NONE, STEREO), views=("dense",), keeps=(None, 0.5), keep_bys=(None, "relative")).runs()
    assert sorted((spec.keep or 1, spec.keep_by or "own") for spec in runs if spec.prior == STEREO) == [
        (0.5, "own"),
        (0.5, "relative"),
        (1, "own"),
    ]
    assert len([spec for spec in runs if spec.prior == NONE]) == 1
    by = next(spec for spec in runs if spec.keep_by)
    assert "keep0.5-byrelative-seed0" in by.name and by.filters().keep_by == "relative"
    laid = typeset.plain(
        lay_out([Outcome(spec, Runner()(spec, tmp_path / spec.name, {})) for spec in runs if spec.keep])
    )
    assert "keep by" in laid and "its own" in laid and "relative" in laid
