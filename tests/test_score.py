"""Scores from Python: the figures of slow loops over the same pixels, pairing by id, and what the command prints."""

import json
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from eval.protocol import preset
from eval.result import Result
from priors import build, cache, drives
from priors.cache import Prior
from priors.errors import DataError
from priors.filters import Filters
from priors.machine import threads
from priors.methods.lidar import Lidar
from priors.methods.stereo import Stereo
from priors.score import pair, score, score_pairs
from priors.selection import Selection
from priors.street.write import write_street
from priors.types import Drive

FRAMES = 3
README = Path(__file__).resolve().parents[1] / "README.md"


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """street/, and cache/ with a LiDAR and a stereo prior of it; the LiDAR prior lacks the last frame."""
    folder = tmp_path_factory.mktemp("home")
    drive = drives.open_drive(write_street(folder / "street", FRAMES, 7, (48, 160)))
    for method in (Lidar(sweeps=1), Stereo(offset_px=(0.0,))):
        job = build.prepare(drive, method, Filters(), folder / "cache")
        report = job.run(job.plan(Selection(frames=":2")) if method.name == "lidar" else None)
        assert not report.failed and len(report.built) == (2 if method.name == "lidar" else FRAMES)
    return folder


def prior(home: Path, method: str) -> Prior:
    return cache.only(next((home / "cache").glob(f"*/{method}-*")))


def maps(prior: Prior, drive: Drive, id_: str) -> tuple[np.ndarray, np.ndarray]:
    """A frame's map and truth, decoded by hand."""
    depth = cv2.imread(str(prior.depth_path(id_)), cv2.IMREAD_UNCHANGED) / np.float32(256)
    return depth, drive[drive.ids.index(id_)].truth().depth_m


def test_the_figures_are_those_of_loops(home: Path) -> None:
    stereo = prior(home, "stereo")
    drive = drives.reopen(stereo.drive)
    figures = score(stereo).result.metrics()
    rows = []
    for id_ in drive.ids:
        errors, squares = [], []
        for made, true in zip(*(map_.ravel() for map_ in maps(stereo, drive, id_)), strict=True):
            if 1e-3 < true < 80 and made > 0:
                error = abs(float(np.clip(made, 1e-3, 80)) - float(true))
                errors.append(error / true)
                squares.append(error**2)
        rows.append((np.mean(errors), np.sqrt(np.mean(squares))))
    assert (figures["abs_rel"], figures["rmse"]) == pytest.approx(np.mean(rows, axis=0), rel=1e-5)


def test_the_result_is_kept_and_is_the_command_s(home: Path) -> None:
    stereo = prior(home, "stereo")
    ours = score(stereo, protocol=preset("garg"), frames="1:3").result
    kept = Result.load(stereo.folder / "metrics.json")
    assert kept == ours and [row.frame for row in ours.rows] == ["0000000001", "0000000002"]
    command = [Path(sys.executable).parent / "priors", "eval", stereo.folder, "--protocol", "garg", "--frames", "1:3"]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert Result.load(stereo.folder / "metrics.json") == ours
    assert f"{ours.metrics()['abs_rel']:.4f}" in re.sub(r"\s+", " ", done.stdout)


def test_frames_are_paired_by_id(home: Path) -> None:
    lidar = prior(home, "lidar")
    pairs = pair(lidar, drives.reopen(lidar.drive))
    assert len(pairs) == 2 and pairs.ids == ["0000000000", "0000000001"]
    for comparison in pairs:
        made, true = maps(lidar, pairs.drive, comparison.frame)
        np.testing.assert_array_equal(comparison.prediction_m, made)
        np.testing.assert_array_equal(comparison.truth_m, true)
    seen: list[str] = []
    score_pairs(pairs, name="mine", on_frame=seen.append)
    assert seen == pairs.ids
    assert json.loads((lidar.folder / "metrics.json").read_text())["info"]["prior"] == "mine"


def test_the_readme_s_python_runs(home: Path, tmp_path: Path) -> None:
    """It builds and scores the street, and makes a map of its first frame."""
    (tmp_path / "street").symlink_to(home / "street")
    (code,) = re.findall(r"^```python\n(.*?)^```", README.read_text(), re.MULTILINE | re.DOTALL)
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    built = cache.only(tmp_path / "cache")
    assert len(built.ids()) == FRAMES
    assert float(done.stdout) == pytest.approx(Result.load(built.folder / "metrics.json").metrics()["abs_rel"])


def test_another_prior_can_be_the_truth(home: Path) -> None:
    lidar, stereo = prior(home, "lidar"), prior(home, "stereo")
    itself = score(lidar, against=lidar).result
    assert itself.metrics()["abs_rel"] == 0 and itself.protocol.truth == lidar.name
    other = score(stereo, against=lidar).result
    assert len(other.rows) == 2 and other.metrics()["abs_rel"] > 0, "only the frames that both have"


def test_curves_need_the_pixels_and_a_confidence(home: Path) -> None:
    stereo = prior(home, "stereo")
    without = score(stereo)
    assert without.pixels is None and without.curves() == [] and without.most_confident(0.5) == {}
    scored = score(stereo, keep_pixels=True)
    assert scored.result.rows == without.result.rows
    assert [curve.metric for curve in scored.curves()] == ["abs_rel", "rmse", "d1"]
    assert scored.most_confident(0.5)["abs_rel"] < scored.most_confident(1.0)["abs_rel"]
    assert scored.most_confident(1.0)["abs_rel"] == pytest.approx(scored.nearest(1.0)["abs_rel"])


def test_what_cannot_be_scored_is_one_line(home: Path, tmp_path: Path) -> None:
    lidar, stereo = prior(home, "lidar"), prior(home, "stereo")
    with pytest.raises(DataError, match=r"--frames 7:9: no frames there"):
        score(stereo, frames="7:9")
    with pytest.raises(DataError, match=r"no maps of .* in --frames 2:3"):
        score(lidar, frames="2:3")
    with pytest.raises(DataError, match="has none of the 1 frames"):
        score(stereo, frames="2:3", against=lidar)


def test_a_call_holds_the_threads_as_the_command_does(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Inside a call, OpenCV has as many threads as the command gives it; afterwards it has its own again."""
    used: list[int] = []
    read = Prior.read

    def spy(prior: Prior, frame_id: str) -> object:
        used.append(cv2.getNumThreads())
        return read(prior, frame_id)

    monkeypatch.setattr(Prior, "read", spy)
    before = cv2.getNumThreads()
    with threads.limited(3):
        score(prior(home, "lidar"))
    score(prior(home, "lidar"))
    assert used == [3, 3, *[threads.count()] * 2]
    assert cv2.getNumThreads() == before
