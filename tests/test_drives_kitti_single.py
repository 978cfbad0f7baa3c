"""KITTI's object benchmark and depth's selected frames: cameras of their own, sweeps and maps joined to them."""

from pathlib import Path

import numpy as np
import pytest
from factories import BASELINE_M, SIZE, depth_m, scene
from layouts.kitti_single import DRIVES, write_object, write_selection
from layouts.kitti_stereo import SIZES, focal_px

from cli.priors import PROGRAM
from priors.check import check
from priors.drives import DriveOptions, open_drive, reopen
from priors.errors import DataError, UsageError
from priors.geometry import project, scatter_nearest, transform

pytestmark = pytest.mark.datasets


def test_object_frames(tmp_path: Path) -> None:
    write_object(tmp_path)
    drive = open_drive(tmp_path)
    assert drive.name == "kitti_object_training" and drive.describe()["dataset"] == "kitti_object"
    assert drive.ids == ["000000", "000002"]
    for frame, (index, size) in zip(drive, SIZES.items(), strict=True):
        assert frame.camera.size == size == frame.image().shape[:2] == frame.other().shape[:2]
        assert frame.camera.fx == focal_px(index) and frame.baseline_m == pytest.approx(BASELINE_M)
        assert frame.sweep(1) is None and frame.T_world_cam is None
    frame = drive[0]
    uv_px, z = project(frame.camera, transform(frame.T_cam_lidar, frame.sweep().xyz_m))
    seen = scatter_nearest(uv_px, z, SIZE)
    true_m = depth_m(scene()[2])
    np.testing.assert_allclose(seen[seen > 0], true_m[seen > 0], rtol=1e-4)
    assert (seen > 0).mean() > 0.1
    assert reopen(drive.describe()).fingerprint() == drive.fingerprint()
    assert {finding.level for finding in check(drive)} <= {"ok", "note"}


def test_object_without_the_right_image_or_sweeps(tmp_path: Path) -> None:
    split = write_object(tmp_path, right=False)
    drive = open_drive(split)
    with pytest.raises(DataError, match=r"image_3: no image 000000: stereo .*: download data_object_image_3\.zip"):
        drive[0].other()
    (split / "velodyne" / "000002.bin").write_bytes(b"")
    with pytest.raises(DataError, match=r"000002\.bin: empty sweep: download it again"):
        drive[1].sweep()
    (split / "velodyne" / "000002.bin").unlink()
    with pytest.raises(DataError, match=r"velodyne: no sweep 000002\.bin: download data_object_velodyne\.zip"):
        open_drive(split)[1].sweep()


def test_object_bad_input_is_one_line(tmp_path: Path) -> None:
    split = write_object(tmp_path)
    with pytest.raises(UsageError, match="no camera 'image_0': choose one of image_2, image_3"):
        open_drive(split, options=DriveOptions(camera="image_0"))
    with pytest.raises(UsageError, match="no drive 'testing' in it: found training"):
        open_drive(tmp_path, options=DriveOptions(drive="testing"))
    with pytest.raises(UsageError, match="has no depth maps: leave --truth out"):
        open_drive(split, options=DriveOptions(truth=tmp_path))
    path = split / "calib" / "000002.txt"
    path.write_text(path.read_text().replace("Tr_velo_to_cam", "Tr_velo"))
    drive = open_drive(split)
    assert drive[1].image().shape[:2] == SIZES["000001"]
    with pytest.raises(DataError, match=r"000002\.txt: calibration key Tr_velo_to_cam is missing"):
        drive[1].sweep()
    path.unlink()
    with pytest.raises(DataError, match=r"calib/000002\.txt: no such file: download data_object_calib\.zip"):
        _ = open_drive(split)[1]


@pytest.mark.parametrize(
    "name", ["val_selection_cropped", "test_depth_completion_anonymous", "test_depth_prediction_anonymous"]
)
def test_selected_frames(tmp_path: Path, name: str) -> None:
    write_selection(tmp_path, name)
    drive = open_drive(tmp_path)
    assert drive.name == f"kitti_depth_{name}" and drive.describe()["dataset"] == "kitti_depth"
    for number, (frame, (index, size)) in enumerate(zip(drive, SIZES.items(), strict=True)):
        assert frame.camera.size == size == frame.image().shape[:2] and frame.camera.fx == focal_px(index)
        true_m = focal_px(index) * BASELINE_M / scene(size)[2]
        if name == "val_selection_cropped":
            assert frame.id == f"{DRIVES[number]}_image_{number + 5:010d}_image_0{2 + number}"
            np.testing.assert_allclose(frame.truth().depth_m, true_m, atol=0.51 / 256)
        else:
            assert frame.id == f"{number:010d}"
            with pytest.raises(DataError, match=f"{name} has no truth, the benchmark keeps it"):
                frame.truth()
        if name == "test_depth_prediction_anonymous":
            with pytest.raises(DataError, match="velodyne_raw: no map of 000000000"):
                frame.sparse()
        else:
            sparse_m = frame.sparse().depth_m
            np.testing.assert_allclose(sparse_m[sparse_m > 0], true_m[sparse_m > 0], atol=0.51 / 256)
    assert reopen(drive.describe()).fingerprint() == drive.fingerprint()
    assert "fatal" not in {finding.level for finding in check(drive)}


def test_selected_frames_are_completed_and_scored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_selection(tmp_path)
    flags = ["--method", "auto", "--cache", str(tmp_path / "cache")]
    assert PROGRAM.run(["build", str(folder), *flags]) == 0
    assert "method: completion: it has sparse depth maps" in capsys.readouterr().err
    assert PROGRAM.run(["eval", str(tmp_path / "cache"), "--protocol", "kitti-completion"]) == 0
    assert "2 frames" in capsys.readouterr().out


def test_selection_bad_input_is_one_line(tmp_path: Path) -> None:
    folder = write_selection(tmp_path)
    write_selection(tmp_path, "test_depth_completion_anonymous")
    with pytest.raises(UsageError, match="holds 2 drives: choose with --drive test_depth_completion_anonymous"):
        open_drive(tmp_path)
    for options, message in (
        (DriveOptions(camera="image_02"), "mixes image_02 and image_03: leave --camera image_02 out"),
        (DriveOptions(truth=tmp_path), "has its own truth: leave --truth out"),
    ):
        with pytest.raises(UsageError, match=message):
            open_drive(folder, options=options)
    path = folder / "intrinsics" / f"{open_drive(folder).ids[1]}.txt"
    path.write_text("1 2 3")
    with pytest.raises(DataError, match=r"expected 9 numbers, found 3 words: download data_depth_selection\.zip"):
        _ = open_drive(folder)[1]
    path.unlink()
    with pytest.raises(DataError, match=r"image_03\.txt: no such file"):
        _ = open_drive(folder)[1]
