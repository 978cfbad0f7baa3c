"""Opening a drive: recognition, its messages, its cost, and opening again from a manifest."""

from pathlib import Path

import pytest
from factories import write_folder

from priors import drives
from priors.drives import DriveOptions, open_drive, reopen
from priors.drives._files import search
from priors.errors import DataError


def test_names_are_the_files() -> None:
    assert drives.names() == [
        "argoverse1", "argoverse2", "colmap", "folder", "images", "kitti_360", "kitti_depth", "kitti_object",
        "kitti_odometry", "kitti_raw", "kitti_stereo", "nerfstudio", "nuscenes",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("fixture", "dataset"),
    [
        ("raw_drive", "kitti_raw"),
        ("odometry_root", "kitti_odometry"),
        ("tracking_log", "argoverse1"),
        ("stereo_log", "argoverse1"),
        ("image_folder", "folder"),
    ],
)
def test_each_layout_is_recognised_and_opens_again(fixture: str, dataset: str, request: pytest.FixtureRequest) -> None:
    path = request.getfixturevalue(fixture)
    drive = open_drive(path)
    described = drive.describe()
    assert described["dataset"] == dataset and Path(described["path"]).is_absolute()
    again = reopen(described)
    assert (again.name, list(again.ids), again.fingerprint()) == (drive.name, list(drive.ids), drive.fingerprint())
    for index in range(len(drive)):
        assert set(drive[index].readers) == set(again[index].readers)


def test_missing_folder_and_file_are_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"nothing: no such folder"):
        open_drive(tmp_path / "nothing")
    (tmp_path / "a.png").touch()
    with pytest.raises(DataError, match=r"a\.png: is a file: name the drive's folder"):
        open_drive(tmp_path / "a.png")


def test_unknown_data_set_lists_the_known(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"unknown data set 'waymo': choose one of auto, argoverse1"):
        open_drive(tmp_path, "waymo")


def test_unrecognised_folder_says_what_it_holds(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no drive recognised .*: found nothing"):
        open_drive(tmp_path)
    (tmp_path / "rgb").mkdir()
    for n in range(3):
        (tmp_path / f"{n}.bag").touch()
    with pytest.raises(DataError, match=r"found folders rgb; 3 \.bag files: see docs/datasets\.md"):
        open_drive(tmp_path)


def test_two_layouts_in_one_folder_need_a_choice(odometry_root: Path) -> None:
    write_folder(odometry_root)
    with pytest.raises(DataError, match="looks like folder and kitti_odometry: choose with --dataset folder"):
        open_drive(odometry_root)
    assert open_drive(odometry_root, "folder").name == odometry_root.name


def test_named_reader_on_another_layout_says_what_it_wants(image_folder: Path) -> None:
    with pytest.raises(DataError, match=r"a drive's folder \(image_02/data, velodyne_points/data\) not found"):
        open_drive(image_folder, "kitti_raw")
    with pytest.raises(DataError, match="truth lies in depth/ here"):
        open_drive(image_folder, options=DriveOptions(truth=image_folder))


def test_a_manifest_without_a_drive_is_named() -> None:
    with pytest.raises(DataError, match=r"does not say where its drive is .*--data"):
        reopen({"dataset": "folder"})


def test_search_stops_at_the_first_level_that_has_it(tmp_path: Path) -> None:
    for place in ("a/log", "b/deep/log", "log"):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "mark").touch()
    looked: list[Path] = []

    def marked(folder: Path) -> bool:
        looked.append(folder)
        return (folder / "mark").exists()

    assert search(tmp_path, marked, 3) == [tmp_path / "log"]
    assert len(looked) == 4  # itself and one level: no deeper
    assert search(tmp_path / "b", marked, 1) == []
    assert search(tmp_path / "b", marked, 2) == [tmp_path / "b/deep/log"]
