"""The KITTI raw reader: joins by id, poses, the rig's geometry, damaged files; and the real drive's facts."""

from pathlib import Path

import numpy as np
import pytest
from conftest import RealData
from factories import BASELINE_M, SIZE, STEP_M, depth_m, scene, write_oxts, write_raw
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from priors import codecs
from priors.drives import DriveOptions, kitti_raw, open_drive, reopen
from priors.drives._rigs import KITTI
from priors.errors import DataError
from priors.geometry import invert, project, scatter_nearest, transform, untwist
from priors.methods.lidar import Lidar

EARTH_RADIUS_M = 6378137.0


@pytest.mark.parametrize("levels", [0, 1, 2])
def test_opens_drive_date_and_root(raw_drive: Path, levels: int) -> None:
    path = [raw_drive, *raw_drive.parents][levels]
    assert open_drive(path).name == "2011_09_26_drive_0009_sync"


def test_another_rig_in_kittis_layout_is_not_kittis(raw_drive: Path) -> None:
    """What KITTI's own pairs are off by says nothing of other cars' pairs."""
    assert open_drive(raw_drive)[0].rig == KITTI
    own = raw_drive.rename(raw_drive.parent / "mine_0001_sync")
    assert open_drive(own)[0].rig is None


def test_several_drives_need_a_name(raw_drive: Path) -> None:
    write_raw(raw_drive.parents[1], name="2011_09_26_drive_0011_sync")
    with pytest.raises(DataError, match=r"holds 2 drives: choose with --drive 2011_09_26_drive_0009_sync"):
        open_drive(raw_drive.parent)
    chosen = open_drive(raw_drive.parent, options=DriveOptions(drive="2011_09_26_drive_0011_sync"))
    assert chosen.name == "2011_09_26_drive_0011_sync"


def test_sweep_lands_on_the_scene(raw_drive: Path) -> None:
    frame = open_drive(raw_drive)[0]
    uv_px, found_m = project(frame.camera, transform(frame.T_cam_lidar, frame.sweep().xyz_m))
    cell = np.rint(uv_px).astype(int)
    np.testing.assert_allclose(found_m, depth_m(scene()[2])[cell[:, 1], cell[:, 0]], rtol=1e-4)


def test_poses_move_east_in_metres(raw_drive: Path) -> None:
    drive = open_drive(raw_drive)
    place = np.stack([drive[n].T_world_cam[:3, 3] for n in range(6)])
    np.testing.assert_allclose(np.diff(place, axis=0), np.tile([STEP_M, 0, 0], (5, 1)), atol=1e-6)


def test_velocity_is_the_poses_motion(raw_drive: Path) -> None:
    drive = open_drive(raw_drive)
    for index in (0, 3, 5):  # one-sided at the ends
        np.testing.assert_allclose(drive[index].sweep().velocity, [STEP_M / 0.1, 0, 0, 0, 0, 0], atol=1e-5)


def test_points_to_the_left_were_measured_first(raw_drive: Path) -> None:
    sweep = open_drive(raw_drive)[2].sweep()
    left = sweep.xyz_m[:, 1] > 0.1
    assert (sweep.time_s[left] < 0).all() and (sweep.time_s[~left & (sweep.xyz_m[:, 1] < -0.1)] > 0).all()
    assert np.abs(sweep.time_s).max() <= 0.05 + 1e-6


def test_right_eye_is_the_same_pair_seen_from_the_other_side(raw_drive: Path) -> None:
    left, right = open_drive(raw_drive)[1], open_drive(raw_drive, options=DriveOptions(camera="image_03"))[1]
    assert (left.side, right.side) == ("left", "right")
    assert left.baseline_m == pytest.approx(BASELINE_M) == right.baseline_m
    np.testing.assert_array_equal(left.other(), right.image())
    np.testing.assert_array_equal(left.image(), right.other())
    T_left_right = invert(left.T_world_cam) @ right.T_world_cam
    np.testing.assert_allclose(T_left_right[:3, 3], [BASELINE_M, 0, 0], atol=1e-9)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_everything_is_joined_by_id(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    ids = list(range(3, 9))
    drive_folder = write_raw(tmp_path_factory.mktemp("joins"), ids)
    kept = {}
    folders = {"image_02": "png", "image_03": "png", "velodyne_points": "bin", "oxts": "txt"}
    for folder, suffix in folders.items():
        kept[folder] = data.draw(st.sets(st.sampled_from(ids), min_size=1), label=folder)
        for number in set(ids) - kept[folder]:
            (drive_folder / folder / "data" / f"{number:010d}.{suffix}").unlink()
    drive = kitti_raw.KittiRaw(drive_folder)
    origin = min(kept["oxts"])
    assert [int(id_) for id_ in drive.ids] == sorted(kept["image_02"])
    for index, id_ in enumerate(drive.ids):
        frame, number = drive[index], int(id_)
        assert frame.has("other") == (number in kept["image_03"])
        assert (frame.sweep() is not None) == (number in kept["velodyne_points"])
        assert (frame.sweep(1) is not None) == (number + 1 in kept["velodyne_points"])
        assert frame.time_s == pytest.approx(0.1 * number, abs=1e-6)
        assert (frame.T_world_cam is not None) == (number in kept["oxts"])
        if frame.T_world_cam is not None:
            T_cam_imu = frame.T_cam_lidar @ drive.calibration.T_velo_imu
            T_world_imu = frame.T_world_cam @ T_cam_imu
            np.testing.assert_allclose(T_world_imu[:3, 3], [(number - origin) * STEP_M, 0, 0], atol=1e-5)


def test_a_drive_without_velodyne_and_oxts_still_opens(raw_drive: Path) -> None:
    for folder in ("velodyne_points", "oxts"):
        (raw_drive / folder).rename(raw_drive / f"no_{folder}")
    for file in ("calib_velo_to_cam.txt", "calib_imu_to_velo.txt"):
        (raw_drive.parent / file).unlink()
    frame = open_drive(raw_drive)[0]
    assert frame.T_world_cam is None and frame.T_cam_lidar is None and frame.image().shape == (*SIZE, 3)
    with pytest.raises(DataError, match=r"frame 0000000000: .*velodyne_points"):
        frame.sweep()


def test_links_that_became_text_are_followed(raw_drive: Path) -> None:
    (raw_drive / "oxts").rename(raw_drive.parent / "real_oxts")
    (raw_drive / "oxts").write_text("../real_oxts")
    assert open_drive(raw_drive)[3].T_world_cam is not None


def test_truth_is_found_beside_and_given(raw_drive: Path, tmp_path: Path) -> None:
    inside = f"train/{raw_drive.name}/proj_depth/groundtruth/image_02/0000000002.png"
    assert not open_drive(raw_drive)[2].has("truth")
    codecs.write_depth_png(tmp_path / "elsewhere" / inside, np.full(SIZE, 9.5, np.float32))
    given_ = open_drive(raw_drive, options=DriveOptions(truth=tmp_path / "elsewhere"))
    np.testing.assert_allclose(given_[2].truth().depth_m, 9.5)
    assert reopen(given_.describe())[2].has("truth")
    codecs.write_depth_png(raw_drive.parents[1] / inside, np.full(SIZE, 7.5, np.float32))
    drive = open_drive(raw_drive)
    np.testing.assert_allclose(drive[2].truth().depth_m, 7.5)
    with pytest.raises(DataError, match=r"frame 0000000001: .*groundtruth/image_02: no map of this frame"):
        drive[1].truth()
    with pytest.raises(DataError, match=r"--truth should hold \[train/\]2011_09_26_drive_0009_sync"):
        open_drive(raw_drive, options=DriveOptions(truth=tmp_path / "nothing"))


def test_maps_of_another_size_beside_are_not_this_drives(raw_drive: Path) -> None:
    inside = f"kitti_depth/train/{raw_drive.name}/proj_depth/groundtruth/image_02/0000000002.png"
    codecs.write_depth_png(raw_drive.parents[1] / inside, np.full((375, 1242), 9.5, np.float32))
    frame = open_drive(raw_drive)[2]
    with pytest.raises(DataError, match="these maps are for another image size"):
        frame.truth()


def test_a_bad_oxts_spoils_its_own_frame_only(raw_drive: Path) -> None:
    path = raw_drive / "oxts" / "data" / "0000000003.txt"
    path.write_text(path.read_text().replace("49.", "nan 49.", 1))
    drive = open_drive(raw_drive)
    with pytest.raises(DataError, match=r"0000000003\.txt: expected 6 finite oxts fields"):
        drive[3].pose()
    assert drive[2].T_world_cam is not None
    assert drive[2].sweep().velocity is not None  # from the pose before


def test_a_bad_first_oxts_leaves_no_pose_and_says_so(raw_drive: Path) -> None:
    (raw_drive / "oxts" / "data" / "0000000000.txt").write_text("")
    drive = open_drive(raw_drive)
    for index in (0, 4):
        with pytest.raises(DataError, match=r"0000000000\.txt: .*sets the drive's world"):
            drive[index].pose()


def test_a_linked_drive_has_its_calibration(raw_drive: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(raw_drive)
    linked, drive = open_drive(tmp_path / "link"), open_drive(raw_drive)
    assert np.array_equal(linked[2].pose(), drive[2].pose())
    assert linked[2].sweep().xyz_m.shape == drive[2].sweep().xyz_m.shape


@pytest.mark.parametrize("name", ["calib_velo_to_cam.txt", "calib_imu_to_velo.txt"])
def test_a_missing_calibration_file_is_named(raw_drive: Path, name: str) -> None:
    (raw_drive.parent / name).unlink()
    frame = open_drive(raw_drive)[2]
    lidar = Lidar().resolve(frame)
    with pytest.raises(DataError, match=name.replace(".", r"\.") + ": no such file"):
        lidar(frame)


def test_numbers_without_leading_zeros_keep_their_neighbours(raw_drive: Path) -> None:
    shift = 8  # 8, 9, 10, 11, 12
    sweeps = [frame.sweep().xyz_m for frame in open_drive(raw_drive)]
    for folder in [path for path in raw_drive.rglob("data") if path.is_dir()]:
        for path in sorted(folder.iterdir(), reverse=True):
            path.rename(path.with_name(f"{int(path.stem) + shift}{path.suffix}"))
    drive = open_drive(raw_drive)
    assert [int(id_) for id_ in drive.ids] == sorted(int(id_) for id_ in drive.ids)
    assert np.array_equal(drive[2].sweep(-1).xyz_m, sweeps[1])
    assert all(frame.T_world_cam is not None for frame in drive)


def test_sweeps_in_another_byte_order_are_no_metres(raw_drive: Path) -> None:
    path = raw_drive / "velodyne_points" / "data" / "0000000000.bin"
    values = np.fromfile(path, "<f4")
    values.astype(">f4").tofile(path)
    with pytest.raises(DataError, match="values are metres: expected little-endian"):
        open_drive(raw_drive)[0].sweep()
    values[:4] = (1e30, 0, 0, 0)
    values[4:8] = (1e-38, 0, 0, 0)
    values.tofile(path)
    assert len(open_drive(raw_drive)[0].sweep().xyz_m) == len(values) // 4 - 2


BAD_CALIBRATIONS = [
    ("P_rect_02:", "P_rect_XX:", r"calib_cam_to_cam\.txt: calibration key P_rect_02 is missing"),
    ("S_rect_02: 2.4", "S_rect_02: nan 2.4", r"calib_cam_to_cam\.txt: S_rect_02 should be 2 finite numbers"),
    ("P_rect_02: 2.0", "P_rect_02: -2.0", r"calib_cam_to_cam\.txt: P_rect_02 is no pinhole"),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD_CALIBRATIONS)
def test_bad_calibration_is_named(raw_drive: Path, old: str, new: str, message: str) -> None:
    path = raw_drive.parent / "calib_cam_to_cam.txt"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(DataError, match=message):
        open_drive(raw_drive)


def test_missing_calibration_is_named(raw_drive: Path) -> None:
    (raw_drive.parent / "calib_cam_to_cam.txt").unlink()
    with pytest.raises(DataError, match=r"calib_cam_to_cam\.txt: no such file"):
        open_drive(raw_drive)


@pytest.mark.parametrize("same", [True, False])
def test_zero_and_negative_baseline_are_refused(raw_drive: Path, same: bool) -> None:
    path = raw_drive.parent / "calib_cam_to_cam.txt"
    lines = {line.split(":")[0]: line for line in path.read_text().splitlines(True)}
    left, right = lines["P_rect_02"], lines["P_rect_03"]
    lines["P_rect_03"] = left.replace("02:", "03:")
    lines["P_rect_02"] = left if same else right.replace("03:", "02:")
    path.write_text("".join(lines.values()))
    with pytest.raises(DataError, match=r"baseline from image_02 to image_03 is -?0\.[05]00 m, expected > 0"):
        open_drive(raw_drive)


def test_damaged_files_are_named_when_read_and_the_drive_opens(raw_drive: Path) -> None:
    first = raw_drive / "image_02" / "data" / "0000000000.png"
    first.write_bytes(first.read_bytes()[:200])
    small = raw_drive / "image_03" / "data" / "0000000001.png"
    codecs.write_image(small, codecs.read_image(small)[::2, ::2])
    sweeps = raw_drive / "velodyne_points" / "data"
    whole = (sweeps / "0000000001.bin").read_bytes()
    (sweeps / "0000000001.bin").write_bytes(whole[:-5])
    (sweeps / "0000000002.bin").write_bytes(b"")
    (sweeps / "0000000003.bin").write_bytes(np.full(40, np.nan, "<f4").tobytes())
    drive = open_drive(raw_drive)
    with pytest.raises(DataError, match=r"image_02/data/0000000000\.png: damaged image"):
        drive[0].image()
    with pytest.raises(DataError, match=r"0000000001\.png: is 120x48, the calibration is for 240x96"):
        drive[1].other()
    with pytest.raises(DataError, match=r"0000000001\.bin: \d+ bytes are not whole points .*download it again"):
        drive[1].sweep()
    with pytest.raises(DataError, match=r"0000000002\.bin: empty sweep"):
        drive[2].sweep()
    with pytest.raises(DataError, match=r"0000000003\.bin: no point in the sweep"):
        drive[3].sweep()
    assert drive[4].sweep() is not None and drive[4].image() is not None


def test_points_that_are_not_finite_are_left_out(raw_drive: Path) -> None:
    path = raw_drive / "velodyne_points" / "data" / "0000000000.bin"
    table = np.fromfile(path, "<f4").reshape(-1, 4)
    table[::7, 1] = np.inf
    table.tofile(path)
    xyz_m = open_drive(raw_drive)[0].sweep().xyz_m
    assert len(xyz_m) == len(table) - len(table[::7]) and np.isfinite(xyz_m).all()


def test_empty_timestamp_lines_keep_the_others_in_place(raw_drive: Path) -> None:
    path = raw_drive / "image_02" / "timestamps.txt"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:2], "", *lines[3:]]) + "\n")
    drive = open_drive(raw_drive)
    assert drive[2].time_s is None and drive[4].time_s == pytest.approx(0.4)


def test_fingerprint_follows_content_not_place(raw_drive: Path, tmp_path: Path) -> None:
    before = open_drive(raw_drive).fingerprint()
    assert open_drive(write_raw(tmp_path / "copy")).fingerprint() == before
    write_oxts(raw_drive / "oxts" / "data" / "0000000002.txt", 99.0)
    assert open_drive(raw_drive).fingerprint() != before


def test_real_poses_by_hand(real_data: RealData) -> None:
    drive = kitti_raw.KittiRaw(real_data("kitti_raw") / "2011_09_26" / "2011_09_26_drive_0001_sync")
    first, fifth = (np.loadtxt(drive.folder / "oxts/data" / f"000000000{n}.txt") for n in (0, 5))
    # Metres north and east on a sphere, turned into the first IMU's frame by its yaw (east = 0, anticlockwise).
    north = EARTH_RADIUS_M * np.radians(fifth[0] - first[0])
    east = EARTH_RADIUS_M * np.cos(np.radians(first[0])) * np.radians(fifth[1] - first[1])
    forward = east * np.cos(first[5]) + north * np.sin(first[5])
    leftward = north * np.cos(first[5]) - east * np.sin(first[5])
    T_imu_velo = invert(drive.calibration.T_velo_imu)
    T_world_imu = drive._T_world_velo("0000000005") @ invert(T_imu_velo)
    np.testing.assert_allclose(T_world_imu[:2, 3], [forward, leftward], atol=0.05)
    np.testing.assert_allclose(drive._T_world_velo("0000000000") @ invert(T_imu_velo), np.eye(4), atol=1e-6)


def test_real_speed_is_that_of_the_oxts(real_data: RealData) -> None:
    drive = kitti_raw.KittiRaw(real_data("kitti_raw") / "2011_09_26" / "2011_09_26_drive_0001_sync")
    for number in (6, 10, 15):
        id_ = f"{number:010d}"
        forward_m_s = np.loadtxt(drive.folder / "oxts/data" / f"{id_}.txt")[8]
        around = [drive._T_world_velo(f"{number + k:010d}") for k in (-1, 1)]
        moved_m = np.linalg.norm(around[1][:3, 3] - around[0][:3, 3])
        seconds = drive._times[number + 1] - drive._times[number - 1]
        assert moved_m / seconds == pytest.approx(forward_m_s, rel=0.05)


def test_real_projection_repeats_the_official_sparse_map(real_data: RealData) -> None:
    frame = open_drive(real_data("kitti_raw"))[5]
    official_m = frame.sparse().depth_m
    uv_px, depth = project(frame.camera, transform(frame.T_cam_lidar, untwist(frame.sweep())))
    ours_m = scatter_nearest(uv_px, depth, frame.camera.size)
    both = (official_m > 0) & (ours_m > 0)
    assert both.sum() > 0.9 * (official_m > 0).sum()
    assert np.mean(np.abs(official_m - ours_m)[both] < 0.02) > 0.999
    # Half a pixel off, or not untwisted, the points fall elsewhere.
    off_m = scatter_nearest(uv_px + np.float32(0.5), depth, frame.camera.size)
    assert ((official_m > 0) & (off_m > 0)).sum() < 0.5 * both.sum()
    uv_px, depth = project(frame.camera, transform(frame.T_cam_lidar, frame.sweep().xyz_m))
    twisted_m = scatter_nearest(uv_px, depth, frame.camera.size)
    assert ((official_m > 0) & (twisted_m > 0)).sum() < 0.5 * both.sum()


def test_real_pair_from_both_eyes(real_data: RealData) -> None:
    root = real_data("kitti_raw")
    left, right = open_drive(root)[0], open_drive(root, options=DriveOptions(camera="image_03"))[0]
    assert left.baseline_m == right.baseline_m == pytest.approx(0.5327, abs=1e-4)
    np.testing.assert_array_equal(left.other(), right.image())
    assert right.has("truth") and not np.array_equal(left.truth().depth_m, right.truth().depth_m)


def test_real_resized_drive_follows_its_links(real_data: RealData) -> None:
    drive = open_drive(real_data("kitti_raw_397x120"))
    assert len(drive) == 84 and drive[40].sweep() is not None and drive[40].T_world_cam is not None
    assert not drive[5].has("truth")  # the maps beside are for 1242x375
