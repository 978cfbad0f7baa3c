"""nuScenes: scenes by name, keyframes and what lies between, six cameras, sweeps by their own poses."""

import json
from pathlib import Path

import numpy as np
import pytest
from factories import SIZE, K, depth_m, scene
from independent import parse
from layouts.nuscenes import CAMERAS, LATE_US, SCENES, START_US, T_EGO_LIDAR, on_the_car, placed, write_nuscenes

from cli.priors import PROGRAM
from priors.check import check
from priors.drives import DriveOptions, open_drive, reopen
from priors.drives._rectified import to_pose
from priors.errors import DataError, UsageError
from priors.geometry import project, scatter_nearest, transform

pytestmark = pytest.mark.datasets
FRONT = DriveOptions(drive=SCENES[0])


@pytest.mark.parametrize("channel", CAMERAS)
@pytest.mark.parametrize("number", [0, 1])
def test_scenes_cameras_and_poses(tmp_path: Path, number: int, channel: str) -> None:
    write_nuscenes(tmp_path)
    drive = open_drive(tmp_path, options=DriveOptions(drive=SCENES[number], camera=channel))
    named = f"nuscenes_{SCENES[number]}"
    assert drive.name == (named if channel == "CAM_FRONT" else f"{named}-{channel}")
    start = START_US + 1_000_000_000 * number
    assert drive.ids == [str(start + n * 83_333) for n in range(3)]
    for n, frame in enumerate(drive):
        assert frame.image().shape == SIZE == frame.camera.size and frame.time_s == pytest.approx(n * 0.083333)
        np.testing.assert_array_equal(frame.camera.K, K)
        np.testing.assert_allclose(frame.pose(), placed(int(frame.id), number) @ on_the_car(channel), atol=1e-9)
        T_world_lidar = placed(int(frame.id) + LATE_US, number) @ T_EGO_LIDAR
        np.testing.assert_allclose(frame.sweep().T_world_lidar, T_world_lidar, atol=1e-9)
        np.testing.assert_allclose(frame.pose() @ frame.T_cam_lidar, T_world_lidar, atol=1e-9)
    again = reopen(drive.describe())
    assert (again.name, again.ids, again.fingerprint()) == (drive.name, drive.ids, drive.fingerprint())


def test_sweeps_fall_where_the_wall_is(tmp_path: Path) -> None:
    drive = open_drive(write_nuscenes(tmp_path), options=FRONT)
    frame = drive[1]
    uv_px, z = project(frame.camera, transform(frame.T_cam_lidar, frame.sweep().xyz_m))
    seen, true_m = scatter_nearest(uv_px, z, SIZE), depth_m(scene()[2])
    assert (seen > 0).mean() > 0.1
    np.testing.assert_allclose(seen[seen > 0], true_m[seen > 0], rtol=1e-3)
    assert frame.sweep(1) is not None and frame.sweep(2) is None and frame.sweep(-2) is None
    assert "fatal" not in {finding.level for finding in check(drive)}
    two = {open_drive(tmp_path, options=DriveOptions(drive=name)).fingerprint() for name in SCENES}
    assert len(two) == 2


def test_the_devkit_reads_the_same(tmp_path: Path) -> None:
    write_nuscenes(tmp_path)
    theirs = parse("read_nuscenes.py", tmp_path, "v1.0-mini", SCENES[1])
    assert theirs.keys() == {*CAMERAS, "LIDAR_TOP"}
    for channel in CAMERAS:
        drive = open_drive(tmp_path, options=DriveOptions(drive=SCENES[1], camera=channel))
        assert [str(record["time_us"]) for record in theirs[channel]] == drive.ids
        for frame, record in zip(drive, theirs[channel], strict=True):
            assert drive.images[frame.id] == tmp_path / record["file"]
            ego, sensor = (to_pose(record["rotation"][n], record["translation"][n], "theirs") for n in (0, 1))
            np.testing.assert_allclose(frame.pose(), ego @ sensor, atol=1e-9)
            np.testing.assert_array_equal(frame.camera.K, record["K"])
        for record, (time, path) in zip(theirs["LIDAR_TOP"], drive.sweeps.items(), strict=True):
            assert record["time_us"] == time
            np.testing.assert_array_equal(drive.read_points(path), np.array(record["points"], np.float32))


def test_a_scene_is_chosen(tmp_path: Path) -> None:
    write_nuscenes(tmp_path)
    with pytest.raises(UsageError, match="holds 2 drives: choose with --drive scene-0061"):
        open_drive(tmp_path)
    with pytest.raises(UsageError, match="no drive 'scene-9' in it: found scene-0061, scene-0103"):
        open_drive(tmp_path, options=DriveOptions(drive="scene-9"))
    with pytest.raises(UsageError, match="no camera 'CAM_TOP': choose one of CAM_FRONT, CAM_FRONT_LEFT"):
        open_drive(tmp_path, options=DriveOptions(drive=SCENES[0], camera="CAM_TOP"))
    with pytest.raises(UsageError, match="nuScenes has no depth maps: leave --truth out"):
        open_drive(tmp_path, options=DriveOptions(drive=SCENES[0], truth=tmp_path))
    write_nuscenes(tmp_path / "one", scenes=SCENES[:1])
    assert open_drive(tmp_path / "one").name == "nuscenes_scene-0061"


def test_bad_input_is_one_line(tmp_path: Path) -> None:
    write_nuscenes(tmp_path)
    folder = tmp_path / "v1.0-mini"
    sweep = next((tmp_path / "samples" / "LIDAR_TOP").iterdir())
    for data, message in ((b"", "empty sweep"), (b"123", "3 bytes are not whole points of 20 bytes: truncated")):
        sweep.write_bytes(data)
        with pytest.raises(DataError, match=rf"{sweep.name}: {message}"):
            open_drive(tmp_path, options=FRONT)[0].sweep()
    for path in (tmp_path / "samples" / "CAM_BACK").iterdir():
        path.unlink()
    back = DriveOptions(drive=SCENES[0], camera="CAM_BACK")
    assert len(open_drive(tmp_path, options=back)) == 2  # what lies between keyframes
    for path in (tmp_path / "sweeps" / "CAM_BACK").iterdir():
        path.unlink()
    with pytest.raises(DataError, match="none of the 3 images of CAM_BACK of scene-0061 is there: download its blob"):
        open_drive(tmp_path, options=back)
    records = json.loads((folder / "ego_pose.json").read_text())
    (folder / "ego_pose.json").write_text(json.dumps(records[3:]))
    drive = open_drive(tmp_path, options=DriveOptions(drive=SCENES[1]))
    assert drive[0].T_world_cam is not None
    with pytest.raises(
        DataError, match=r"ego_pose\.json: no record d-scene-0061-CAM_FRONT-0, which another table names"
    ):
        open_drive(tmp_path, options=FRONT)[0].pose()
    for name in ("calibrated_sensor", "sample", "scene"):
        text = (folder / f"{name}.json").read_text()
        (folder / f"{name}.json").write_text(text[:-10])
        with pytest.raises(DataError, match=rf"{name}\.json: damaged JSON .*: unpack the metadata again"):
            open_drive(tmp_path, options=FRONT)
        (folder / f"{name}.json").unlink()
        with pytest.raises(DataError, match=rf"{name}\.json: no such file"):
            open_drive(tmp_path, options=FRONT)
        (folder / f"{name}.json").write_text(text)


def test_completion_of_its_lidar(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = write_nuscenes(tmp_path / "nuscenes")
    flags = ["--drive", SCENES[0], "--method", "auto", "--cache", str(tmp_path / "cache"), "--frames", "0:1"]
    assert PROGRAM.run(["build", str(root), *flags]) == 0
    assert "method: completion: it has a LiDAR and no stereo pair" in capsys.readouterr().err
    assert PROGRAM.run(["check", str(tmp_path / "cache")]) == 0
