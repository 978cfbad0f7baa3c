"""KITTI stereo 2012 and 2015: cameras of their own, truth as disparity, cars apart from the background."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import RealData
from factories import BASELINE_M
from layouts.kitti_stereo import SIZES, focal_px, write_2012, write_2015
from reference import eval as slow

from cli.priors import PROGRAM
from eval.protocol import preset
from priors import build
from priors.check import check
from priors.drives import DriveOptions, open_drive, reopen
from priors.errors import DataError, UsageError
from priors.methods.lidar import Lidar
from priors.methods.mono import Mono
from priors.methods.stereo import Stereo
from priors.score import score
from priors.selection import Selection

pytestmark = pytest.mark.datasets


@pytest.mark.parametrize("year", ["2015", "2012"])
def test_each_frame_has_its_own_camera(tmp_path: Path, year: str) -> None:
    split = write_2015(tmp_path) if year == "2015" else write_2012(tmp_path)
    drive = open_drive(tmp_path)  # the split below
    assert drive.name == f"kitti_stereo{year}_training" and drive.describe()["dataset"] == "kitti_stereo"
    assert drive.ids == ["000000_10", "000001_10"]
    for frame, (index, size) in zip(drive, SIZES.items(), strict=True):
        assert frame.camera.size == size == frame.image().shape[:2] == frame.other().shape[:2]
        assert frame.camera.fx == focal_px(index) and frame.baseline_m == pytest.approx(BASELINE_M)
        assert frame.T_world_cam is None and frame.time_s is None
        folder = "disp_occ_0" if year == "2015" else "disp_occ"
        codes = cv2.imread(str(split / folder / f"{frame.id}.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_allclose(frame.truth().depth_m, focal_px(index) * BASELINE_M / (codes / 256), rtol=1e-6)
    again = reopen(drive.describe())
    assert again.fingerprint() == drive.fingerprint() and again.ids == drive.ids


def test_the_smaller_truth_is_named(tmp_path: Path) -> None:
    split = write_2015(tmp_path)
    for named in (split / "disp_noc_0", tmp_path / "truth"):
        if named.name == "truth":
            (named / "training").mkdir(parents=True)
            (split / "disp_noc_0").rename(named / "training" / "disp_noc_0")
        drive = open_drive(split, options=DriveOptions(truth=named))
        assert drive.describe()["truth_maps"] == "disp_noc_0"
        assert 0 < drive[0].truth().density < 1


def test_colour_of_2012_has_truth_where_it_is_named(tmp_path: Path) -> None:
    split = write_2012(tmp_path)
    options = DriveOptions(camera="colored_0")
    drive = open_drive(split, options=options)
    assert drive.name == "kitti_stereo2012_training-colored_0" and drive[0].image().ndim == 3
    offer = r"grey camera, 6 cm to the right: choose --camera image_0, or take it as it is: --truth .*disp_occ$"
    with pytest.raises(DataError, match=offer):
        drive[0].truth()
    assert not drive.notes() and not open_drive(split).notes()  # the grey camera's own
    named = open_drive(split, options=replace(options, truth=split / "disp_occ"))
    assert named[1].has("truth")
    aside_px = 45 * 0.06 / BASELINE_M
    assert (
        f"of image_0, which stands 6 cm to the right: a point of 45 px of disparity lies {aside_px:.1f} px"
        in (named.notes()[0])
    )


def test_calibration_of_the_other_download_and_one_for_all(tmp_path: Path) -> None:
    split = write_2015(tmp_path / "data_scene_flow")
    other = tmp_path / "data_scene_flow_calib" / "training"
    other.mkdir(parents=True)
    (split / "calib_cam_to_cam").rename(other / "calib_cam_to_cam")
    assert open_drive(split)[1].camera.fx == focal_px("000001")
    for file in sorted((other / "calib_cam_to_cam").iterdir()):
        file.rename(split.parent / "calib_cam_to_cam.txt")  # the last one stays
    assert open_drive(split)[0].camera.fx == focal_px("000001")
    (split.parent / "calib_cam_to_cam.txt").unlink()
    with pytest.raises(DataError, match=r"calib_cam_to_cam/000000\.txt: no such file: download data_scene_flow_calib"):
        open_drive(split)


def test_bad_input_is_one_line(tmp_path: Path) -> None:
    split = write_2015(tmp_path)
    with pytest.raises(UsageError, match="no camera 'image_9': choose one of image_2, image_3"):
        open_drive(split, options=DriveOptions(camera="image_9"))
    with pytest.raises(DataError, match=r"image_0: no images NNNNNN_10\.png: choose another --camera"):
        open_drive(split, options=DriveOptions(camera="image_0"))
    with pytest.raises(UsageError, match=r"no drive 'testing' in it: found training"):
        open_drive(tmp_path, options=DriveOptions(drive="testing"))
    with pytest.raises(DataError, match=r"calib_cam_to_cam: --truth should hold disparity maps such as 000000_10\.png"):
        open_drive(split, options=DriveOptions(truth=split / "calib_cam_to_cam"))
    (split / "disp_occ_0" / "000001_10.png").unlink()
    (split / "image_3" / "000001_10.png").unlink()
    drive = open_drive(split)
    with pytest.raises(DataError, match=r"disp_occ_0: no map 000001_10\.png"):
        drive[1].truth()
    with pytest.raises(DataError, match=r"image_3: no image 000001_10: stereo needs both: download the pairs again"):
        drive[1].other()
    with pytest.raises(DataError, match="stereo benchmark has no sweeps"):
        drive[0].sweep()


@pytest.mark.parametrize("shared", [False, True])
def test_a_sweep_beside_a_pair_is_seen_where_the_truth_is(tmp_path: Path, shared: bool) -> None:
    split = write_2015(tmp_path, sweeps=True)
    before = open_drive(split).fingerprint()
    if shared:
        (split / "calib_velo_to_cam" / "000000.txt").rename(tmp_path / "calib_velo_to_cam.txt")
    drive = open_drive(split)
    frame = drive[0]
    seen_m, true_m = Lidar(sweeps=1, stereo=False, occlusion=False)(frame).depth_m, frame.truth().depth_m
    both = seen_m > 0
    assert both.mean() > 0.05
    np.testing.assert_allclose(seen_m[both], true_m[both], rtol=0.12)  # the truth's fractions count columns
    assert frame.sweep(1) is None
    (split / "velodyne" / "000001_10.bin").unlink()
    with pytest.raises(DataError, match=r"velodyne: no sweep 000001_10\.bin"):
        open_drive(split)[1].sweep()
    if not shared:
        (split / "calib_velo_to_cam" / "000000.txt").unlink()
        with pytest.raises(
            DataError, match=r"calib_velo_to_cam/000000\.txt: no such file, so the sweep cannot be placed"
        ):
            open_drive(split)[0].sweep()
        assert open_drive(split).fingerprint() != before


def test_the_audit_is_clean(tmp_path: Path) -> None:
    findings = check(open_drive(write_2015(tmp_path)))
    assert {finding.level for finding in findings} <= {"ok", "note"}


def test_cars_and_background_are_scored_as_loops_do(tmp_path: Path) -> None:
    drive = open_drive(write_2015(tmp_path))
    job = build.prepare(drive, Stereo(offset_px=(0.0,)), folder=tmp_path / "cache")
    report = job.run()
    assert not report.failed and len(report.built) == 2
    spoilt = report.prior.read("000000_10").depth_m.copy()
    spoilt[48:72, :40] *= 0.6  # half of the cars' pixels, as far as rows go
    codes = np.rint(spoilt * 256).astype(np.uint16)
    cv2.imwrite(str(report.prior.depth_path("000000_10")), codes)
    (report.prior.folder / "frames.jsonl").unlink()  # a map of another tool's: nothing says what was written
    result = score(report.prior, drive, preset("stereo2015")).result
    assert result.protocol.truth == "disp_occ_0"
    predictions: dict[str, list[float]] = {"bg": [], "fg": []}
    truths: dict[str, list[float]] = {"bg": [], "fg": []}
    for frame, index in zip(drive, SIZES, strict=True):
        made = cv2.imread(str(report.prior.depth_path(frame.id)), cv2.IMREAD_UNCHANGED) / np.float32(256)
        cars = cv2.imread(str(tmp_path / "training" / "obj_map" / f"{frame.id}.png"), cv2.IMREAD_UNCHANGED) > 0
        scale = focal_px(index) * BASELINE_M
        for name, side in (("bg", ~cars), ("fg", cars)):
            predictions[name] += (scale / made[side]).tolist()
            truths[name] += (scale / frame.truth().depth_m[side]).tolist()
    figures = result.metrics()
    for name in ("bg", "fg"):
        assert figures[f"d1_{name}"] == pytest.approx(slow.disparity_metrics(predictions[name], truths[name])["d1"])
    every = slow.disparity_metrics(*([*lists["bg"], *lists["fg"]] for lists in (predictions, truths)))
    assert figures["d1"] == pytest.approx(every["d1"]) and figures["d1_fg"] > figures["d1_bg"]
    assert type(result).load(report.prior.folder / "metrics.json").metrics() == figures


def test_the_commands_print_the_protocol_s_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    split, folder = write_2015(tmp_path), str(tmp_path / "cache")
    flags = ["--method", "stereo", "--stereo.offset-px", "0", "--cache", folder]
    assert PROGRAM.run(["build", str(split), *flags]) == 0
    capsys.readouterr()
    assert PROGRAM.run(["eval", folder, "--protocol", "stereo2015"]) == 0
    printed = capsys.readouterr().out
    assert "D1-bg %" in printed and "D1-fg %" in printed and "stereo2015: disp_occ_0 truth" in printed


def test_real_pairs(real_data: RealData, tmp_path: Path) -> None:
    """81 training pairs of 2015, without obj_map and disp_noc_0."""
    folder = real_data("kitti_stereo2015")
    drive = open_drive(folder)
    assert len(drive) == 81 and drive[0].camera.size == (375, 1242)
    assert drive[0].camera.fx * drive[0].baseline_m == pytest.approx(384.381, abs=0.02)
    assert {finding.level for finding in check(drive, samples=2)} <= {"ok", "note"}
    job = build.prepare(drive, Mono(), folder=tmp_path)
    assert not job.run(job.plan(Selection(frames="0:1"))).failed
