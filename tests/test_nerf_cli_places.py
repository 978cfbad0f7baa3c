"""`nerf`'s commands where the drive, the prior or the run has moved, is gone, or is one of several."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from nerf_commands import ALL, HELD_OUT, SIZE, nerf, refused

from nerf.pictures import picture_path
from nerf.run import open_run
from priors import build, codecs
from priors.drives import open_drive
from priors.methods.completion import Completion
from priors.methods.lidar import Lidar
from priors.street.write import write_street


@pytest.fixture
def alone(fitted: Path, tmp_path: Path) -> Path:
    """The run's folder alone, on a machine that has neither its drive nor its prior."""
    shutil.copytree(fitted / "runs" / "prior", tmp_path / "run")
    config = tmp_path / "run" / "config.json"
    config.write_text(config.read_text().replace(str(fitted), "/nowhere"))
    return tmp_path / "run"


def test_a_run_keeps_its_cameras(fitted: Path, alone: Path) -> None:
    there, kept = open_run(fitted / "runs" / "prior").viewpoints("2:5"), open_run(alone).viewpoints("2:5")
    assert kept.ids == there.ids and len(kept.ids) == 3
    np.testing.assert_array_equal(kept.T_world_cam, there.T_world_cam)
    np.testing.assert_array_equal(kept.camera.K, there.camera.K)
    assert kept.camera.size == there.camera.size == SIZE


def test_without_the_drive_a_field_is_shown_all_the_same(fitted: Path, alone: Path) -> None:
    np.savetxt(alone / "p.txt", [open_run(alone).viewpoints().T_world_cam[9][:3].ravel()])
    assert nerf("render", alone, "--poses", alone / "p.txt", "--out", alone / "new") == 0
    assert nerf("export", alone, "--frames", "9", *ALL) == 0 and (alone / "cloud.ply").exists()
    shown = codecs.read_image(alone / "new" / "rgb" / "000000.png").astype(int)
    own = codecs.read_image(picture_path(fitted / "runs" / "prior" / "renders", "rgb", HELD_OUT))
    assert np.abs(shown - own).max() <= 2


def test_without_the_drive_and_its_cameras_what_is_missing_is_told(
    alone: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (alone / "cameras.json").unlink()
    assert "/nowhere" in refused(capsys, "render", alone)
    (alone / "cameras.json").write_text("{")
    assert "/nowhere" in refused(capsys, "export", alone)


def test_what_is_no_run_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("eval", "render", "video", "export"):
        assert "not a run's folder" in refused(capsys, command, tmp_path)


def test_without_a_name_the_only_run_is_taken(
    fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "which run? There is no folder runs/ here" in refused(capsys, "export")
    shutil.copytree(fitted / "runs" / "prior", "runs/a")
    shutil.copytree(fitted / "runs" / ".scenes", "runs/.scenes")
    assert nerf("export", "--frames", "0:1", *ALL) == 0
    assert "run: runs/a" in capsys.readouterr().err and Path("runs/a/cloud.ply").is_file()
    shutil.copytree("runs/a", "runs/b")
    for named in ([], ["runs"]):
        assert nerf("render", *named, "--frames", "0:1") == 2
        assert "2 runs: name one:\n  1. nerf render runs/a --frames 0:1\n" in capsys.readouterr().err


def test_the_drive_and_the_prior_come_from_the_cache(
    fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(fitted / "cache", "cache")
    completion = build.prepare(open_drive(fitted / "street"), Completion(), folder=Path("cache")).run().prior
    assert nerf("fit", "--prior", "auto", "--steps", 1, "--rays", 64, "--run", "runs/a") == 0
    said = capsys.readouterr().err
    assert "prior: completion: no other covers 90%" in said and "another: --prior cache/" in said
    assert open_run(Path("runs/a")).config.prior == str(completion.folder.resolve())
    (tmp_path / "runs" / "odd").mkdir()
    (tmp_path / "runs" / "odd" / "config.json").write_text("{")
    assert nerf("eval") == 1
    told = capsys.readouterr()
    assert "left out: runs/odd" in told.err and re.search(r"^a ", told.out, re.MULTILINE)


def test_priors_of_several_drives_are_listed(
    fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(fitted / "cache", "cache")
    write_street(tmp_path / "second", 2, 3, SIZE)
    second = open_drive(tmp_path / "second")
    build.prepare(second, Lidar(sweeps=1, stereo=False), folder=Path("cache")).run()
    assert nerf("fit", "--prior", "cache", "--steps", 1) == 2
    assert f"nerf fit --prior cache/{second.name} --steps 1" in capsys.readouterr().err


def test_a_run_finds_its_drive_again(
    fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(fitted / "street", "street")
    assert nerf("fit", "street", "--frames", "0:2", "--steps", 1, "--rays", 64, "--run", "runs/a") == 0
    (tmp_path / "street").rename("moved")
    assert "has the drive moved? Name it: --data" in refused(capsys, "eval", "runs/a")
    assert "is not the drive of" in refused(capsys, "export", "runs/a", "--frames", "0:2", "--data", another_street())
    assert nerf("export", "runs/a", "--frames", "0:1", *ALL, "--data", "moved") == 0
    assert len(open_run(Path("runs/a")).drive) == 10, "the run knows the new place"


def another_street() -> Path:
    """Write another street here."""
    write_street(Path("other"), 2, 4, SIZE)
    return Path("other")


def test_views_that_the_drive_does_not_have_leave_no_run(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused(capsys, "fit", fitted / "street", "--views", "50", "--run", tmp_path / "run")
    assert "--views 50: expected dense, sparse or a number from 1 to 9" in said
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("typed", "says"),
    [
        ("study {street} --views 2 50", "--views 50: expected"),
        ("study {street} --frames 90:99", "--frames 90:99: no frames there; the drive has 0:10"),
        ("fit {street} --frames 90:99", "--frames 90:99: no frames there"),
        ("export {run} --frames 90:99", "--frames 90:99: no frames there"),
        ("render {run} --frames 90:99", "--frames 90:99: no frames there"),
        ("fit {street} --camera image_09", "no camera 'image_09'"),
        ("fit {street} --drive other", "no drive 'other'"),
    ],
)
def test_what_the_drive_does_not_have_is_a_wrong_flag(
    fitted: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    typed: str,
    says: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert nerf(*typed.format(street=fitted / "street", run=fitted / "runs" / "prior").split()) == 2
    err = capsys.readouterr().err
    assert says in err and err.count("error:") == 1 and not list(tmp_path.iterdir())
