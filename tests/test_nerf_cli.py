"""`nerf`'s commands from fit to export on a tiny street, and what they say of bad input: one line, nothing lost."""

import io
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
import torch
from conftest import FullDisk
from factories import write_folder
from nerf_commands import ALL, HELD_OUT, SIZE, nerf, prior_of, refused
from rich.console import Console
from safetensors.torch import load_file

from cli.arguments import parse
from cli.nerf.eval import print_tables
from cli.nerf.fit import FitArguments
from cli.nerf.study import StudyArguments, _command
from eval.typeset import render
from nerf.losses import LossConfig
from nerf.page import lay_out
from nerf.pictures import KEPT, picture_path
from nerf.report import Report
from nerf.run import open_run
from nerf.study import NONE, RunSpec
from priors import codecs
from priors.drives import open_drive
from priors.street.write import write_street


def test_a_fit_leaves_a_scored_run(fitted: Path) -> None:
    run = fitted / "runs" / "prior"
    names = {path.name for path in run.iterdir()}
    figures = {"metrics.json", "metrics.jsonl", "depth.json", "renders"}
    assert names == {"config.json", "cameras.json", "checkpoint.safetensors", *figures}
    assert all(picture_path(run / "renders", kind, HELD_OUT).exists() for kind in KEPT)


def test_eval_sets_runs_side_by_side(fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, other = fitted / "runs" / "prior", fitted / "others" / "prior"
    shutil.copytree(run, other)
    assert nerf("eval", run, other, run, "--save", tmp_path / "t.md", "--pictures", tmp_path / "pictures") == 0
    heads = [line.split("|")[1].strip() for line in (tmp_path / "t.md").read_text().splitlines() if "prior" in line]
    assert heads == ["runs/prior", "others/prior"], "each once, each by a name of its own"
    assert "wrote 1 pictures" in capsys.readouterr().out
    picture = codecs.read_image(tmp_path / "pictures" / f"{HELD_OUT}.jpg")
    assert picture.shape[1] > 3 * 450


def test_eval_writes_a_report_page(fitted: Path, tmp_path: Path) -> None:
    run = fitted / "runs" / "prior"
    assert nerf("eval", run, "--save", tmp_path / "new" / "page.html", tmp_path / "t.txt") == 0
    page = (tmp_path / "new" / "page.html").read_text()
    figures = re.findall(r"\d+\.\d{2,}", (tmp_path / "t.txt").read_text().split("paper:")[0])
    assert len(figures) >= 4 and all(f">{figure}</td>" in page for figure in figures)
    assert page.count("data:image/jpeg;base64,") == 2, "one view is held out: its image, and what was rendered"
    assert "nerf eval" in page and str(prior_of(fitted).resolve()) in page
    assert "<dt>budget</dt>\n<dd>3 steps</dd>" in page


def test_a_report_tells_the_whole_story(fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["report", fitted / "runs", "--cache", fitted / "cache", "--most", 2, "--out", tmp_path / "new" / "a.html"]
    assert nerf(*asked) == 0
    first = (tmp_path / "new" / "a.html").read_bytes()
    assert f"wrote {tmp_path / 'new' / 'a.html'}, {len(first) / 1e6:.1f} MB" in capsys.readouterr().out
    page = first.decode()
    titles = re.findall("<h[23]>(.*?)</h[23]>", page)
    assert [title.split(" of ")[0] for title in titles if " of street" in title] == ["Depth priors", "Radiance fields"]
    assert {"Frames", "Held-out views", "What made this page"} <= set(titles)
    assert page.count("data:image/jpeg;base64,") == 2 + 2, "two frames; the view that is held out, and its rendering"
    metres = next(row for row in Report.load(fitted / "runs" / "prior" / "metrics.json").frames).figures()["rmse"]
    assert f"RMSE {metres:.2f} m" in page


def test_a_report_that_cannot_be_written_is_told_before_any_work(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for flag, value in (("--out", "page.pdf"), ("--most", 0), ("--megabytes", "nan"), ("--picture-width", 1)):
        assert refused(capsys, "report", fitted / "runs", flag, value).startswith(f"error: {flag} {value}: expected ")
    assert "no runs in it" in refused(capsys, "report", tmp_path)
    shutil.copytree(fitted / "cache", tmp_path / "cache", ignore=shutil.ignore_patterns("*.png"))
    assert "no maps yet" in refused(capsys, "report", fitted / "runs", "--cache", tmp_path / "cache")
    assert (
        nerf("report", fitted / "runs", "--cache", fitted / "cache", "--megabytes", 0.01, "--out", tmp_path / "a.html")
        == 0
    )
    assert "pictured frames are left out: they do not fit into --megabytes 0.01" in capsys.readouterr().out


def test_runs_of_several_drives_have_a_table_each(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = open_run(fitted / "runs" / "prior")
    other = replace(run, source=open_drive(write_folder(tmp_path / "mine")))
    report = Report.load(run.folder / "metrics.json")
    tables = print_tables([run, other, run], [report] * 3)
    assert [len(table.names) for table in tables] == [2, 1]
    assert [table.caption.split(":")[0] for table in tables] == [run.drive.name, other.drive.name]
    assert len(re.findall(r"^run +PSNR", capsys.readouterr().out, re.MULTILINE)) == 2


def test_in_80_columns_a_table_has_what_people_came_for(fitted: Path) -> None:
    run = open_run(fitted / "runs" / "prior")
    laid = lay_out(["ngp-sparse-l1-stereo"], [Report.load(run.folder / "metrics.json")])
    screen = Console(width=80, file=io.StringIO())
    screen.print(render(laid, 80))
    shown = screen.file.getvalue()  # type: ignore[attr-defined]
    assert all(label in shown for label in ("PSNR", "SSIM-uniform7", "RMSE", "AbsRel"))
    assert max(map(len, shown.splitlines())) <= 80


def test_new_poses_are_rendered(fitted: Path, tmp_path: Path) -> None:
    pose = open_drive(fitted / "street")[9].T_world_cam
    assert pose is not None
    np.savetxt(tmp_path / "p.txt", [pose[:3].ravel(), pose[:3].ravel()])
    assert nerf("render", fitted / "runs" / "prior", "--poses", tmp_path / "p.txt", "--out", tmp_path / "new") == 0
    files = sorted(str(path.relative_to(tmp_path / "new")) for path in (tmp_path / "new").rglob("*.png"))
    assert files == [f"{kind}/00000{i}.png" for kind in ("depth", "depth_colour", "rgb") for i in (0, 1)]
    own = codecs.read_image(picture_path(fitted / "runs" / "prior" / "renders", "rgb", HELD_OUT))
    difference = codecs.read_image(tmp_path / "new" / "rgb" / "000000.png").astype(int) - own
    assert np.abs(difference).max() <= 2, "the same pose, written as text"


def test_a_video_and_a_cloud_are_written(fitted: Path, tmp_path: Path) -> None:
    run = fitted / "runs" / "prior"
    assert nerf("video", run, "--frames", "2:4", "--steps", 2, "--out", tmp_path / "v.mp4") == 0
    with av.open(str(tmp_path / "v.mp4")) as film:
        assert (film.streams.video[0].codec_context.name, film.streams.video[0].frames) == ("h264", 3)
    assert nerf("export", run, "--frames", "2:3", *ALL, "--out", tmp_path / "c.ply") == 0
    assert (tmp_path / "c.ply").read_bytes().startswith(b"ply\n")


def test_a_run_goes_on_and_says_where_nothing_is_left(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(fitted / "runs" / "prior", tmp_path / "runs" / "prior")
    fit = ["fit", fitted / "street", "--prior", prior_of(fitted), "--run", tmp_path / "runs" / "prior", "--steps"]
    assert nerf(*fit, 3) == 0
    told = capsys.readouterr().err
    assert "trained before, 3 steps" in told and "goes on from" not in told
    assert nerf(*fit, 4) == 0
    told = capsys.readouterr().err
    assert "trained before" not in told
    assert re.findall(r"^(\w+)[: ]", told, re.MULTILINE)[:4] == ["run", "views", "field", "training"]
    assert "96x32: 9 of 10 frames train, 1 are held out" in told
    assert f"field: mip360, guided by {prior_of(fitted).name}, loss l1; 4 steps, goes on from step 3, " in told
    assert "other settings" in refused(capsys, *fit, 4, "--views", "sparse")


def test_a_study_is_found_done_after_eval_and_begins_anew_with_another_budget(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = ["study", fitted / "street", "--priors", "none", "--views", 2, "--out", tmp_path / "study", "--steps"]
    run = tmp_path / "study" / "mip360-2-none-seed0"
    assert nerf(*study, 3) == 0
    first = load_file(run / "checkpoint.safetensors")
    assert nerf("eval", run) == 0
    capsys.readouterr()
    assert nerf(*study, 3) == 0
    assert "done before" in capsys.readouterr().err
    assert nerf(*study, 2) == 0
    assert "done before" not in capsys.readouterr().err
    assert nerf(*study, 3) == 0
    again = load_file(run / "checkpoint.safetensors")
    assert all(torch.equal(first[name], again[name]) for name in first)


def test_priors_that_cannot_be_used_are_refused_in_a_line(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other"
    write_street(other, 10, 8, SIZE)
    prior, run = prior_of(fitted), tmp_path / "runs" / "a"
    assert f"made for {fitted}" in refused(capsys, "fit", other, "--prior", prior, "--steps", 2, "--run", run)
    street = ["fit", fitted / "street", "--steps", 2, "--run", tmp_path / "runs" / "b"]
    few = tmp_path / "few" / prior.name
    shutil.copytree(prior, few)
    for path in [*(few / "depth").glob("000000000[1-9].png")]:
        path.unlink()
    assert "none of the 5 frames has a map" in refused(capsys, *street, "--prior", few, "--frames", "5:10")
    (few / "frames.jsonl").unlink()  # the checksums: from here on another tool's maps
    for path in (few / "depth").glob("*.png"):
        codecs.write_depth_png(path, np.zeros(SIZE, np.float32))
    assert "no value in any" in refused(capsys, *street, "--prior", few)
    (few / "depth" / "0000000000.png").write_bytes(b"cut")
    assert "0000000000.png" in refused(capsys, *street, "--prior", few)


def test_poses_that_jump_are_refused(fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(fitted / "street", tmp_path / "street")
    for path in sorted(tmp_path.glob("street/**/oxts/data/*.txt"))[6:]:
        latitude, rest = path.read_text().split(" ", 1)
        path.write_text(f"{float(latitude) + 0.01} {rest}")
    told = refused(capsys, "fit", tmp_path / "street", "--steps", 2, "--run", tmp_path / "runs" / "a")
    assert "jumps" in told and "0000000006" in told and "--frames 0:6" in told
    assert not list(tmp_path.rglob("images.npy"))


def test_one_training_view_trains_and_few_frames_are_not_scored(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert nerf("fit", fitted / "street", "--frames", "3:4", "--steps", 2, "--run", tmp_path / "runs" / "one") == 0
    told = capsys.readouterr()
    assert "one training view" in told.err
    assert "nothing to score" in told.out
    assert "is held out" in refused(capsys, "eval", tmp_path / "runs" / "one")


def test_a_full_disk_is_one_line_and_what_was_there_stays(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], full_disk: FullDisk
) -> None:
    shutil.copytree(fitted / "runs" / "prior", tmp_path / "runs" / "prior")
    fit = ["fit", fitted / "street", "--prior", prior_of(fitted), "--run", tmp_path / "runs" / "prior", "--steps", 5]
    with full_disk(20_000):
        assert "images.npy: " in refused(capsys, *fit)
    with full_disk(1_000_000):
        assert "checkpoint.safetensors: " in refused(capsys, *fit)
    before = (fitted / "runs" / "prior" / "checkpoint.safetensors").read_bytes()
    assert (tmp_path / "runs" / "prior" / "checkpoint.safetensors").read_bytes() == before
    assert not [path for path in tmp_path.rglob(".*") if path.is_file()]
    assert nerf(*fit) == 0


def test_a_field_that_has_learned_nothing_gives_no_cloud(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused(
        capsys,
        "export",
        fitted / "runs" / "prior",
        "--frames",
        "2:3",
        "--farthest-m",
        1e-3,
        "--out",
        tmp_path / "c.ply",
    )
    assert "c.ply: not written: the view holds no point of opacity 0.5 within 0.001 m" in said and not list(
        tmp_path.iterdir()
    )


def test_the_study_s_preset_is_one_command_with_a_page(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grid = [
        "study",
        fitted / "street",
        "--priors",
        "none",
        prior_of(fitted),
        "--preset",
        "paper",
        "--out",
        tmp_path / "s",
    ]
    small = ["--field", "warp", "--seed", 5]  # it is not trained, so it is soon made
    assert nerf(*grid, *small) == 0
    written = (tmp_path / "s" / "study.md").read_text()
    assert "| warp | GT Depth |" in written and "2 of 2 runs have figures" in written
    assert "seeds 5 in table 3" in written and "- Depth Completion: no such prior was named." in written
    capsys.readouterr()
    assert nerf(*grid, *small) == 0
    assert capsys.readouterr().err.count("done before") == 2
    assert (tmp_path / "s" / "study.md").read_text() == written
    for flag, value in (("--views", "dense"), ("--loss", "kl"), ("--clip", 40)):
        assert f"{flag}: --preset paper says it" in refused(capsys, *grid, flag, value)
    assert "compares priors with colours alone" in refused(capsys, *grid[:2], "--preset", "paper", "--priors", "none")


@pytest.mark.parametrize("field", ["mip360", "splat"])
def test_the_preset_s_fields_learn_no_exposure_and_each_run_s_own_command_says_so(field: str) -> None:
    args = StudyArguments(preset="paper", steps=7)
    words = shlex.split(_command(args, RunSpec(field, "sparse", NONE, loss=None), Path("run")))
    alone = parse(FitArguments, "nerf fit", "", words[2:]).config()
    fitted = args.fit()
    assert not fitted.model.gaussians.appearance and not alone.model.gaussians.appearance
    assert (fitted.losses.opacity_power, fitted.align, fitted.losses.trim) == (1.0, alone.align, alone.losses.trim)
    assert alone.losses.opacity_power == (1.0 if field == "mip360" else LossConfig().opacity_power)
    assert fitted.losses.weigh == "confidence"
    assert alone.losses.weigh == ("confidence" if field == "mip360" else "auto")
    assert fitted.rays_growth == 1 and alone.rays_growth == (1 if field == "mip360" else None)
    assert StudyArguments(steps=7).fit().model.gaussians.appearance
