"""The KITTI odometry reader: layouts, poses, and what it says about partial downloads."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import RealData
from factories import BASELINE_M, SIZE, STEP_M, depth_m, scene, write_odometry

from priors import codecs
from priors.drives import DriveOptions, open_drive, reopen
from priors.drives._rigs import KITTI
from priors.errors import DataError
from priors.geometry import project, transform


@pytest.mark.parametrize("inside", [".", "sequences", "sequences/06"])
def test_opens_root_sequences_folder_and_sequence(odometry_root: Path, inside: str) -> None:
    drive = open_drive(odometry_root / inside)
    assert drive.name == "kitti_odometry_06" and len(drive) == 5


def test_opens_the_zips_own_root(tmp_path: Path) -> None:
    write_odometry(tmp_path / "dataset")
    assert len(open_drive(tmp_path)) == 5


def test_colour_camera_is_shifted_from_camera_0(odometry_root: Path) -> None:
    frame = open_drive(odometry_root)[2]
    assert frame.baseline_m == pytest.approx(BASELINE_M)
    # P2 says x_2 = x_0 + 0.06: the camera stands 0.06 m to the left of camera 0.
    np.testing.assert_allclose(frame.T_world_cam[:3, 3], [-0.06, 0, 2 * STEP_M], atol=1e-9)
    assert frame.time_s == pytest.approx(0.2)


def test_sweep_lands_on_the_scene(odometry_root: Path) -> None:
    frame = open_drive(odometry_root)[1]
    sweep = frame.sweep()
    assert sweep.time_s is None and sweep.velocity is None  # compensated by the data set
    uv_px, found_m = project(frame.camera, transform(frame.T_cam_lidar, sweep.xyz_m))
    cell = np.rint(uv_px).astype(int)
    np.testing.assert_allclose(found_m, depth_m(scene()[2])[cell[:, 1], cell[:, 0]], rtol=1e-4)
    np.testing.assert_allclose(sweep.T_world_lidar, frame.T_world_cam @ frame.T_cam_lidar, atol=1e-9)
    assert frame.sweep(3) is not None and frame.sweep(4) is None


def test_right_eye(odometry_root: Path) -> None:
    frame = open_drive(odometry_root, options=DriveOptions(camera="image_3"))[0]
    assert frame.side == "right" and frame.baseline_m == pytest.approx(BASELINE_M)
    np.testing.assert_array_equal(frame.other()[..., 0], scene()[0])


def test_grey_only_download_works_and_names_the_zips(tmp_path: Path) -> None:
    drive = open_drive(write_odometry(tmp_path, grey_only=True))
    frame = drive[0]
    assert drive.name == "kitti_odometry_06-image_0"
    assert frame.image().shape == SIZE and frame.other().shape == SIZE
    assert frame.T_world_cam is not None and frame.time_s is None and frame.T_cam_lidar is None
    with pytest.raises(DataError, match=r"data_odometry_velodyne\.zip"):
        frame.sweep()
    with pytest.raises(DataError, match=r"image_2: no images: download data_odometry_color\.zip \(found image_0"):
        open_drive(tmp_path, options=DriveOptions(camera="image_2"))


def test_velodyne_without_tr_says_where_to_get_it(tmp_path: Path) -> None:
    root = write_odometry(tmp_path)
    calib = root / "sequences" / "06" / "calib.txt"
    calib.write_text("".join(line for line in calib.read_text().splitlines(True) if not line.startswith("Tr")))
    frame = open_drive(root)[0]
    with pytest.raises(DataError, match=r"no Tr .*data_odometry_calib\.zip"):
        frame.sweep()


def test_a_damaged_tr_stops_the_sweeps_alone(tmp_path: Path) -> None:
    write_odometry(tmp_path)
    calib = tmp_path / "sequences" / "06" / "calib.txt"
    lines = calib.read_text().splitlines(True)
    calib.write_text("".join(" ".join(line.split()[:9]) + "\n" if line.startswith("Tr") else line for line in lines))
    frame = open_drive(tmp_path)[0]
    assert frame.other().shape == frame.image().shape and frame.T_world_cam is not None
    with pytest.raises(DataError, match=r"calib\.txt: Tr should be 12 finite numbers"):
        frame.sweep()


def test_several_sequences_need_a_name(odometry_root: Path) -> None:
    write_odometry(odometry_root, sequence="07")
    with pytest.raises(DataError, match=r"holds 2 drives: choose with --drive 06"):
        open_drive(odometry_root)
    assert open_drive(odometry_root, options=DriveOptions(drive="07")).name == "kitti_odometry_07"
    with pytest.raises(DataError, match=r"no drive '99' in it: found 06, 07"):
        open_drive(odometry_root, options=DriveOptions(drive="99"))


def test_bad_pose_spoils_its_own_frame_only(odometry_root: Path) -> None:
    path = odometry_root / "poses" / "06.txt"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:2], lines[2].replace("1 0", "nan 0", 1), lines[3]]) + "\n")
    drive = open_drive(odometry_root)
    assert drive[1].T_world_cam is not None and drive[3].T_world_cam is not None
    with pytest.raises(DataError, match=r"06\.txt: line 3: a pose should be 12 finite numbers, found NaN"):
        drive[2].pose()
    with pytest.raises(DataError, match=r"06\.txt: 4 poses, none for frame 000004"):
        drive[4].pose()
    assert drive[4].image().size  # what needs no pose goes on


def test_a_linked_sequence_has_its_poses(odometry_root: Path, tmp_path: Path) -> None:
    sequence = next(odometry_root.rglob("calib.txt")).parent
    (tmp_path / "link").symlink_to(sequence)
    assert np.array_equal(open_drive(tmp_path / "link")[1].pose(), open_drive(sequence)[1].pose())


def _with_ids(lines: list[str]) -> list[str]:
    return [f"{number} {line}" for number, line in reversed(list(enumerate(lines)))]


@pytest.mark.parametrize(
    "change",
    [
        lambda lines: ["# made by hand", "", *lines, ""],
        lambda lines: [part for line in lines for part in (line, "")],  # every line end was doubled
        _with_ids,
        lambda lines: [f"{number:.6e} {line}" for number, line in enumerate(lines)],  # numpy.savetxt
    ],
    ids=["header", "doubled", "ids", "ids as floats"],
)
def test_poses_are_the_frames_own_however_they_are_written(
    odometry_root: Path, change: Callable[[list[str]], list[str]]
) -> None:
    expected = [frame.pose() for frame in open_drive(odometry_root)]
    path = odometry_root / "poses" / "06.txt"
    path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")
    np.testing.assert_array_equal([frame.pose() for frame in open_drive(odometry_root)], expected)


def test_an_empty_line_among_poses_is_a_pose_that_is_not_there(odometry_root: Path) -> None:
    expected = open_drive(odometry_root)[3].pose()
    path = odometry_root / "poses" / "06.txt"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:2], "", *lines[3:]]))
    drive = open_drive(odometry_root)
    np.testing.assert_array_equal(drive[3].pose(), expected)
    with pytest.raises(DataError, match=r"06\.txt: line 3: a pose should be 12 finite numbers, found 0"):
        drive[2].pose()


def test_two_poses_of_one_frame_are_told(odometry_root: Path) -> None:
    path = odometry_root / "poses" / "06.txt"
    path.write_text("".join(f"1 {line}\n" for line in path.read_text().splitlines()))
    with pytest.raises(DataError, match=r"lines 1 and 2 are both of frame 1: drop one"):
        open_drive(odometry_root)[1].pose()


def test_sequence_without_poses(odometry_root: Path) -> None:
    (odometry_root / "poses" / "06.txt").unlink()
    frame = open_drive(odometry_root)[0]
    assert frame.T_world_cam is None and frame.sweep().T_world_lidar is None


def test_truth_through_the_raw_drive(tmp_path: Path) -> None:
    root = write_odometry(tmp_path / "odometry", sequence="08")
    maps = tmp_path / "maps" / "train" / "2011_09_30_drive_0028_sync" / "proj_depth" / "groundtruth" / "image_02"
    codecs.write_depth_png(maps / "0000001102.png", np.full(SIZE, 12.5, np.float32))  # 08 starts at raw frame 1100
    drive = open_drive(root, options=DriveOptions(truth=tmp_path / "maps"))
    assert not drive[1].has("truth")
    np.testing.assert_allclose(drive[2].truth().depth_m, 12.5)
    again = reopen(drive.describe())
    assert again[2].has("truth") and again.fingerprint() == drive.fingerprint()


def test_resized_images_are_refused(tmp_path: Path) -> None:
    root = write_odometry(tmp_path)
    folder = root / "sequences" / "06" / "image_2"
    for path in folder.iterdir():
        codecs.write_image(path, codecs.read_image(path)[::3, ::3])
    with pytest.raises(DataError, match=r"calib\.txt: the images are 80x32, .*was one of them resized"):
        open_drive(root)


def test_swapped_projections_are_refused(odometry_root: Path) -> None:
    calib = odometry_root / "sequences" / "06" / "calib.txt"
    calib.write_text(calib.read_text().replace("P2:", "PX:").replace("P3:", "P2:").replace("PX:", "P3:"))
    with pytest.raises(DataError, match=r"calib\.txt: the baseline .* is -0\.500 m, expected > 0"):
        open_drive(odometry_root)


def test_another_rig_in_kittis_layout_is_not_kittis(odometry_root: Path) -> None:
    """What KITTI's own pairs are off by says nothing of other cars' pairs."""
    (odometry_root / "sequences" / "06").rename(odometry_root / "sequences" / "60")
    assert open_drive(odometry_root)[0].rig is None


def test_real_grey_download(real_data: RealData) -> None:
    root = real_data("kitti_odometry")
    drive = open_drive(root, options=DriveOptions(drive="06"))
    frame = drive[1]
    assert drive[0].rig == KITTI
    assert len(drive) == 51 and frame.camera.size == (370, 1226)
    assert frame.baseline_m == pytest.approx(379.8145 / 707.0912)
    np.testing.assert_allclose(frame.T_world_cam[:3, 3], [-1.401751e-02, -2.820321e-02, 1.198998], rtol=1e-6)
    assert frame.image().shape == frame.other().shape == (370, 1226)
