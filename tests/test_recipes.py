"""The recipes of docs/architecture.md: their code, taken from the page, works through the installed commands."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from priors import cache, codecs, extensions
from priors.errors import DataError

PAGE = Path(__file__).resolve().parents[1] / "docs" / "architecture.md"
K, SIZE, HEIGHT_M = (50.0, 40.0, 31.5, 20.0), (48, 64), 1.5


def recipe(title: str) -> str:
    """Return what stands under a recipe's heading."""
    return PAGE.read_text().split(f"### {title}\n")[1].split("\n### ")[0]


def add(title: str, folder: Path) -> None:
    """Write a recipe's files, each a block that begins with the file's name."""
    blocks = re.findall(r"^```python\n# (\S+)\n(.*?)^```", recipe(title), re.MULTILINE | re.DOTALL)
    assert blocks
    for name, code in blocks:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(code)


def run(line: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run an installed command in a folder."""
    program, *arguments = shlex.split(line)
    parts = [str(Path(sys.executable).parent / program), *arguments]
    return subprocess.run(
        parts, cwd=folder, capture_output=True, text=True, timeout=120, env={**os.environ, **environment}
    )


def run_recipe(title: str, folder: Path) -> list[str]:
    """Run a recipe's commands in order; returns what each printed."""
    lines = re.findall(r"^    ((?:priors|nerf) .*)$", recipe(title), re.MULTILINE)
    assert lines
    printed = []
    for line in lines:
        done = run(line, folder, **{extensions.VARIABLE: "mine"})
        assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
        printed.append(done.stdout)
    return printed


def true_depth_m(row: int) -> float:
    """Return the depth of a flat road HEIGHT_M below the camera in a row of pixels; 0 at and above the horizon."""
    below = (row - K[3]) / K[1]
    return HEIGHT_M / below if below > 0 else 0.0


@pytest.fixture
def flat(tmp_path: Path) -> Path:
    """Three frames of a flat road in the recipe's layout: the folder that holds mine/ and flat/."""
    random = np.random.default_rng(0)
    drive = tmp_path / "flat"
    (drive / "depth").mkdir(parents=True)
    (drive / "camera.txt").write_text(" ".join(map(str, K)))
    truth_m = np.array([[true_depth_m(row)] * SIZE[1] for row in range(SIZE[0])], np.float32)
    for number in range(3):
        codecs.write_image(drive / "frames" / f"{number:06d}.png", random.integers(0, 255, SIZE, np.uint8))
        np.save(drive / "depth" / f"{number:06d}.npy", truth_m)
    add("Add a data set", tmp_path)
    return tmp_path


def test_a_data_set_is_recognised_and_audited(flat: Path) -> None:
    (printed,) = run_recipe("Add a data set", flat)
    assert "3 frames, 000000 to 000002" in printed
    assert "64x48, focal length 50.0 px" in printed
    usage = run("priors check --help", flat, **{extensions.VARIABLE: "mine"}).stdout
    assert "numbered" in usage
    assert "numbered" not in run("priors check --help", flat).stdout


def test_a_method_has_its_flags_and_is_scored(flat: Path) -> None:
    add("Add a method", flat)
    _, table = run_recipe("Add a method", flat)
    assert re.search(r"^road ", table, re.MULTILINE)
    prior = cache.only(flat / "cache")
    assert prior.drive["dataset"] == "numbered"
    rows = prior.read("000001").depth_m[:, 0]
    for row in range(SIZE[0]):  # the page's default: farther than 60 m there is no value
        expected_m = true_depth_m(row) if true_depth_m(row) < 60 else 0.0
        assert rows[row] == pytest.approx(expected_m, abs=1 / 512)
    again = run("priors build flat/ --method road --road.height-m 1.5", flat, **{extensions.VARIABLE: "mine"})
    assert re.search(r"^ +0 +3 ", again.stdout, re.MULTILINE), again.stdout  # built, cached
    wrong = run("priors build flat/ --method road --road.height-m 0", flat, **{extensions.VARIABLE: "mine"})
    assert wrong.returncode == 2
    assert wrong.stderr.strip() == "error: --road.height-m 0.0: expected more than 0 m"


def test_the_method_works_on_the_package_s_data_sets(raw_drive: Path, tmp_path: Path) -> None:
    add("Add a method", tmp_path)
    done = run(f"priors build {raw_drive} --method road --frames 3:5", tmp_path, **{extensions.VARIABLE: "mine"})
    assert done.returncode == 0, done.stderr
    assert len(cache.only(tmp_path / "cache").ids()) == 2


def test_a_result_of_an_extension_that_is_gone_says_what_it_needs(flat: Path) -> None:
    add("Add a method", flat)
    run_recipe("Add a method", flat)
    done = run("priors eval cache/", flat)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert "unknown data set 'numbered': choose one of auto, argoverse1, " in done.stderr
    assert extensions.VARIABLE in done.stderr


@pytest.mark.parametrize(
    ("file", "code", "message"),
    [
        ("drives/odd.py", "x = 1", "a data set's file needs a function recognises"),
        ("methods/odd.py", "class Other: pass", "a method's file needs a class Odd"),
        ("methods/lidar.py", "", "2 files are named lidar.py: rename yours"),
    ],
)
def test_a_file_that_is_no_extension_is_told_in_one_line(tmp_path: Path, file: str, code: str, message: str) -> None:
    path = tmp_path / "mine" / file
    path.parent.mkdir(parents=True)
    path.write_text(code)
    done = run("priors build . --method lidar", tmp_path, **{extensions.VARIABLE: "mine"})
    assert done.returncode == 1
    assert message in done.stderr and len(done.stderr.strip().splitlines()) == 1


def test_a_folder_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(extensions.VARIABLE, str(tmp_path / "gone"))
    with pytest.raises(DataError, match=r"ROADPRIOR_EXTENSIONS: .*gone: no such folder"):
        extensions.folders("drives")
    monkeypatch.setenv(extensions.VARIABLE, os.pathsep.join(map(str, (tmp_path, tmp_path.parent))))
    assert extensions.folders("drives") == [str(tmp_path / "drives"), str(tmp_path.parent / "drives")]
