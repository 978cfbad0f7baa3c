"""A folder's LiDAR and calibrations of single frames."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from factories import BASELINE_M, FX, SIZE

from priors import codecs
from priors.drives import DriveOptions, is_by_frame, open_drive, reopen
from priors.errors import DataError
from priors.geometry import project, transform
from priors.methods.completion import Completion
from priors.methods.lidar import Lidar

pytestmark = pytest.mark.datasets
T_CAM_LIDAR = [[0.0, -1.0, 0.0, 0.1], [0.0, 0.0, -1.0, -0.2], [1.0, 0.0, 0.0, -0.3]]
"""A LiDAR (x forward, y left, z up) above and behind the camera."""


def points() -> np.ndarray:
    """A wall 12 m in front of the LiDAR."""
    y, z = np.meshgrid(np.linspace(-4, 4, 40), np.linspace(-1, 1.5, 20))
    return np.stack([np.full(y.size, 12.0), y.ravel(), z.ravel(), np.full(y.size, 0.3)], axis=1).astype("<f4")


def calibrate(folder: Path, **values: Any) -> None:
    path = folder / "calib.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


@pytest.fixture
def folder(image_folder: Path) -> Path:
    (image_folder / "lidar").mkdir()
    points().tofile(image_folder / "lidar" / "a.bin")
    np.save(image_folder / "lidar" / "b.npy", points()[:, :3])
    calibrate(image_folder, T_cam_lidar=T_CAM_LIDAR)
    return image_folder


def test_sweeps_are_placed_by_calibration_and_poses(folder: Path) -> None:
    drive = open_drive(folder)
    frame = drive[1]
    sweep = frame.sweep()
    assert sweep is not None and sweep.xyz_m.shape == (800, 3) and sweep.time_s is None
    np.testing.assert_allclose(frame.T_cam_lidar[:3], T_CAM_LIDAR)
    np.testing.assert_allclose(sweep.T_world_lidar, frame.T_world_cam @ frame.T_cam_lidar)
    before = frame.sweep(-1)
    assert before is not None
    np.testing.assert_array_equal(before.xyz_m, points()[:, :3])
    assert frame.sweep(1) is None and frame.sweep(7) is None
    assert reopen(drive.describe()).fingerprint() == drive.fingerprint()


def test_the_lidar_method_makes_the_wall(folder: Path) -> None:
    frame = open_drive(folder)[0]
    depth = Lidar(sweeps=1, occlusion=False).resolve(frame)(frame)
    xyz_cam = transform(frame.T_cam_lidar, points()[:, :3].astype(np.float64))
    uv_px, depth_m = project(frame.camera, xyz_cam)
    hit = {(row, column) for column, row in np.rint(uv_px).astype(int).tolist()}
    drawn = set(zip(*(axis.tolist() for axis in np.nonzero(depth.valid)), strict=True))
    assert drawn <= hit and len(drawn) > len(hit) / 3 > 50
    np.testing.assert_allclose(depth.depth_m[depth.valid], depth_m[0], rtol=1e-5)


def test_the_right_camera_sees_the_lidar_beside_it(folder: Path) -> None:
    frame = open_drive(folder, options=DriveOptions(camera="right"))[0]
    np.testing.assert_allclose(frame.T_cam_lidar[0, 3], T_CAM_LIDAR[0][3] - BASELINE_M)


def test_completion_is_told_where_the_lidar_is(folder: Path) -> None:
    sparse_m = np.zeros(SIZE, np.float32)
    sparse_m[::6, ::6] = 9
    codecs.write_depth_png(folder / "sparse" / "a.png", sparse_m)
    frame = open_drive(folder)[0]
    assert frame.T_cam_lidar is not None
    assert Completion(source="velodyne_raw").resolve(frame)(frame).density > 0.2


def test_a_frame_may_have_a_calibration_of_its_own(folder: Path) -> None:
    one = open_drive(folder).fingerprint()
    (folder / "calib").mkdir()
    turned = [*T_CAM_LIDAR[0][:3], 0.4, *T_CAM_LIDAR[1], *T_CAM_LIDAR[2]]
    (folder / "calib" / "b.json").write_text(json.dumps({"fx": FX + 7, "baseline_m": 0.3, "T_cam_lidar": turned}))
    drive = open_drive(folder)
    assert is_by_frame(drive.describe()) and drive.fingerprint() != one
    assert [drive[n].camera.fx for n in range(3)] == [FX, FX + 7, FX]
    assert [drive[n].baseline_m for n in range(3)] == [BASELINE_M, 0.3, BASELINE_M]
    assert [drive[n].T_cam_lidar[0, 3] for n in range(3)] == [0.1, 0.4, 0.1]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ([1.0] * 11, "12 numbers"),
        ("here", "12 numbers"),
        ([[1, 0, 0, 0], [0, 1, 0, 0]], "12 numbers"),
        ([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, float("nan")], "12 numbers"),
        ([1000, 0, 0, 0, 0, 1000, 0, 0, 0, 0, 1000, 0], "no rotation"),
        ([-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0], "no rotation"),
    ],
)
def test_a_lidar_s_place_that_cannot_be_is_refused_in_a_line(image_folder: Path, given: Any, told: str) -> None:
    calibrate(image_folder, T_cam_lidar=given)
    with pytest.raises(DataError, match=told) as caught:
        open_drive(image_folder)
    assert "\n" not in str(caught.value) and "calib.json" in str(caught.value)


def test_sweeps_without_a_place_say_what_to_add(folder: Path) -> None:
    calibrate(folder, T_cam_lidar=None)
    with pytest.raises(DataError, match="no T_cam_lidar"):
        open_drive(folder)[0].sweep()


def test_a_damaged_sweep_spoils_its_own_frame(folder: Path) -> None:
    (folder / "lidar" / "b.npy").write_bytes(b"nothing")
    frame = open_drive(folder)[1]
    with pytest.raises(DataError, match=r"b\.npy"):
        frame.sweep()
    assert frame.image().shape[:2] == SIZE
    np.save(folder / "lidar" / "b.npy", np.zeros((5, 3), np.int64))
    with pytest.raises(DataError, match="expected floats"):
        frame.sweep()
