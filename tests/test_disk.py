"""What is going to be written is told before, and refused in a line where the disk is too small for it."""

import shutil
from pathlib import Path
from typing import NamedTuple

import pytest
from factories import write_as_folder
from hypothesis import given
from hypothesis import strategies as st

from cli.priors import PROGRAM
from nerf.prepare import SceneConfig, disk_told, open_scene
from priors import build, drives
from priors.build import room
from priors.errors import DataError
from priors.machine import disk
from priors.methods.completion import Completion
from priors.types import Drive


class Usage(NamedTuple):
    total: int
    used: int
    free: int


@pytest.fixture(scope="module")
def drive(street: Path, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return drives.open_drive(write_as_folder(drives.open_drive(street)[:3], tmp_path_factory.mktemp("disk") / "street"))


def leave(patch: pytest.MonkeyPatch, free: int) -> None:
    patch.setattr(shutil, "disk_usage", lambda path: Usage(10**12, 0, free))


def bytes_in(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*.npy"))


@given(st.integers(0, 10**18))
def test_sizes_are_right_to_two_digits(count: int) -> None:
    number, unit = disk.size(count).split()
    assert float(number) * 1000 ** disk.UNITS.index(unit) == pytest.approx(count, rel=0.06, abs=0.5)


def test_a_build_that_finds_no_room_is_one_line_and_writes_nothing(
    drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    leave(monkeypatch, 1000)
    words = ["build", drive.describe()["path"], "--method", "completion", "--completion.model", "classical"]
    assert PROGRAM.run([*words, "--cache", str(tmp_path / "cache")]) == 1
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert len(told) == 1 and "the maps take about" in told[0] and "1 kB left" in told[0]
    assert not list(tmp_path.rglob("*.png"))


def test_what_maps_take_is_told_by_those_that_are_there(drive: Drive, tmp_path: Path) -> None:
    job = build.prepare(drive, Completion(), folder=tmp_path)
    height, width = drive[0].camera.size
    assert room.needed_bytes(job.prior, 4) == round(4 * room.TYPICAL * height * width), "nothing is there yet"
    prior = job.run().prior
    whole = sum(path.stat().st_size for path in prior.folder.rglob("*.png"))
    assert room.needed_bytes(prior, 300) == pytest.approx(100 * whole, abs=1)
    assert room.told(prior, 3) is None and "disk: the maps take about" in (room.told(prior, 10**9) or "")


def test_a_scene_takes_no_more_than_was_told(drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of images alone just that; of a prior no more; of what is there nothing."""
    prior = build.prepare(drive, Completion(), folder=tmp_path / "cache").run().prior
    monkeypatch.setattr(disk, "WORTH_TELLING", 1)
    pixels = len(drive) * drive[0].camera.size[0] * drive[0].camera.size[1]
    for guide, most in ((None, 3 * pixels), (prior, 8 * pixels)):
        assert f"about {disk.size(most)}" in (disk_told(drive, guide, SceneConfig(), tmp_path / "scene") or "")
        with monkeypatch.context() as full:
            leave(full, most - 1)
            with pytest.raises(DataError, match="the scene's files take about"):
                open_scene(drive, guide, SceneConfig(), tmp_path / "scene")
        before = bytes_in(tmp_path / "scene")
        open_scene(drive, guide, SceneConfig(), tmp_path / "scene")
        assert bytes_in(tmp_path / "scene") - before <= most + 3 * 128, "a header each"
        assert disk_told(drive, guide, SceneConfig(), tmp_path / "scene") is None
