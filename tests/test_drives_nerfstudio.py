"""nerfstudio's transforms.json: axes, pixel centres, lenses, units of depth, masks."""

import json
from pathlib import Path

import numpy as np
import pytest
from layouts.nerfstudio import edit, write_nerfstudio
from layouts.posed import CX, CY, FX, FY, SIZE, seen_by

from cli.priors import PROGRAM
from priors import codecs
from priors.check import check
from priors.drives import DriveOptions, open_drive, reopen
from priors.errors import DataError, UsageError

pytestmark = pytest.mark.datasets


def test_a_straight_camera_is_taken_as_it_is(tmp_path: Path) -> None:
    views = write_nerfstudio(tmp_path / "scene", bent=False)
    drive = open_drive(tmp_path / "scene")
    assert drive.name == "scene" and drive.describe()["dataset"] == "nerfstudio"
    assert drive.ids == [view.name for view in views]
    for frame, view in zip(drive, views, strict=True):
        np.testing.assert_allclose(frame.camera.K, [[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
        np.testing.assert_allclose(frame.pose(), view.T_world_cam, atol=1e-12)
        np.testing.assert_array_equal(frame.image(), view.image)
        depth_m = frame.truth().depth_m
        assert not depth_m[:20, :30].any()
        np.testing.assert_allclose(depth_m[20:], view.depth_m[20:], atol=0.51e-3)
    again = reopen(drive.describe())
    assert again.fingerprint() == drive.fingerprint()


def test_a_lens_is_straightened_once_with_its_new_camera(tmp_path: Path) -> None:
    views = write_nerfstudio(tmp_path)
    drive = open_drive(tmp_path)
    for frame, view in zip(drive, views, strict=True):
        shown, true_m = seen_by(view.T_world_cam, frame.camera.K, frame.camera.size)
        assert frame.camera.size == SIZE and frame.camera.fx != FX
        error = np.abs(frame.image().astype(int) - shown)
        assert error.max() <= 4  # blended colours, rounded twice
        depth_m = frame.truth().depth_m
        there = depth_m > 0
        assert there.mean() > 0.9 and np.abs(depth_m / true_m - 1)[there].max() < 0.01  # moved by half a pixel at most
    notes = [finding.message for finding in check(drive) if finding.subject == "calibration"]
    assert any("images are straightened" in note and f"fx {FX:.1f}" in note for note in notes)
    assert any("PNG in millimetres" in note for note in notes)


def test_each_frame_may_have_its_own_camera(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path, bent=False)
    data = json.loads((tmp_path / "transforms.json").read_text())
    data["frames"][0] |= {"fl_x": 200.0, "cx": 70.5}
    (tmp_path / "transforms.json").write_text(json.dumps(data))
    drive = open_drive(tmp_path)
    assert [frame.camera.fx for frame in drive] == [FX, FX, 200.0]
    assert drive[2].camera.K[0, 2] == 70.0 and drive.describe()["cameras"] == "by frame"


def test_the_field_of_view_stands_for_the_focal_length(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path, bent=False)
    edit(tmp_path, fl_x=None, fl_y=None, cx=None, cy=None, w=None, h=None, camera_angle_x=2 * np.arctan(0.5))
    camera = open_drive(tmp_path)[0].camera
    assert camera.fx == pytest.approx(SIZE[1]) and camera.size == SIZE
    np.testing.assert_allclose(camera.K[:2, 2], [(SIZE[1] - 1) / 2, (SIZE[0] - 1) / 2])


def test_the_unit_of_depth(tmp_path: Path) -> None:
    views = write_nerfstudio(tmp_path, bent=False)
    edit(tmp_path, depth_unit_scale_factor=0.002)
    np.testing.assert_allclose(open_drive(tmp_path)[0].truth().depth_m[30:], 2 * views[0].depth_m[30:], atol=1.1e-3)
    data = json.loads((tmp_path / "transforms.json").read_text())
    for entry, view in zip(data["frames"], reversed(views), strict=True):
        np.save(tmp_path / "depth" / f"{view.name}.npy", view.depth_m)
        entry["depth_file_path"] = f"depth/{view.name}.npy"
    del data["depth_unit_scale_factor"]
    (tmp_path / "transforms.json").write_text(json.dumps(data))
    np.testing.assert_array_equal(open_drive(tmp_path)[0].truth().depth_m[30:], views[0].depth_m[30:])


@pytest.mark.parametrize("spelling", ["no suffix", "backslashes", "one name in two folders", "one is missing"])
def test_names_as_people_have_them(tmp_path: Path, spelling: str) -> None:
    views = write_nerfstudio(tmp_path, bent=False)
    data = json.loads((tmp_path / "transforms.json").read_text())
    for number, entry in enumerate(data["frames"]):
        path = Path(entry["file_path"])
        if spelling == "no suffix":
            entry["file_path"] = f"./{path.with_suffix('')}"
        elif spelling == "backslashes":
            entry["file_path"] = str(path).replace("/", "\\")
        elif spelling == "one name in two folders":
            entry["file_path"] = f"cam{number}/0001.png"
            (tmp_path / f"cam{number}").mkdir()
            (tmp_path / path).rename(tmp_path / entry["file_path"])
        elif number == 0:
            (tmp_path / path).unlink()
    (tmp_path / "transforms.json").write_text(json.dumps(data))
    drive = open_drive(tmp_path)
    named = [view.name for view in views]
    if spelling == "one name in two folders":
        assert drive.ids == ["cam0_0001", "cam1_0001", "cam2_0001"]
    elif spelling == "one is missing":
        assert drive.ids == named[:2] and "1 images that are listed are not there" in drive.notes()
    else:
        assert drive.ids == named
    assert drive[0].image().shape == (*SIZE, 3) and drive[0].has("truth")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fl_x": None}, "fl_x should be a number: it is missing"),
        ({"fl_x": -3}, r"fl_x should be > 0 pixels, found -3"),
        ({"cx": "80"}, "cx should be a number: found '80'"),
        ({"frames": []}, "no list of frames: write transforms.json again"),
        ({"frames": [{"path": "a.png"}]}, "frame 0 has no file_path"),
        ({"frames": [{"file_path": "images/gone.png"}]}, r"gone\.png: no such file: none of its 1 images is there"),
        (
            {"camera_model": "OPENCV_FISHEYE"},
            "camera_model OPENCV_FISHEYE is not read: undistort the images to PINHOLE",
        ),
        ({"k4": 0.1}, r"k4 0.1 is no term of OpenCV's: undistort the images first"),
        ({"depth_unit_scale_factor": 0}, "depth_unit_scale_factor should be more than 0 metres"),
    ],
)
def test_bad_files_are_one_line(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    write_nerfstudio(tmp_path, bent=False)
    edit(tmp_path, **changes)
    with pytest.raises(DataError, match=message):
        open_drive(tmp_path)


def test_bad_frames_spoil_themselves_only(tmp_path: Path) -> None:
    views = write_nerfstudio(tmp_path, bent=False)
    data = json.loads((tmp_path / "transforms.json").read_text())
    del data["frames"][0]["depth_file_path"]
    codecs.write_image(tmp_path / "depth" / f"{views[0].name}.png", np.zeros(SIZE, np.uint8))
    codecs.write_image(tmp_path / "images" / f"{views[1].name}.png", views[1].image[:50])
    (tmp_path / "transforms.json").write_text(json.dumps(data))
    drive = open_drive(tmp_path)
    with pytest.raises(DataError, match=r"00001\.png: expected a 16-bit one-channel PNG, found 8 bits"):
        drive[0].truth()
    with pytest.raises(DataError, match=r"00002\.png: is 160x50, the calibration is for 160x96"):
        drive[1].image()
    with pytest.raises(DataError, match=r"frame_00003 names no depth_file_path: add it"):
        drive[2].truth()
    for options in (DriveOptions(camera="left"), DriveOptions(drive="x"), DriveOptions(truth=tmp_path)):
        with pytest.raises(UsageError, match="leave --"):
            open_drive(tmp_path, options=options)
    data["frames"][1]["transform_matrix"] = [[1, 0], [0, 1]]
    (tmp_path / "transforms.json").write_text(json.dumps(data))
    with pytest.raises(DataError, match=r"transform_matrix of images/frame_00002\.png: expected a pose of 4x4"):
        open_drive(tmp_path)


def test_the_audit_and_mono(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_nerfstudio(tmp_path / "scene")
    assert PROGRAM.run(["check", str(tmp_path / "scene")]) == 0
    folder = str(tmp_path / "cache")
    assert PROGRAM.run(["build", str(tmp_path / "scene"), "--method", "auto", "--cache", folder]) == 0
    assert PROGRAM.run(["eval", folder]) == 0
    assert "mono" in capsys.readouterr().out
