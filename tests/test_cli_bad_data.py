"""The installed `priors build` on data that is damaged or incomplete: one line names it, and other frames are built."""

import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from factories import drive_folder
from installed import fail, priors, stamps

FRAMES = 6


def damage_image(drive: Path) -> Path:
    path = sorted((drive / "image_02" / "data").iterdir())[2]
    path.write_bytes(path.read_bytes()[:500])
    return path


def damage_sweep(drive: Path) -> Path:
    path = sorted((drive / "velodyne_points" / "data").iterdir())[2]
    path.write_bytes(path.read_bytes()[:-7])
    return path


def empty_sweep(drive: Path) -> Path:
    path = sorted((drive / "velodyne_points" / "data").iterdir())[2]
    path.write_bytes(b"")
    return path


def nan_pose(drive: Path) -> Path:
    path = sorted((drive / "oxts" / "data").iterdir())[2]
    path.write_text(path.read_text().replace(path.read_text().split()[0], "nan", 1))
    return path


def resized_image(drive: Path) -> Path:
    path = sorted((drive / "image_02" / "data").iterdir())[2]
    cv2.imwrite(str(path), np.zeros((50, 60, 3), np.uint8))
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("damage", "method"),
    [
        (damage_image, "stereo"),
        (resized_image, "stereo"),
        (damage_sweep, "lidar"),
        (empty_sweep, "lidar"),
        (nan_pose, "lidar"),
    ],
)
def test_a_bad_frame_is_named_and_the_others_are_built(
    own_street: Path, tmp_path: Path, damage: object, method: str
) -> None:
    path = damage(drive_folder(own_street))  # type: ignore[operator]
    done = priors("build", own_street, "--method", method, cwd=tmp_path)
    assert done.returncode == 1
    assert path.name in done.stderr
    assert "Traceback" not in done.stderr
    assert len(stamps(tmp_path)) == FRAMES - 1


def drop_key(drive: Path) -> str:
    path = drive.parent / "calib_cam_to_cam.txt"
    path.write_text(re.sub("P_rect_02:.*\n", "", path.read_text()))
    return "P_rect_02"


def drop_calibration(drive: Path) -> str:
    (drive.parent / "calib_cam_to_cam.txt").unlink()
    return "calib_cam_to_cam.txt"


def swap_baseline(drive: Path) -> str:
    path = drive.parent / "calib_cam_to_cam.txt"
    text = path.read_text()
    path.write_text(
        text.replace("P_rect_02", "P_rect_xx").replace("P_rect_03", "P_rect_02").replace("P_rect_xx", "P_rect_03")
    )
    return "baseline"


def drop_images(drive: Path) -> str:
    shutil.rmtree(drive / "image_02" / "data")
    (drive / "image_02" / "data").mkdir()
    return "image_02"


@pytest.mark.parametrize("damage", [drop_key, drop_calibration, swap_baseline, drop_images])
def test_a_bad_drive_is_one_line(own_street: Path, tmp_path: Path, damage: object) -> None:
    expected = damage(drive_folder(own_street))  # type: ignore[operator]
    assert expected in fail("build", own_street, "--method", "stereo", cwd=tmp_path)


@pytest.mark.parametrize(
    ("folder", "method", "expected"),
    [("image_03", "stereo", "image_03"), ("velodyne_points", "lidar", "velodyne")],
)
def test_an_input_that_no_frame_has_is_an_error(
    own_street: Path, tmp_path: Path, folder: str, method: str, expected: str
) -> None:
    shutil.rmtree(drive_folder(own_street) / folder)
    assert expected in fail("build", own_street, "--method", method, cwd=tmp_path)
