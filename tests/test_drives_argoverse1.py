"""The Argoverse 1 reader: both releases, joins in time, the pair's rectification, sweeps and their motion."""

import json
from pathlib import Path

import numpy as np
import pytest
from factories import (
    AV_RECT,
    AV_START_NS,
    AV_STEREO,
    write_argoverse_stereo,
    write_argoverse_tracking,
    write_av_pose,
    write_ply,
)
from hypothesis import given
from hypothesis import strategies as st

from priors.drives import DriveOptions, open_drive, reopen
from priors.drives._argoverse1_calibration import LogCalibration
from priors.drives._by_time import nearest
from priors.drives._ply import read_ply
from priors.errors import DataError
from priors.geometry import convert_disparity, invert, transform
from priors.types import Frame

T_CITY_EGO_0 = np.array([[0, -1, 0, 3000], [1, 0, 0, 1600], [0, 0, 1, 12], [0, 0, 0, 1.0]])
T_EGO_FRONT = np.array([[0, 0, 1, 1.6], [-1, 0, 0, 0], [0, -1, 0, 1.4], [0, 0, 0, 1.0]])
RING = DriveOptions(camera="ring_front_center")


def test_ring_camera_pose_and_calibration(tracking_log: Path) -> None:
    frame = open_drive(tracking_log, options=RING)[0]
    assert frame.id == str(AV_START_NS) and frame.camera.size == (1200, 1920)
    assert frame.image().shape == (1200, 1920)  # stored undistorted: read as it is
    np.testing.assert_allclose(frame.camera.K, [[1400, 0, 960], [0, 1400, 600], [0, 0, 1]])
    np.testing.assert_allclose(frame.T_world_cam, T_CITY_EGO_0 @ T_EGO_FRONT, atol=1e-9)
    with pytest.raises(DataError, match="stereo needs --camera stereo_front_left"):
        frame.other()


def test_opens_the_data_sets_root(tracking_log: Path) -> None:
    assert open_drive(tracking_log.parents[1]).name == "log-a-stereo_front_left"
    write_argoverse_tracking(tracking_log.parents[1] / "val" / "log-b", 1)
    with pytest.raises(DataError, match=r"holds 2 drives: choose with --drive log-a"):
        open_drive(tracking_log.parents[1])
    assert open_drive(tracking_log.parents[1], options=DriveOptions(drive="log-b")).name.startswith("log-b")


def test_sweep_is_placed_by_its_own_time(tracking_log: Path) -> None:
    frame = open_drive(tracking_log, options=RING)[1]  # 0.2 s: 2 m on; its sweep is 0.03 s, 0.3 m later
    sweep = frame.sweep()
    assert sweep.time_s is None and sweep.xyz_m[2, 2] == 2  # the third of the log
    assert frame.sweep(-2).xyz_m[2, 2] == 0 and frame.sweep(-3) is None and frame.sweep(2) is None
    np.testing.assert_allclose(sweep.T_world_lidar, _ahead(2.3), atol=1e-9)
    np.testing.assert_allclose(transform(frame.T_cam_lidar, sweep.xyz_m)[:, 2], [18.7, 28.7, 38.7], atol=1e-4)
    np.testing.assert_allclose(frame.T_cam_lidar, invert(frame.T_world_cam) @ sweep.T_world_lidar, atol=1e-9)


def test_pose_between_two_is_interpolated(tracking_log: Path) -> None:
    (tracking_log / "poses" / f"city_SE3_egovehicle_{AV_START_NS + 200_000_000}.json").unlink()
    frame = open_drive(tracking_log, options=RING)[1]  # between 0.13 s and 0.23 s
    np.testing.assert_allclose(frame.T_world_cam, _ahead(2.0) @ T_EGO_FRONT, atol=1e-8)


def test_no_pose_beyond_the_last_or_across_a_gap(tracking_log: Path) -> None:
    for path in (tracking_log / "poses").iterdir():
        path.unlink()
    write_av_pose(tracking_log, AV_START_NS - 300_000_000, 0)
    write_av_pose(tracking_log, AV_START_NS + 1_000_000, 0)
    drive = open_drive(tracking_log, options=RING)
    assert drive[0].T_world_cam is None and drive[1].T_world_cam is None
    np.testing.assert_allclose(drive[0].T_cam_lidar, invert(T_EGO_FRONT), atol=1e-9)


def test_no_sweep_farther_than_half_a_turn(tracking_log: Path) -> None:
    frame = open_drive(tracking_log, options=RING)[0]
    assert frame.sweep() is not None
    (tracking_log / "lidar" / f"PC_{AV_START_NS + 30_000_000}.ply").unlink()
    assert open_drive(tracking_log, options=RING)[0].sweep() is None  # the next one is 130 ms away


def test_rectification_is_the_stereo_releases(tmp_path: Path) -> None:
    write_argoverse_tracking(tmp_path, 0)
    left, right, baseline_m = LogCalibration(tmp_path / "vehicle_calibration_info.json").rectify_pair(*AV_STEREO)
    K = left.camera.K
    # What the release of the same car says, to all its digits.
    assert abs(K[0, 0] - AV_RECT["focal"]) < 1e-5
    assert abs(K[0, 2] - AV_RECT["cx"]) < 1e-5 and abs(K[1, 2] - AV_RECT["cy"]) < 1e-5
    assert baseline_m * K[0, 0] == pytest.approx(-AV_RECT["Txf_"], abs=1e-5)
    T_left_right = invert(left.T_ego_cam) @ right.T_ego_cam
    np.testing.assert_allclose(T_left_right[:3, :3], np.eye(3), atol=1e-9)
    np.testing.assert_allclose(T_left_right[:3, 3], [baseline_m, 0, 0], atol=1e-9)


def test_rectified_images_show_what_the_calibration_says(tmp_path: Path) -> None:
    write_argoverse_tracking(tmp_path, 0)
    calibration = LogCalibration(tmp_path / "vehicle_calibration_info.json")
    left, right, baseline_m = calibration.rectify_pair(*AV_STEREO)
    points_ego = np.array([[15.0, 1.0, 2.0], [25.0, -2.0, 1.0], [40.0, 1.0, 3.0]])
    rows = []
    for name, view in zip(AV_STEREO, (left, right), strict=True):
        raw = transform(invert(calibration._T_ego_cam(name)), points_ego) @ calibration._K(name).T
        stored = np.zeros((2056, 2464), np.uint8)
        for u, v in raw[:, :2] / raw[:, 2:]:
            stored[round(v) - 3 : round(v) + 4, round(u) - 3 : round(u) + 4] = 255
        seen = view.rectify(stored)
        cam = transform(invert(view.T_ego_cam), points_ego)
        expected = cam @ view.camera.K.T
        expected = expected[:, :2] / expected[:, 2:]
        for u, v in expected:
            patch = seen[round(v) - 20 : round(v) + 21, round(u) - 20 : round(u) + 21].astype(float)
            dv, du = (np.average(axis - 20, weights=patch) for axis in np.mgrid[0:41, 0:41])
            assert abs(round(u) + du - u) < 0.8 and abs(round(v) + dv - v) < 0.8
        rows.append(expected)
    np.testing.assert_allclose(rows[0][:, 1], rows[1][:, 1], atol=1e-6)  # one row in both views
    depth_m = transform(invert(left.T_ego_cam), points_ego)[:, 2]
    np.testing.assert_allclose(rows[0][:, 0] - rows[1][:, 0], left.camera.fx * baseline_m / depth_m, atol=1e-6)


def test_tracking_pair_is_joined_within_10_ms(tracking_log: Path) -> None:
    folder = tracking_log / "stereo_front_right"
    for path, late in zip(sorted(folder.iterdir()), (4_000_000, 40_000_000), strict=True):
        path.rename(folder / f"stereo_front_right_{int(path.stem.rpartition('_')[2]) + late}.jpg")
    drive = open_drive(tracking_log)
    assert drive[0].has("other") and drive[0].other().shape == (2056, 2464)
    with pytest.raises(DataError, match=r"stereo_front_right: no image within 10 ms"):
        drive[1].other()


def test_stereo_release_has_disparity_as_truth(stereo_log: Path) -> None:
    drive = open_drive(stereo_log.parents[2])
    frame = drive[0]
    assert drive.name == "log-a-stereo_front_left_rect"
    baseline_m = -AV_RECT["Txf_"] / AV_RECT["focal"]
    assert frame.baseline_m == pytest.approx(baseline_m) == pytest.approx(0.29924, abs=1e-5)
    depth_m = frame.truth().depth_m
    np.testing.assert_allclose(depth_m[::2, ::2], AV_RECT["focal"] * baseline_m / 20, rtol=1e-6)
    assert (depth_m[1::2] == 0).all() and frame.other().shape == (2056, 2464, 3)
    with pytest.raises(DataError, match="argoverse-tracking beside"):
        frame.sweep()
    right = open_drive(stereo_log, options=DriveOptions(camera="stereo_front_right_rect"))[0]
    assert right.side == "right" and not right.has("truth")


def test_truth_option_names_the_disparity_maps(stereo_log: Path, tmp_path: Path) -> None:
    (tmp_path / "disparity_maps_v1.1").rename(tmp_path / "moved")
    assert not open_drive(stereo_log)[0].has("truth")
    given_ = open_drive(stereo_log, options=DriveOptions(truth=tmp_path / "moved"))
    assert reopen(given_.describe())[0].truth().density == pytest.approx(0.25)
    with pytest.raises(DataError, match=r"--truth should hold disparity_maps_v1\.1/train/log-a"):
        open_drive(stereo_log, options=DriveOptions(truth=tmp_path / "nowhere"))


def test_stereo_release_takes_sweeps_and_poses_of_the_tracking_log(tmp_path: Path) -> None:
    folder = write_argoverse_stereo(tmp_path, "train", "log-a")
    write_argoverse_tracking(tmp_path / "argoverse-tracking" / "train1" / "log-a")
    frame = open_drive(folder)[0]
    T_ego_left = T_EGO_FRONT.copy()
    T_ego_left[:3, 3] = [1.7, 0.1, 1.4]  # the refined place
    np.testing.assert_allclose(frame.T_world_cam, T_CITY_EGO_0 @ T_ego_left, atol=1e-9)
    assert frame.sweep() is not None
    right = open_drive(folder, options=DriveOptions(camera="stereo_front_right_rect"))[0]
    np.testing.assert_allclose(
        (invert(frame.T_world_cam) @ right.T_world_cam)[:3, 3], [frame.baseline_m, 0, 0], atol=1e-9
    )


def test_stereo_release_without_the_cameras_place(tmp_path: Path) -> None:
    folder = write_argoverse_stereo(tmp_path, "train", "log-a", refined=False)
    write_argoverse_tracking(tmp_path / "argoverse-tracking" / "train1" / "log-a")
    frame = open_drive(folder)[0]
    assert frame.T_world_cam is None
    with pytest.raises(DataError, match="no stereo_front_left_rect_refined"):
        frame.sweep()


def _edit(path: Path, camera: str, key: str, value: object) -> None:
    data = json.loads(path.read_text())
    for entry in data["camera_data_"]:
        if entry["key"] == f"image_raw_{camera}":
            entry["value"][key] = value
    path.write_text(json.dumps(data))


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        (
            "focal_length_x_px_",
            None,
            r"_info\.json: ring_front_center: focal_length_x_px_ should be",
        ),
        ("focal_length_y_px_", 0, "ring_front_center is no pinhole"),
        ("skew_", 3.0, "ring_front_center is no pinhole"),
        ("vehicle_SE3_camera_", {"translation": [0, 0, 0]}, "vehicle_SE3_camera_: expected a quaternion"),
    ],
)
def test_bad_calibration_is_named(tracking_log: Path, key: str, value: object, message: str) -> None:
    _edit(tracking_log / "vehicle_calibration_info.json", "ring_front_center", key, value)
    with pytest.raises(DataError, match=message):
        open_drive(tracking_log, options=RING)


def test_missing_camera_and_negative_baseline_are_named(tracking_log: Path, stereo_log: Path) -> None:
    with pytest.raises(DataError, match=r"ring_side_left: no images: choose a --camera \(found ring_front_center"):
        open_drive(tracking_log, options=DriveOptions(camera="ring_side_left"))
    calib = stereo_log / "vehicle_calibration_stereo_info.json"
    _edit(calib, "stereo_front_right_rect", "Txf_", 1165.0)
    with pytest.raises(DataError, match=r"stereo_info\.json: the baseline by .* is -0\.299 m, expected > 0"):
        open_drive(stereo_log)
    calib.write_text("{")
    with pytest.raises(DataError, match=r"stereo_info\.json: damaged JSON"):
        open_drive(stereo_log)


def test_damaged_pose_and_sweep_spoil_their_own_frames(tracking_log: Path) -> None:
    pose = tracking_log / "poses" / f"city_SE3_egovehicle_{AV_START_NS}.json"
    pose.write_text(pose.read_text().replace("3000.0", "NaN"))
    sweep = tracking_log / "lidar" / f"PC_{AV_START_NS + 230_000_000}.ply"
    sweep.write_bytes(sweep.read_bytes()[:-4])
    drive = open_drive(tracking_log, options=RING)
    with pytest.raises(DataError, match=rf"{AV_START_NS}\.json: expected a quaternion .* all finite"):
        drive[0].pose()
    with pytest.raises(DataError, match=rf"{AV_START_NS}\.json: expected a quaternion"):
        drive[0].sweep()  # it cannot be placed
    assert drive[0].image().shape == (1200, 1920)
    with pytest.raises(DataError, match=r"\.ply: damaged PLY file \(truncated: 3 vertices announced, 2 found\)"):
        drive[1].sweep()


def _ahead(metres: float) -> np.ndarray:
    T = T_CITY_EGO_0.copy()
    T[1, 3] += metres
    return T


@given(st.lists(st.integers(0, 10**6), unique=True).map(sorted), st.integers(-10, 10**6 + 10), st.integers(0, 10**5))
def test_nearest_is_the_nearest(times: list[int], time: int, within: int) -> None:
    found = nearest(times, time, within)
    close = [t for t in times if abs(t - time) <= within]
    assert (found is None) == (not close)
    if found is not None:
        assert found in close and abs(found - time) == min(abs(t - time) for t in close)


METRES = st.floats(-200, 200, width=32).filter(lambda value: abs(value) > 0.01)
POINTS = st.lists(st.tuples(METRES, METRES, METRES), min_size=1, max_size=20)


@given(POINTS)
def test_ply_round_trip(tmp_path_factory: pytest.TempPathFactory, points: list[tuple[float, float, float]]) -> None:
    path = tmp_path_factory.mktemp("ply") / "PC_1.ply"
    write_ply(path, np.array(points))
    np.testing.assert_array_equal(read_ply(path), np.array(points, np.float32))


@pytest.mark.parametrize("order", ["ascii", "binary_big_endian", "binary_little_endian"])
def test_ply_formats(tmp_path: Path, order: str) -> None:
    xyz = np.array([[1.5, -2, 3], [4, 5, np.nan], [7, 8, 9.25]])
    header = f"ply\nformat {order} 1.0\ncomment made here\nelement vertex 3\nproperty double z\nproperty uchar i\n"
    header += "property float x\nproperty float y\nelement face 0\nproperty list uchar int vertex_index\nend_header\n"
    if order == "ascii":
        body = "".join(f"{z} 7 {x} {y}\n" for x, y, z in xyz).encode()
    else:
        mark = ">" if order == "binary_big_endian" else "<"
        table = np.zeros(3, [("z", mark + "f8"), ("i", "u1"), ("x", mark + "f4"), ("y", mark + "f4")])
        for axis, column in zip("xyz", xyz.T, strict=True):
            table[axis] = column
        body = table.tobytes()
    path = tmp_path / "a.ply"
    path.write_bytes(header.encode() + body)
    np.testing.assert_array_equal(read_ply(path), xyz[[0, 2]].astype(np.float32))


X, Y, Z = (f"property float {axis}\n" for axis in "xyz")
BAD_PLY = [
    ("", "no PLY header"),
    (f"ply\nformat ascii 1.0\nelement vertex 1\n{X}{Y}end_header\n1 2\n", "no property z"),
    (f"ply\nformat zip 1.0\nelement vertex 1\n{X}{Y}{Z}end_header\n", "format 'zip'"),
    ("ply\nformat ascii 1.0\nelement face 1\nend_header\n", "first element is not vertex"),
    (f"ply\nformat ascii 1.0\nelement vertex 2\n{X}{Y}{Z}end_header\n1 2 3\n", "2 vertices announced, 1 rows"),
    (f"ply\nformat ascii 1.0\nelement vertex 0\n{X}{Y}{Z}end_header\n", "empty sweep"),
]


@pytest.mark.parametrize(("text", "message"), BAD_PLY)
def test_bad_ply_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "PC_5.ply"
    path.write_text(text)
    with pytest.raises(DataError, match=rf"PC_5\.ply: .*{message}"):
        read_ply(path)


def test_truth_is_the_disparitys_depth(stereo_log: Path) -> None:
    frame: Frame = open_drive(stereo_log)[0]
    back_px = convert_disparity(frame.truth().depth_m, frame.camera.fx, frame.baseline_m)
    np.testing.assert_allclose(back_px[::2, ::2], 20, rtol=1e-6)
