"""Which drives a command works on: folders, patterns, lists; what is missing or named twice is told."""

from pathlib import Path

import pytest
from factories import write_folder, write_raw

from priors.methods.lidar import Lidar
from priors.scale.drive_list import DriveEntry, find_drives
from priors.scale.fleet import Fleet, gather

pytestmark = pytest.mark.cluster
USUAL = DriveEntry(Path())


def gathered(*entries: DriveEntry) -> Fleet:
    return gather(entries, lambda entry, drive: Lidar())


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """streets/a and streets/b, drives; streets/notes, none."""
    for name in ("a", "b"):
        write_folder(tmp_path / "streets" / name, ("0", "1"))
    (tmp_path / "streets" / "notes").mkdir()
    return tmp_path


def test_a_folder_stands_for_the_drives_below_it(home: Path) -> None:
    found = find_drives([home / "streets"], USUAL)
    assert sorted(entry.path.name for entry in found.entries) == ["a", "b"] and not found.refused
    assert {entry.dataset for entry in found.entries} == {"folder"}


def test_a_pattern_stands_for_the_folders_that_fit(home: Path) -> None:
    found = find_drives([home / "streets" / "[ab]", home / "x*"], USUAL)
    assert [entry.path.name for entry in found.entries] == ["a", "b"]
    assert found.refused == {str(home / "x*"): "no folder fits this pattern"}


def test_a_list_says_what_is_unusual_of_a_drive(home: Path) -> None:
    listed = home / "drives.txt"
    listed.write_text(
        "# the good ones\nstreets/a --frames 0:1   # short\n'streets/b' --camera=right\n\nstreets/a --colour red\n"
        "streets/a --frames\nstreets/a --frames x\n'streets/a\nstreets/none\n"
    )
    found = find_drives([listed], DriveEntry(Path(), frames="0:2"))
    assert [(entry.path.name, entry.frames) for entry in found.entries] == [("a", "0:1"), ("b", "0:2"), ("none", "0:2")]
    assert found.entries[1].part.camera == "right"
    assert sorted(found.refused) == [f"{listed}, line {number}" for number in (5, 6, 7, 8)]
    assert "found colour" in found.refused[f"{listed}, line 5"]


def test_the_same_as_parquet(home: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = {"path": ["streets/a", "streets/b", None], "frames": ["0:1", None, None], "fx": [None, 700.0, None]}
    parquet.write_table(pyarrow.table(rows), home / "drives.parquet")
    (home / "bad.parquet").write_text("no table")
    found = find_drives([home / "drives.parquet", home / "bad.parquet"], USUAL)
    assert [(entry.path.name, entry.frames, entry.part.fx) for entry in found.entries] == [
        ("a", "0:1", None),
        ("b", None, 700.0),
    ]
    assert sorted(found.refused) == [str(home / "bad.parquet"), f"{home / 'drives.parquet'}, row 3"]


def test_what_is_missing_or_shares_a_name_is_told_and_the_rest_goes_on(home: Path) -> None:
    write_folder(home / "other" / "a", ("0",))
    paths = [
        home / "streets" / "a",
        home / "none",
        home / "other" / "a",
        home / "streets" / "b",
        home / "streets" / "a",
    ]
    fleet = gathered(*map(DriveEntry, paths))
    assert [member.name for member in fleet.members] == ["a", "b"]
    assert fleet.refused[str(home / "none")] == "no such folder"
    assert str(home / "streets" / "a") in fleet.refused[str(home / "other" / "a")]


def test_two_cameras_of_a_drive_are_two_priors(tmp_path: Path) -> None:
    drive = write_raw(tmp_path / "raw")
    listed = tmp_path / "drives.txt"
    listed.write_text(f"{drive} --camera image_02\n{drive} --camera image_03\n{drive} --camera image_02\n")
    fleet = gathered(*find_drives([listed], USUAL).entries)
    assert [member.camera for member in fleet.members] == ["image_02", "image_03"] and not fleet.refused
