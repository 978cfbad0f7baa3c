"""`priors plan`: what a drive has and needs, what can be left out, and which prior a field of it should have."""

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from factories import write_folder, write_pose_lines, write_raw

from cli.console import guarded
from cli.priors import plan as command
from priors import build
from priors.bench import candidates as expected
from priors.bench.budget import Budget
from priors.bench.candidates import OWN, Candidate
from priors.bench.probe import KINDS
from priors.drives import open_drive
from priors.errors import DataError
from priors.methods.lidar import Lidar
from priors.methods.mono import Mono
from priors.methods.stereo import Stereo
from priors.plan.needs import has, needs
from priors.plan.skips import skips, still
from priors.plan.wish import choose_prior

pytestmark = pytest.mark.stress
Run = Callable[..., tuple[int, str, str]]
SPARSE = Candidate("lidar", Lidar(), 0.01, 0.003, 0.3, OWN)
FAST = Candidate("mono m", Mono(), 0.05, 0.09, 0.9, OWN)
RIGHT = Candidate("stereo", Stereo(), 0.12, 0.02, 1.0, OWN)


@pytest.fixture(autouse=True)
def calibrated(monkeypatch: pytest.MonkeyPatch) -> None:
    """The machine that the shipped table was measured on, or one like it: no two seconds of calibration."""
    monkeypatch.setattr(expected, "calibrate", lambda: dict.fromkeys(KINDS, 15.0))


def test_dense_views_need_no_prior_for_pictures() -> None:
    choice = choose_prior([SPARSE, FAST, RIGHT], dense_views=True, aim="pictures")
    assert choice.candidate is None and choice.name == "none" and "less than 1 dB" in choice.evidence


def test_sparse_views_take_the_cheapest_that_is_dense_or_what_the_budget_allows() -> None:
    every = [SPARSE, FAST, RIGHT]
    assert choose_prior(every, dense_views=False, aim="pictures").candidate is FAST
    assert choose_prior(every, False, "pictures", Budget(seconds=0.2)).candidate is RIGHT
    assert choose_prior(every, False, "pictures", Budget(abs_rel=0.05)).candidate is RIGHT
    with pytest.raises(DataError, match="nothing is as fast"):
        choose_prior(every, False, "pictures", Budget(seconds=0.02))


def test_geometry_takes_the_most_accurate() -> None:
    for dense_views in (False, True):
        assert choose_prior([SPARSE, FAST, RIGHT], dense_views, "geometry").candidate is RIGHT
    unknown = [replace(each, abs_rel=math.nan) for each in (FAST, RIGHT)]
    assert choose_prior(unknown, False, "geometry").candidate is unknown[0]  # nobody scored them: the cheapest
    assert choose_prior([SPARSE], False, "geometry").candidate is None


def test_needs_say_what_is_there_and_why_it_is_not(tmp_path: Path) -> None:
    raw = write_raw(tmp_path)
    shutil.rmtree(raw / "image_03")
    drive = open_drive(raw)
    found = {need.method: need for need in needs(drive, range(6))}
    assert found["lidar"].can and found["mono"].can and not found["stereo"].can
    assert found["stereo"].reads == ("images", "a second camera") and "image_03" in found["stereo"].lacks
    assert found["completion"].reads == ("images", "a LiDAR")  # there are no sparse maps
    shares = has(drive, range(6)).shares
    assert (shares["a LiDAR"], shares["a second camera"], has(drive, range(6)).posed) == (1.0, 0.0, 1.0)


def test_frames_in_which_the_camera_stands_add_nothing(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, [f"{n}" for n in range(6)])
    poses = [np.eye(4) for _ in range(6)]
    for pose, z in zip(poses, (0, 1, 1.02, 1.04, 1.06, 2), strict=True):
        pose[2, 3] = z
    poses[3][:3, :3] = cv2.Rodrigues(np.array([0, 0.05, 0]))[0]  # turns where it stands
    write_pose_lines(folder / "poses.txt", poses)
    drive = open_drive(folder)
    assert still(drive, range(6)) == [2]  # 3 has turned; 4 has turned back; both see something new
    listed = {each.what: each for each in skips(drive, range(6), tmp_path / "cache", ())}
    skip = listed["frames that add nothing"]
    assert skip.share == pytest.approx(1 / 6) and "--min-motion" in skip.why


def test_skips_have_what_is_cached_and_what_a_pair_does_not_need(street: Path, tmp_path: Path) -> None:
    drive = open_drive(street)
    job = build.prepare(drive, Lidar(sweeps=1), folder=tmp_path)
    job.run(replace(job.plan(), todo=[0, 1]))
    found = {skip.what: skip for skip in skips(drive, range(6), tmp_path, {5})}
    assert found["lidar of cached frames"].share == pytest.approx(2 / 6)
    assert found["held-out views"].share == pytest.approx(1 / 6)
    assert all(0 < skip.share <= 1 for skip in found.values())
    other = [skip.what for skip in skips(open_drive(street), range(6), tmp_path / "none", ())]
    assert not any("cached" in what for what in other)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> tuple[int, str, str]:
        code = guarded(lambda: command.run(list(arguments)))
        done = capsys.readouterr()
        return code, done.out, done.err

    return call


def test_the_command_prints_a_plan_and_the_command_that_follows(run: Run, tmp_path: Path) -> None:
    write_folder(tmp_path / "mine", [f"{n}" for n in range(12)])
    code, out, _ = run("mine", "--aim", "pictures")
    assert code == 0 and "12 frames of 240x96" in out and "a second camera" in out
    assert "priors build mine --method" in out and "in sparse views every prior raises PSNR" in out
    assert "left out" in out and "held-out views" in out
    assert not (tmp_path / "cache").exists()
    code, out, _ = run("mine", "--views", "dense", "--aim", "pictures")
    assert code == 0 and "prior: none" in out and "priors build mine" not in out


def test_the_plan_as_json(run: Run, tmp_path: Path) -> None:
    write_folder(tmp_path / "mine", ("a", "b"))
    code, out, _ = run("mine", "--json")
    plan = json.loads(out)
    assert code == 0 and plan["frames"] == 2 and plan["size"] == [96, 240]
    assert {each["name"] for each in plan["candidates"]} >= {"stereo", "mono m"}
    assert plan["prior"]["name"] == "stereo cfnet-s" and plan["prior"]["flags"][0] == "--method stereo"
    lacking = {each["method"]: each["lacks"] for each in plan["methods"] if not each["frames"]}
    assert set(lacking) == {"lidar", "completion"} and all(lacking.values())


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        (("mine", "--budget", "1ms"), 1, "nothing is as fast: the fastest is"),
        (("mine", "--budget", "soon"), 2, "--budget soon: expected the time of a frame"),
        (("mine", "--views", "all"), 2, "--views all"),
        (("mine", "--frames", "7:9"), 2, "no frames there"),
        (("nowhere",), 1, "nowhere"),
    ],
)
def test_what_cannot_be_is_a_line(run: Run, tmp_path: Path, arguments: tuple[str, ...], code: int, told: str) -> None:
    write_folder(tmp_path / "mine", ("0", "1"))
    done = run(*arguments)
    assert done[0] == code and told in done[2] and done[2].count("error:") == 1 and "Traceback" not in done[2]
