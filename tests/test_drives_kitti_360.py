"""KITTI-360: trees joined by number, poses with numbers of their own, rectified cameras, sweeps in turn."""

from pathlib import Path

import numpy as np
import pytest
from factories import BASELINE_M, SIZE, STEP_M, depth_m, scene
from independent import parse
from layouts.kitti_360 import SEQUENCE, placed, shift, write_360

from priors.check import check
from priors.drives import DriveOptions, open_drive, reopen
from priors.errors import DataError, UsageError
from priors.geometry import invert, project, scatter_nearest, transform

pytestmark = pytest.mark.datasets


@pytest.mark.parametrize("camera", ["image_00", "image_01"])
@pytest.mark.parametrize("poses", ["poses.txt", "cam0_to_world.txt"])
def test_poses_pairs_and_sweeps(tmp_path: Path, camera: str, poses: str) -> None:
    write_360(tmp_path)
    if poses != "poses.txt":
        (tmp_path / "data_poses" / SEQUENCE / "poses.txt").unlink()
    drive = open_drive(tmp_path, options=DriveOptions(camera=camera))
    assert drive.describe()["dataset"] == "kitti_360" and drive.ids == [f"{n:010d}" for n in range(250, 254)]
    assert drive.name.startswith(f"kitti_360_{SEQUENCE}") and drive[0].baseline_m == pytest.approx(BASELINE_M)
    for frame in drive:
        number = int(frame.id)
        assert frame.image().shape == frame.other().shape == (*SIZE, 3)
        assert frame.time_s == pytest.approx(0.1 * number)
        if number == 252:  # it stood still, by the data set's account
            assert frame.T_world_cam is None
            continue
        right_m = BASELINE_M if camera == "image_01" else 0.0
        np.testing.assert_allclose(frame.pose(), placed(number) @ shift(right_m), atol=1e-9)
        sweep = frame.sweep()
        T_world_lidar = frame.pose() @ frame.T_cam_lidar
        np.testing.assert_allclose(sweep.T_world_lidar, T_world_lidar, atol=1e-9)
    assert drive[0].sweep(9) is None and drive[3].sweep(-1) is not None
    np.testing.assert_allclose(np.linalg.norm(drive[0].sweep().velocity[:3]), STEP_M / 0.1)
    if camera == "image_00":
        uv_px, z = project(drive[0].camera, transform(drive[0].T_cam_lidar, drive[0].sweep().xyz_m))
        seen, true_m = scatter_nearest(uv_px, z, SIZE), depth_m(scene()[2])
        assert (seen > 0).mean() > 0.1
        np.testing.assert_allclose(seen[seen > 0], true_m[seen > 0], rtol=1e-4)
    assert reopen(drive.describe()).fingerprint() == drive.fingerprint()


def test_kitti360scripts_reads_the_same(tmp_path: Path) -> None:
    write_360(tmp_path)
    theirs = parse("read_kitti360.py", tmp_path, SEQUENCE)
    for camera in ("image_00", "image_01"):
        drive = open_drive(tmp_path, options=DriveOptions(camera=camera))
        own = theirs[camera]
        posed = {str(int(frame.id)): frame.T_world_cam for frame in drive if frame.T_world_cam is not None}
        assert posed.keys() == own["T_world_cam"].keys()
        for number, T_world_cam in posed.items():
            np.testing.assert_allclose(T_world_cam, own["T_world_cam"][number], atol=1e-9)
        np.testing.assert_allclose(drive.camera.K, own["K"])
        assert drive.camera.size == tuple(own["size"])
    T_cam0_velo = open_drive(tmp_path)[0].T_cam_lidar
    wanted = np.array(theirs["image_00"]["R_rect"]) @ np.linalg.inv(theirs["T_velo_cam0"])
    np.testing.assert_allclose(T_cam0_velo, wanted, atol=1e-9)
    assert np.allclose(invert(T_cam0_velo) @ T_cam0_velo, np.eye(4))


def test_the_audit_and_a_link(tmp_path: Path) -> None:
    drive = write_360(tmp_path / "data", posed=range(250, 254))
    link = tmp_path / "link"
    link.symlink_to(drive)
    findings = check(open_drive(link))
    assert "fatal" not in {finding.level for finding in findings}
    assert open_drive(link)[0].has("sweep") and open_drive(link)[0].T_world_cam is not None


def test_bad_input_is_one_line(tmp_path: Path) -> None:
    drive = write_360(tmp_path)
    with pytest.raises(UsageError, match="image_02 is a fish-eye, which is not read: choose one of image_00, image_01"):
        open_drive(tmp_path, options=DriveOptions(camera="image_02"))
    with pytest.raises(UsageError, match="no drive '2013' in it"):
        open_drive(tmp_path, options=DriveOptions(drive="2013"))
    with pytest.raises(UsageError, match="has no depth maps: leave --truth out"):
        open_drive(tmp_path, options=DriveOptions(truth=tmp_path))
    sweep = tmp_path / "data_3d_raw" / SEQUENCE / "velodyne_points" / "data" / "0000000251.bin"
    sweep.write_bytes(b"")
    with pytest.raises(DataError, match=r"0000000251\.bin: empty sweep"):
        open_drive(drive)[1].sweep()
    (tmp_path / "calibration" / "calib_cam_to_velo.txt").unlink()
    with pytest.raises(DataError, match=r"calib_cam_to_velo\.txt: no such file, so the sweeps cannot be placed"):
        open_drive(drive)[0].sweep()
    (tmp_path / "calibration" / "calib_cam_to_pose.txt").unlink()
    with pytest.raises(DataError, match=r"calib_cam_to_pose\.txt: no such file, so poses\.txt tells no camera's pose"):
        open_drive(drive)[0].pose()
    path = tmp_path / "data_poses" / SEQUENCE / "cam0_to_world.txt"
    path.with_name("poses.txt").unlink()
    path.write_text(path.read_text().replace("251 ", "251 x "))
    assert open_drive(drive)[0].T_world_cam is not None  # a line is its own frame's
    with pytest.raises(DataError, match=r"cam0_to_world\.txt: line 2: not 12 numbers: 'x "):
        open_drive(drive)[1].pose()
    with pytest.raises(DataError, match=r"no line of this frame: the car stood still in it, leave it out"):
        open_drive(drive)[2].pose()
    path.write_text("nothing\n")
    with pytest.raises(
        DataError, match=r"cam0_to_world\.txt: no line begins with a frame's number: download data_poses"
    ):
        open_drive(drive)[0].pose()
    path.unlink()
    with pytest.raises(DataError, match=r"poses\.txt: no such file: download data_poses of"):
        open_drive(drive)[0].pose()
    (tmp_path / "calibration" / "perspective.txt").unlink()
    with pytest.raises(DataError, match=r"perspective\.txt: no such file"):
        open_drive(drive)
