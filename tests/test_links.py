"""Links and relative paths: every data set opens as with its full path."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from factories import write_raw

from priors import codecs
from priors.drives import DriveOptions, open_drive
from priors.drives._links import plain
from priors.errors import DataError
from priors.types import Drive


def same(linked: Drive, drive: Drive) -> bool:
    """Tell whether two drives have the same frames, poses, sweeps, rig and digest."""
    assert linked.fingerprint() == drive.fingerprint() and list(linked.ids) == list(drive.ids)
    for ours, theirs in zip(linked, drive, strict=True):
        assert ours.rig == theirs.rig and set(ours.readers) == set(theirs.readers)
        np.testing.assert_array_equal(ours.pose(), theirs.pose())
    return True


def drive_folder(fixture: str, request: pytest.FixtureRequest) -> Path:
    path: Path = request.getfixturevalue(fixture)
    return path / "sequences" / "06" if fixture == "odometry_root" else path


def chain(folder: Path, at: Path) -> Path:
    """A link to a link."""
    (at / "one").mkdir()
    (at / "one" / "first").symlink_to(folder)
    (at / "second").symlink_to(Path("one") / ".." / "one" / "first")
    return at / "second"


def middle(folder: Path, at: Path) -> Path:
    """The folder above is a link."""
    (at / "up").symlink_to(folder.parent)
    return at / "up" / folder.name


def link(folder: Path, at: Path) -> Path:
    (at / "link").symlink_to(folder)
    return at / "link"


@pytest.mark.parametrize("fixture", ["raw_drive", "odometry_root", "tracking_log", "image_folder"])
@pytest.mark.parametrize("make", [link, chain, middle])
def test_a_linked_drive_is_the_same(
    fixture: str, make: Callable[[Path, Path], Path], request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    folder = drive_folder(fixture, request)
    (tmp_path / "at").mkdir()
    assert same(open_drive(make(folder, tmp_path / "at")), open_drive(folder))


@pytest.mark.parametrize(("fixture", "inside"), [("raw_drive", ""), ("odometry_root", "calib.txt")])
def test_a_folder_of_links_finds_what_lies_above_the_images(
    fixture: str, inside: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    folder = drive_folder(fixture, request)
    mine = tmp_path / "at" / "mine"
    mine.mkdir(parents=True)
    for path in folder.iterdir():
        if path.is_dir() or path.name == inside:
            (mine / path.name).symlink_to(path)
    assert same(open_drive(mine), open_drive(folder))


def test_a_link_to_the_date_and_one_in_it(raw_drive: Path, tmp_path: Path) -> None:
    (tmp_path / "date").symlink_to(raw_drive.parent)
    assert same(open_drive(tmp_path / "date"), open_drive(raw_drive))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / raw_drive.name).symlink_to(raw_drive)
    assert same(open_drive(tmp_path / "other"), open_drive(raw_drive))


def test_a_linked_drive_has_its_truth(raw_drive: Path, tmp_path: Path) -> None:
    inside = f"train/{raw_drive.name}/proj_depth/groundtruth/image_02/0000000002.png"
    codecs.write_depth_png(raw_drive.parents[1] / inside, np.full((96, 240), 7.5, np.float32))
    (tmp_path / "at").mkdir()
    linked = link(raw_drive, tmp_path / "at")
    assert open_drive(linked)[2].has("truth")
    given = open_drive(linked, options=DriveOptions(truth=raw_drive.parents[1]))
    assert given[2].has("truth")


def test_a_calibration_of_two_places_is_found(raw_drive: Path, tmp_path: Path) -> None:
    """One file above the link, the others above what it points to."""
    expected = open_drive(raw_drive)
    digest = expected.fingerprint()
    (tmp_path / "at").mkdir()
    linked = link(raw_drive, tmp_path / "at")
    (raw_drive.parent / "calib_velo_to_cam.txt").rename(tmp_path / "at" / "calib_velo_to_cam.txt")
    drive = open_drive(linked)
    np.testing.assert_array_equal(drive[2].pose(), expected[2].pose())
    assert drive.fingerprint() == digest


@pytest.mark.parametrize("path", [".", "./", "image_02/..", "../{}/", "image_02/data/../..", "~/{}"])
def test_a_drive_has_its_name_however_it_is_called(path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drive = write_raw(tmp_path, ids=(0,))
    monkeypatch.chdir(drive)
    monkeypatch.setenv("HOME", str(drive.parent))
    assert open_drive(Path(path.format(drive.name))).name == drive.name


def test_two_dots_behind_a_link_lead_where_the_system_says(tmp_path: Path) -> None:
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "a" / "b")
    assert plain(tmp_path / "link" / ".." / "c") == tmp_path / "a" / "c"
    assert plain(tmp_path / "link") == tmp_path / "link"
    with pytest.raises(DataError, match="no such folder"):
        open_drive(Path("~nobody-of-this-name/x"))
