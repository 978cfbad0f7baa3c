"""The installed commands, run as a user runs them, on a small street."""

import json
import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from factories import drive_folder
from installed import PRIORS, fail, priors, stamps, succeed

from priors import codecs

FRAMES = 6


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("street")
    succeed("street", folder / "street", "--frames", FRAMES, "--seed", 7, "--size", "320x96", cwd=folder)
    return folder / "street"


@pytest.fixture(scope="module")
def built(street: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder whose cache/ holds all three priors."""
    folder = tmp_path_factory.mktemp("built")
    for method in ("lidar", "completion", "stereo"):
        succeed("build", street, "--method", method, cwd=folder)
    return folder


def test_all_methods_are_built_and_scored_in_one_table(built: Path) -> None:
    text = succeed("eval", "cache", "--save", "table.md", "table.csv", "--ranges", cwd=built)
    for method in ("lidar", "completion", "stereo"):
        assert re.search(rf"^{method}\b", text, re.MULTILINE)
    assert (built / "table.md").read_text().count("**") > 4, "the best is bold"
    assert len((built / "table.csv").read_text().splitlines()) == 1 + 2 * 3
    for path in (built / "cache").glob("*/*/metrics.json"):
        result = json.loads(path.read_text())
        assert len(result["frames"]) == FRAMES
        assert 0 < result["metrics"]["image"]["abs_rel"] < 0.3


def test_a_second_build_computes_nothing(built: Path, street: Path) -> None:
    before = stamps(built / "cache")
    assert len(before) == 3 * FRAMES
    plan = succeed("build", street, "--method", "stereo", "--dry-run", cwd=built)
    assert f"0 to compute, {FRAMES} skipped" in plan
    succeed("build", street, "--method", "stereo", cwd=built)
    assert stamps(built / "cache") == before


def test_a_changed_flag_makes_another_folder(built: Path, street: Path) -> None:
    before = stamps(built / "cache")
    plan = succeed("build", street, "--method", "stereo", "--clip", 40, "--dry-run", cwd=built)
    assert f"{FRAMES} to compute" in plan
    succeed("build", street, "--method", "stereo", "--clip", 40, "--cache", "clipped", cwd=built)
    assert stamps(built / "cache") == before
    depth = next((built / "clipped").rglob("depth/*.png"))
    assert cv2.imread(str(depth), cv2.IMREAD_UNCHANGED).max() <= 40 * 256


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["show", "--every", 0], "--every 0: expected a whole number from 1"),
        (["show", "--width", -5], "--width -5: expected a whole number from 16"),
        (["show", "--frames", "a:b"], "--frames a:b: expected a:b, for example 5:17"),
        (["eval", "--metrics", "abs_rel", "magic"], "--metrics magic: expected some of density, "),
        (["build", ".", "--method", "stereo", "--workers", 0], "--workers 0: expected a whole number from 1"),
        (["build", ".", "--method", "mono", "--mono.hold-out", "x"], "--mono.hold-out x: expected start:stop:step"),
        (["street", "other", "--seed", -1], "--seed -1: expected a whole number from 0"),
    ],
    ids=lambda value: " ".join(map(str, value)) if isinstance(value, list) else "",
)
def test_what_cannot_be_is_one_line(built: Path, arguments: list[object], says: str) -> None:
    wrong_flag = says.startswith("--")
    assert fail(*arguments, cwd=built, code=2 if wrong_flag else 1).startswith(f"error: {says}")


def test_results_of_two_protocols_do_not_mix(built: Path) -> None:
    first, second = sorted((built / "cache").glob("*/*"))[:2]
    succeed("eval", first, "--protocol", "paper", cwd=built)
    succeed("eval", second, "--protocol", "garg", cwd=built)
    error = fail("eval", first / "metrics.json", second / "metrics.json", cwd=built)
    assert "different protocols" in error


def test_a_prior_is_scored_against_another(built: Path) -> None:
    lidar, stereo = (next((built / "cache").glob(f"*/{method}-*")) for method in ("lidar", "stereo"))
    assert "stereo" in succeed("eval", stereo, "--against", lidar, cwd=built)
    itself = succeed("eval", lidar, "--against", lidar, "--metrics", "abs_rel", cwd=built)
    assert "0.0000" in itself


def test_pictures_are_written(built: Path) -> None:
    succeed("show", "cache", "--frames", "1:3", cwd=built)
    pictures = sorted((built / "pictures").rglob("*.jpg"))
    assert len(pictures) == 2
    assert cv2.imread(str(pictures[0])).shape[1] > 600
    succeed("eval", "cache", "--curves", "curves.png", cwd=built)
    assert cv2.imread(str(built / "curves.png")).std() > 5


def test_a_report_page_holds_table_curves_pictures_and_the_command(built: Path) -> None:
    said = succeed("eval", "cache", "--save", "report.html", "table.md", "--curves", "curves.svg", cwd=built)
    page = (built / "report.html").read_text()
    figures = re.findall(r"\d+\.\d{4}", (built / "table.md").read_text().split("paper:")[0])
    assert len(figures) >= 15 and all(f">{figure}</td>" in page for figure in figures)
    confident = len(re.findall(r": AUSE ", said))
    plots = 2 + 3 * confident + 2
    assert confident and page.count('class="plot"') == plots, (
        "errors by distance, sparsification, both of stereo's odds"
    )
    assert page.count("data:image/jpeg;base64,") == min(FRAMES, 8)
    assert "priors eval cache --save report.html table.md --curves curves.svg" in page
    assert ">oracle</text>" in (built / "curves.svg").read_text()
    succeed("eval", next((built / "cache").glob("*/lidar-*")) / "metrics.json", "--save", "one.html", cwd=built)
    assert "data:image" not in (built / "one.html").read_text(), "figures alone: the maps are not looked for"


def test_a_report_has_a_drive_that_cannot_be_scored_and_names_one_that_cannot_be_opened(
    built: Path, tmp_path: Path
) -> None:
    shutil.copytree(built / "cache", tmp_path / "cache")
    (lidar,) = (tmp_path / "cache").glob("*/lidar-*")
    (tmp_path / "cache" / "gone").mkdir()
    shutil.move(next((tmp_path / "cache").glob("*/completion-*")), tmp_path / "cache" / "gone" / "completion")
    manifest = tmp_path / "cache" / "gone" / "completion" / "manifest.json"
    text = manifest.read_text().replace("street_0007_sync", "street_gone")
    manifest.write_text(re.sub(r'"fingerprint": "\w', '"fingerprint": "x', text))
    for path in sorted(lidar.glob("depth/*.png"))[:2]:
        path.write_bytes(b"no picture")
    done = priors("report", "cache", "--frames", "0:4", "--out", "a.html", cwd=tmp_path)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    for what in ("cache/gone", "lidar, frame 0000000000", "lidar, frame 0000000001"):
        assert f"left out: {what}" in done.stderr
    page = (tmp_path / "a.html").read_text()
    assert page.count("data:image/jpeg;base64,") == 4
    assert "stereo" in page and "Left out: lidar, frame 0000000000" in page


@pytest.mark.parametrize("flags", [("--save", "table.xls"), ("--curves", "curves.jpg")])
def test_files_that_cannot_be_written_are_refused_before_anything_is_scored(
    built: Path, tmp_path: Path, flags: tuple[str, str]
) -> None:
    done = priors("eval", built / "cache", *flags, cwd=tmp_path)
    assert done.returncode in (1, 2)
    assert len(done.stderr.strip().splitlines()) == 1
    assert flags[1] in done.stderr and "ends in" in done.stderr and not done.stdout


def test_list_names_every_prior_and_what_is_half_written(built: Path, tmp_path: Path) -> None:
    assert succeed("list", cwd=built).count(f" {FRAMES} ") >= 3
    shutil.copytree(built / "cache", tmp_path / "cache")
    next((tmp_path / "cache").glob("*/stereo-*/confidence/*.png")).write_bytes(b"")
    done = priors("list", cwd=tmp_path)
    assert done.returncode == 1
    assert "half written" in done.stderr


def test_check_finds_the_street_sound(street: Path, tmp_path: Path) -> None:
    text = succeed("check", street, cwd=tmp_path)
    assert "fatal" not in text
    assert len(text.splitlines()) >= 5


@pytest.mark.slow
@pytest.mark.parametrize("kill", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_build_resumes(street: Path, built: Path, tmp_path: Path, kill: signal.Signals) -> None:
    command = [str(PRIORS), "build", str(street), "--method", "stereo", "--workers", "1"]
    running = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while len(stamps(tmp_path)) < 2 and time.monotonic() < deadline and running.poll() is None:
        time.sleep(0.002)
    running.send_signal(kill)
    running.communicate(timeout=60)
    finished = stamps(tmp_path)
    assert finished
    if kill == signal.SIGINT and len(finished) < FRAMES:
        assert running.returncode == 130
    succeed("build", street, "--method", "stereo", cwd=tmp_path)
    after = stamps(tmp_path)
    assert len(after) == FRAMES
    assert {path: after[path] for path in finished} == finished, "what was done is not done again"
    for path in after:
        whole = built / Path(path).relative_to(tmp_path)
        np.testing.assert_array_equal(cv2.imread(path, -1), cv2.imread(str(whole), -1))


@pytest.mark.slow
def test_shards_make_what_one_build_makes(street: Path, built: Path, tmp_path: Path) -> None:
    for part in (1, 2):
        succeed("build", street, "--method", "lidar", "--shard", f"{part}/2", "--workers", 3, cwd=tmp_path)
    for path in stamps(tmp_path):
        whole = built / Path(path).relative_to(tmp_path)
        np.testing.assert_array_equal(cv2.imread(path, -1), cv2.imread(str(whole), -1))


def test_a_missing_folder_is_one_line(tmp_path: Path) -> None:
    assert "no such folder" in fail("build", "nowhere", "--method", "stereo", cwd=tmp_path)
    assert "priors build" in fail("eval", "nowhere", cwd=tmp_path)


def test_a_cache_of_another_version_is_refused_and_kept(built: Path, street: Path, tmp_path: Path) -> None:
    shutil.copytree(built / "cache", tmp_path / "cache")
    manifest = next((tmp_path / "cache").glob("*/stereo-*/manifest.json"))
    manifest.write_text(manifest.read_text().replace('"format": 2', '"format": 99'))
    maps = stamps(manifest.parent)
    assert "format 99" in fail("eval", "cache", cwd=tmp_path)
    next(manifest.parent.glob("depth/*.png")).unlink()
    assert "format 99" in fail("build", street, "--method", "stereo", cwd=tmp_path)
    assert len(stamps(manifest.parent)) == len(maps) - 1


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes anywhere")
def test_a_folder_that_cannot_be_written_is_one_line(street: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    assert "cache" in fail("build", street, "--method", "stereo", cwd=tmp_path)


@pytest.mark.parametrize(
    "arguments",
    [
        ["nonsense"],
        ["build"],
        ["build", ".", "--method", "magic"],
        ["build", ".", "--method", "stereo", "--no-such-flag"],
        ["eval", "--protocol", "magic"],
    ],
)
def test_usage_errors_exit_2(tmp_path: Path, arguments: list[str]) -> None:
    assert priors(*arguments, cwd=tmp_path).returncode == 2


@pytest.mark.parametrize("command", ["build", "eval", "show", "list", "check", "street"])
def test_every_command_has_help_made_of_examples(tmp_path: Path, command: str) -> None:
    assert f"priors {command} " in succeed(command, "--help", cwd=tmp_path)
    assert command in succeed("--help", cwd=tmp_path)


def test_the_drive_and_the_method_may_be_left_out(street: Path, tmp_path: Path) -> None:
    assert "`priors street street/` makes the embedded one" in fail("build", cwd=tmp_path, code=2)
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "here").symlink_to(drive_folder(street))
    assert "priors build --frames 0:1 --method stereo" in fail("build", "--frames", "0:1", cwd=tmp_path, code=2)
    words = ["build", "--frames", "0:1", "--lidar.sweeps", "3", "--method"]
    assert "--lidar.sweeps: a flag of --method lidar, not of stereo" in fail(*words, "stereo", cwd=tmp_path, code=2)
    done = priors(*words, "auto", cwd=tmp_path)
    assert done.returncode == 0
    assert "method: stereo: it has a stereo pair" in done.stderr and "--lidar.sweeps: not used" in done.stderr
    shutil.copytree(drive_folder(street), tmp_path / "second")
    done = priors("build", "--method", "stereo", cwd=tmp_path)
    assert done.returncode == 2 and "priors build second --method stereo" in done.stderr


def test_a_bad_truth_and_a_moved_drive_cost_no_table(own_street: Path, tmp_path: Path) -> None:
    for method in ("stereo", "lidar"):
        succeed("build", own_street, "--method", method, "--frames", "0:2", "--cache", "c", cwd=tmp_path)
    moved = own_street.rename(tmp_path / "moved")
    assert "has the drive moved? Name it: --data FOLDER" in fail("eval", "c", cwd=tmp_path)
    succeed("eval", "c", "--data", moved, cwd=tmp_path)
    paths = {json.loads(path.read_text())["drive"]["path"] for path in (tmp_path / "c").rglob("manifest.json")}
    assert paths == {str(drive_folder(moved))}
    truth = next(moved.rglob("groundtruth/image_02/0000000000.png"))
    codecs.write_depth_png(truth, codecs.read_depth_png(truth)[::2, ::2])
    done = priors("eval", "c", cwd=tmp_path)
    assert done.returncode == 1
    assert "AbsRel" in done.stdout and "left out: stereo" in done.stderr and truth.name in done.stderr
