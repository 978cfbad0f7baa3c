"""The audit: what it says about sound drives, and that each fault planted in one is found."""

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import RealData
from factories import STEP_M, write_av_pose, write_oxts, write_raw

from priors import codecs
from priors.check import Finding, check
from priors.drives import DriveOptions, open_drive


def audit(path: Path, **options: str) -> list[Finding]:
    return check(open_drive(path, options=DriveOptions(**options)))


def told(findings: list[Finding], subject: str) -> list[tuple[str, str]]:
    return [(finding.level, finding.message) for finding in findings if finding.subject == subject]


def levels(findings: list[Finding]) -> set[str]:
    return {finding.level for finding in findings}


def test_a_sound_drive_has_no_warning(raw_drive: Path) -> None:
    findings = audit(raw_drive)
    assert levels(findings) == {"ok", "note"}  # the note: no truth, no sparse
    assert {f.subject for f in findings} == {"frames", "calibration", "files", "stereo", "poses", "times", "lidar"}
    assert all("\n" not in f.message for f in findings)


def test_a_sound_drive_from_the_right_eye(raw_drive: Path) -> None:
    assert levels(audit(raw_drive, camera="image_03")) == {"ok", "note"}


def test_swapped_images_are_fatal(raw_drive: Path) -> None:
    (raw_drive / "image_02" / "data").rename(raw_drive / "spare")
    (raw_drive / "image_03" / "data").rename(raw_drive / "image_02" / "data")
    (raw_drive / "spare").rename(raw_drive / "image_03" / "data")
    assert [level for level, text in told(audit(raw_drive), "stereo") if "swap left and right" in text] == ["fatal"]


@pytest.mark.parametrize("rows", [-4, 3])
def test_vertical_offset_is_measured(raw_drive: Path, rows: int) -> None:
    for path in (raw_drive / "image_03" / "data").iterdir():
        codecs.write_image(path, np.roll(codecs.read_image(path), rows, axis=0))
    ((level, text),) = told(audit(raw_drive), "stereo")
    assert level == "warning" and "rectify the pair anew" in text
    assert abs(float(text.split("vertical offset ")[1].split()[0]) - rows) < 0.15


def test_another_moments_right_images_are_noticed(raw_drive: Path) -> None:
    rng = np.random.default_rng(0)
    for path in (raw_drive / "image_03" / "data").iterdir():
        codecs.write_image(path, rng.integers(0, 255, codecs.read_image(path).shape, dtype=np.uint8))
    ((level, text),) = told(audit(raw_drive), "stereo")
    assert level == "warning" and "is it the same moment?" in text


def test_missing_scans_and_gaps_are_listed(tmp_path: Path) -> None:
    drive = write_raw(tmp_path, [0, 1, 2, 3, 6, 7, 8, 9])
    for number in (2, 3, 7):
        (drive / "velodyne_points" / "data" / f"{number:010d}.bin").unlink()
    (drive / "image_03" / "data" / "0000000001.png").unlink()
    frames = told(audit(drive), "frames")
    assert ("note", "1 gaps in the ids: 0000000003..0000000006") in frames
    assert ("warning", "3 frames have no sweep: 0000000002, 0000000003, 0000000007") in frames
    assert ("warning", "1 frames have no other: 0000000001") in frames
    assert [level for level, _ in told(audit(drive), "times")] == ["ok"]  # a gap in the ids is no pause


def test_a_damaged_pose_is_fatal_and_the_rest_is_audited(raw_drive: Path) -> None:
    (raw_drive / "oxts" / "data" / "0000000002.txt").write_text("nan " * 6)
    findings = audit(raw_drive)
    assert any(level == "fatal" and "0000000002.txt" in text for level, text in told(findings, "poses"))
    assert told(findings, "stereo")[0][0] == "ok" and told(findings, "lidar")[0][0] == "ok"


def test_a_pose_that_jumps_is_named(tmp_path: Path) -> None:
    drive = write_raw(tmp_path, range(12))
    write_oxts(drive / "oxts" / "data" / "0000000006.txt", 6 * STEP_M + 8)
    ((level, text),) = told(audit(drive), "poses")
    assert level == "warning" and "2 jumps, the largest: 0000000005 to 0000000006 moves 9.2 m" in text


def test_standing_still_is_noted(tmp_path: Path) -> None:
    drive = write_raw(tmp_path, range(8))
    for number in (5, 6, 7):
        write_oxts(drive / "oxts" / "data" / f"{number:010d}.txt", 4 * STEP_M)
    found = told(audit(drive), "poses")
    assert ("note", "the vehicle stands still in 3 of 7 steps: leave them out with --min-motion 0.1") in found


def test_world_to_camera_poses_are_noticed(image_folder: Path) -> None:
    path = image_folder / "poses.txt"
    assert [level for level, _ in told(audit(image_folder), "poses")] == ["ok"]
    path.write_text(path.read_text().replace(f" {STEP_M}", f" -{STEP_M}").replace(" 2.4", " -2.4"))
    assert any("moves backwards" in text for level, text in told(audit(image_folder), "poses") if level == "warning")


def test_a_pose_that_is_no_rigid_motion_is_fatal(image_folder: Path) -> None:
    path = image_folder / "poses.txt"
    path.write_text(path.read_text().replace("1 0 0", "2 0 0", 1))
    ((_, text),) = [found for found in told(audit(image_folder), "poses") if found[0] == "fatal"]
    assert text.startswith("1 are no rigid motions: a")


@pytest.mark.parametrize(("metres", "level"), [(0.0, "ok"), (1.5, "warning"), (4.0, "fatal")])
def test_a_lidar_that_is_off_is_told_by_stereo(raw_drive: Path, metres: float, level: str) -> None:
    path = raw_drive.parent / "calib_velo_to_cam.txt"
    lines = path.read_text().splitlines()
    moved = [*(float(word) for word in lines[1].split()[1:3]), float(lines[1].split()[3]) - metres]
    path.write_text(lines[0] + "\nT: " + " ".join(str(value) for value in moved) + "\n")
    found = told(audit(raw_drive), "lidar")[0]
    # The scene is 6 to 17 m away: 1.5 m too near is about a seventh of the depth, 4 m more than a third.
    assert found[0] == level
    assert ("calibration" in found[1]) == (level != "ok")


def test_a_lidar_that_looks_elsewhere_is_fatal(raw_drive: Path) -> None:
    path = raw_drive.parent / "calib_velo_to_cam.txt"
    path.write_text(path.read_text().replace("R:", "X:") + "R: 0 1 0 0 0 -1 -1 0 0\n")
    assert told(audit(raw_drive), "lidar")[0][0] == "fatal"


def test_damaged_files_are_fatal_and_named(raw_drive: Path) -> None:
    (raw_drive / "velodyne_points" / "data" / "0000000003.bin").write_bytes(b"123")
    (raw_drive / "image_02" / "data" / "0000000004.png").write_bytes(b"\x89PNG")
    files = told(audit(raw_drive), "files")
    assert any(level == "fatal" and "0000000003.bin" in text and "1 of 6" in text for level, text in files)
    assert any(level == "fatal" and "0000000004.png" in text for level, text in files)


def test_truth_of_another_size_is_told(raw_drive: Path, tmp_path: Path) -> None:
    inside = f"train/{raw_drive.name}/proj_depth/groundtruth/image_02/0000000002.png"
    codecs.write_depth_png(raw_drive.parents[1] / inside, np.full((375, 1242), 9.5, np.float32))
    notes = [text for level, text in told(audit(raw_drive), "files") if level == "note"]
    assert any("for another image size" in text for text in notes)
    codecs.write_depth_png(tmp_path / "given" / inside, np.full((375, 1242), 9.5, np.float32))
    fatal = [t for level, t in told(audit(raw_drive, truth=tmp_path / "given"), "files") if level == "fatal"]  # type: ignore[arg-type]
    assert len(fatal) == 1 and "is 1242x375, the calibration is for 240x96" in fatal[0]


def test_times_that_pause_or_run_back_are_told(raw_drive: Path) -> None:
    path = raw_drive / "image_02" / "timestamps.txt"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:5], lines[5].replace(":25.5", ":26.5")]) + "\n")
    assert told(audit(raw_drive), "times") == [("warning", "10.0 Hz, 1 pauses, up to 1.10 s")]
    path.write_text("\n".join(reversed(lines)) + "\n")
    ((level, text),) = told(audit(raw_drive), "times")
    assert level == "fatal" and "do not rise at frame 0000000001" in text


def test_odd_calibration_is_told(image_folder: Path) -> None:
    path = image_folder / "calib.json"
    calib = json.loads(path.read_text())
    path.write_text(json.dumps(calib | {"baseline_m": 540.0}))
    assert any(
        level == "warning" and "is it metres?" in text for level, text in told(audit(image_folder), "calibration")
    )
    path.write_text(json.dumps(calib | {"cx": 20.0}))
    assert any(
        level == "fatal" and "resized or cropped" in text for level, text in told(audit(image_folder), "calibration")
    )


def test_argoverse_log_is_audited(tracking_log: Path) -> None:
    findings = audit(tracking_log, camera="ring_front_center")
    assert "fatal" not in levels(findings)
    assert told(findings, "times") == [("ok", "5.0 Hz")]
    write_av_pose(tracking_log, 315970000000000000, float("inf"))
    assert "fatal" in levels(audit(tracking_log, camera="ring_front_center"))


@pytest.mark.parametrize(
    ("name", "drive"),
    [("kitti_raw", None), ("kitti_raw_397x120", None), ("kitti_raw_train", "2011_09_26_drive_0009_sync")],
)
def test_real_drives_are_sound(real_data: RealData, name: str, drive: str | None) -> None:
    findings = audit(real_data(name), drive=drive)
    assert levels(findings) <= {"ok", "note"}, findings


def test_real_odometry_is_sound(real_data: RealData) -> None:
    for sequence in ("01", "06"):
        findings = audit(real_data("kitti_odometry"), drive=sequence)
        assert levels(findings) == {"ok", "note"}
        assert any("data_odometry_velodyne.zip" in text for _, text in told(findings, "files"))
