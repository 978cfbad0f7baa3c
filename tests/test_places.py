"""Where drives are found for a command that was told no DATA."""

from pathlib import Path

import pytest
from factories import write_argoverse_tracking, write_folder, write_odometry, write_raw

from priors import places as module
from priors.errors import UsageError
from priors.places import places, the_place


def write_mine(folder: Path) -> Path:
    return write_folder(folder, ids=("a",))


def found(folder: Path, drive: str | None = None) -> list[str]:
    return [str(place.path.relative_to(folder)) for place in places(folder, drive)]


@pytest.mark.parametrize(("inside", "expected"), [(".", ["."]), ("a", ["a"]), ("a/b/c", ["a/b/c"]), ("a/b/c/d", [])])
def test_a_drive_is_looked_for_three_folders_down(tmp_path: Path, inside: str, expected: list[str]) -> None:
    write_mine(tmp_path / inside)
    assert found(tmp_path) == expected


@pytest.mark.parametrize("hidden", ["cache", "runs", ".trash", "a/cache", "a/b/runs"])
def test_folders_of_results_and_hidden_ones_are_not_looked_into(tmp_path: Path, hidden: str) -> None:
    write_mine(tmp_path / hidden)
    assert found(tmp_path) == []
    assert found(tmp_path / hidden) == ["."], "unless one stands there"


def test_a_drive_s_own_folder_is_named_whatever_its_data_set(tmp_path: Path) -> None:
    raw = write_raw(tmp_path / "kitti", ids=[0])
    odometry = write_odometry(tmp_path / "dataset", count=1)
    log = write_argoverse_tracking(tmp_path / "argoverse-tracking" / "train1" / "log", count=1)
    mine = write_mine(tmp_path / "mine")
    places_ = {(place.path, place.dataset) for place in places(tmp_path)}
    assert places_ == {
        (raw, "kitti_raw"),
        (odometry / "sequences" / "06", "kitti_odometry"),
        (log, "argoverse1"),
        (mine, "folder"),
    }
    assert found(tmp_path, "06") == ["dataset/sequences/06"]


def test_a_data_set_s_own_levels_do_not_count(tmp_path: Path) -> None:
    """DATA would be a/b/kitti, three folders down; the drive lies in its date there."""
    drive = write_raw(tmp_path / "a" / "b" / "kitti", ids=[0])
    assert the_place(tmp_path).path == drive


def test_a_link_and_what_it_points_to_are_one_drive(tmp_path: Path) -> None:
    write_mine(tmp_path / "mine")
    (tmp_path / "link").symlink_to(tmp_path / "mine")
    (tmp_path / "mine" / "loop").symlink_to(tmp_path)
    assert len(found(tmp_path)) == 1


def test_several_are_listed_as_commands_to_copy(tmp_path: Path) -> None:
    for name in ("2011_09_26_drive_0001_sync", "2011_09_26_drive_0002_sync"):
        write_raw(tmp_path / "my data", ids=[0], name=name)
    with pytest.raises(UsageError, match="2 drives") as caught:
        the_place(tmp_path, typed=["priors", "build", "--method", "stereo"])
    drive = tmp_path / "my data" / "2011_09_26" / "2011_09_26_drive_0002_sync"
    assert f"\n  priors build '{drive}' --method stereo" in str(caught.value)
    assert the_place(tmp_path, "2011_09_26_drive_0002_sync").path == drive
    for number in range(module.SHOWN):
        write_mine(tmp_path / f"mine{number}")
    with pytest.raises(UsageError, match=rf"(?s){module.SHOWN + 2} drives.*and 2 more") as caught:
        the_place(tmp_path)


def test_where_there_is_none_the_street_is_offered_in_the_same_line(tmp_path: Path) -> None:
    (tmp_path / "pictures").mkdir()
    with pytest.raises(UsageError, match=r"^no drive in .*priors street street/.*$"):
        the_place(tmp_path)


def test_a_whole_disk_is_not_walked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST", 20)
    for number in range(25):
        (tmp_path / f"{number}").mkdir()
    with pytest.raises(UsageError, match="more than 20 folders"):
        places(tmp_path)
