"""Argoverse 2: sensors joined by time, poses between poses, sweeps in the vehicle's frame, a pair turned to rows."""

from pathlib import Path

import numpy as np
import pytest
from factories import BASELINE_M, FX, SIZE, depth_m, scene
from independent import parse
from layouts.argoverse2 import RING, START_NS, T_EGO_CAM, placed, write_log

from priors.check import check
from priors.drives import DriveOptions, open_drive, reopen
from priors.errors import DataError, UsageError
from priors.geometry import project, scatter_nearest, transform

pytest.importorskip("pyarrow", reason="Argoverse 2 is read by pyarrow: the extra argoverse2")
pytestmark = pytest.mark.datasets


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write_log(tmp_path / "sensor" / "val" / "0b86f508-5df9-4a46-bc59-5b9536dbde9f")


def test_the_stereo_pair(log: Path) -> None:
    drive = open_drive(log.parents[1])  # sensor/
    assert drive.name == f"{log.name}-stereo_front_left" and drive.describe()["dataset"] == "argoverse2"
    assert drive.ids == [str(START_NS + n * 50_000_000) for n in range(4)]
    for number, frame in enumerate(drive):
        left, right, _ = scene(seed=number)
        assert np.abs(frame.image().astype(int) - left).max() <= 1  # the warp of a straight pair moves nothing
        assert np.abs(frame.other().astype(int) - right).max() <= 1
        assert frame.baseline_m == pytest.approx(BASELINE_M) and frame.camera.fx == pytest.approx(FX)
        assert frame.time_s == pytest.approx(0.05 * number)
        np.testing.assert_allclose(frame.pose(), placed(int(frame.id)) @ T_EGO_CAM, atol=1e-6)
    frame = drive[1]  # 20 ms before its sweep
    assert frame.sweep(1) is not None and frame.sweep(2) is None and frame.sweep(-1) is None
    uv_px, z = project(frame.camera, transform(frame.T_cam_lidar, frame.sweep().xyz_m))
    seen, true_m = scatter_nearest(uv_px, z, SIZE), depth_m(scene()[2])
    assert (seen > 0).mean() > 0.1
    np.testing.assert_allclose(seen[seen > 0], true_m[seen > 0], rtol=1e-3)
    assert reopen(drive.describe()).fingerprint() == drive.fingerprint()
    assert "fatal" not in {finding.level for finding in check(drive)}


def test_a_turned_pair_is_rectified(tmp_path: Path) -> None:
    drive = open_drive(write_log(tmp_path / "log", turn_degrees=1.0))
    right = open_drive(tmp_path / "log", options=DriveOptions(camera="stereo_front_right"))
    assert drive[0].baseline_m == right[0].baseline_m == pytest.approx(BASELINE_M)
    np.testing.assert_array_equal(drive[0].camera.K, right[0].camera.K)
    T_left_right = np.linalg.inv(drive[0].pose()) @ right[0].pose()
    wanted = np.eye(4)
    wanted[0, 3] = BASELINE_M
    np.testing.assert_allclose(T_left_right, wanted, atol=1e-9)


def test_a_ring_camera(log: Path) -> None:
    drive = open_drive(log, options=DriveOptions(camera="ring_front_center"))
    frame = drive[0]
    assert frame.image().shape == RING == frame.camera.size and frame.baseline_m is None
    np.testing.assert_allclose(frame.pose(), placed(START_NS) @ T_EGO_CAM, atol=1e-6)
    with pytest.raises(DataError, match="ring cameras have no partner: stereo needs --camera stereo_front_left"):
        frame.other()
    with pytest.raises(DataError, match="Argoverse 2 has no depth maps: score against the LiDAR"):
        frame.truth()


def test_av2_reads_the_same(log: Path) -> None:
    theirs = parse("read_argoverse2.py", log)
    drive = open_drive(log, options=DriveOptions(camera="ring_front_center"))
    own = theirs["cameras"]["ring_front_center"]
    np.testing.assert_allclose(drive.camera.K, own["K"])
    assert drive.camera.size == tuple(own["size"])
    np.testing.assert_allclose(drive.rectified.T_ego_cam, own["T_ego_cam"], atol=1e-12)
    assert len(theirs["poses"]) == 5
    for time, T_city_ego in theirs["poses"].items():
        np.testing.assert_allclose(drive.T_world_ego(int(time)), T_city_ego, atol=1e-9)
    for time, xyz_m in theirs["sweeps"].items():
        np.testing.assert_allclose(drive.read_points(drive.sweeps[int(time)]), xyz_m, atol=1e-6)


def test_bad_input_is_one_line(log: Path) -> None:
    for options, message in (
        (DriveOptions(drive="x"), "no drive 'x' in it: found 0b86f508"),
        (DriveOptions(truth=log), "Argoverse 2 has no depth maps: leave --truth out"),
    ):
        with pytest.raises(UsageError, match=message):
            open_drive(log, options=options)
    with pytest.raises(DataError, match=r"no images: choose a --camera \(found ring_front_center, stereo_front_left, "):
        open_drive(log, options=DriveOptions(camera="ring_rear"))
    sweep = next((log / "sensors" / "lidar").iterdir())
    sweep.write_bytes(b"no table")
    with pytest.raises(DataError, match=rf"{sweep.name}: damaged feather file .*: download it again"):
        open_drive(log)[0].sweep()
    (log / "city_SE3_egovehicle.feather").unlink()
    with pytest.raises(DataError, match=r"city_SE3_egovehicle\.feather: no such file: download the log again"):
        open_drive(log)[0].pose()
    path = log / "calibration" / "intrinsics.feather"
    (log / "calibration" / "egovehicle_SE3_sensor.feather").rename(path)
    with pytest.raises(DataError, match=r"intrinsics\.feather: has no column fx_px \(found sensor_name, qw"):
        open_drive(log)
    path.unlink()
    with pytest.raises(DataError, match=r"intrinsics\.feather: no such file: download the log again"):
        open_drive(log)


def test_without_pyarrow_the_extra_is_named(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(
        DataError, match=r"read by pyarrow, which is not installed: pip install 'roadprior\[argoverse2\]'"
    ):
        open_drive(log)
