"""Poses from velocities: the path's shape is theirs, its place that of the positions."""

from pathlib import Path

import numpy as np
import pytest
from conftest import RealData
from factories import STEP_M, write_oxts, write_raw
from hypothesis import given
from hypothesis import strategies as st

from cli.arguments import DriveArguments
from cli.nerf.sources import open_sources
from cli.priors import PROGRAM
from nerf.prepare import SceneConfig, open_scene
from priors import build
from priors.drives import DriveOptions, kitti_raw, open_drive, reopen
from priors.drives._dead_reckoning import TIE_S, dead_reckon, smooth
from priors.errors import DataError, UsageError
from priors.methods.lidar import Lidar
from priors.types import Matrix

COUNT = 30
RECORDED = DriveOptions(poses="recorded")


def smooth_densely(values: Matrix, gaps_s: Matrix, tie_s: float) -> Matrix:
    """The same minimum by its normal equations, written out: sum of shares (values - s)^2 + tie^2 (ds)^2 / gap."""
    count = len(values)
    A = np.zeros((count, count))
    b = np.zeros(count)
    for n, gap_s in enumerate(gaps_s):
        for end in (n, n + 1):
            A[end, end] += gap_s / 2
            b[end] += gap_s / 2 * values[end]
        step = np.zeros(count)
        step[n], step[n + 1] = -1, 1
        A += tie_s**2 / gap_s * np.outer(step, step)
    return np.linalg.solve(A, b)


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 25), tie_s=st.floats(0.01, 30))
def test_smoothing_is_the_least_squares_minimum(seed: int, count: int, tie_s: float) -> None:
    rng = np.random.default_rng(seed)
    values, gaps_s = rng.normal(size=count), rng.uniform(0.02, 0.5, count - 1)
    np.testing.assert_allclose(smooth(values, gaps_s, tie_s), smooth_densely(values, gaps_s, tie_s), atol=1e-8)


def drive_by(seed: int, count: int = 200) -> tuple[Matrix, Matrix, Matrix]:
    """True positions, velocities and times of a car whose velocity changes evenly: the integral is then exact."""
    rng = np.random.default_rng(seed)
    times_s = np.cumsum(rng.uniform(0.09, 0.11, count))
    start, change = rng.uniform(5, 15, 3), rng.uniform(-0.5, 0.5, 3)
    velocities = start + change * times_s[:, None]
    return start * times_s[:, None] + change * times_s[:, None] ** 2 / 2, velocities, times_s


@given(seed=st.integers(0, 2**32 - 1))
def test_positions_that_agree_stay(seed: int) -> None:
    positions_m, velocities, times_s = drive_by(seed)
    np.testing.assert_allclose(dead_reckon(positions_m, velocities, times_s), positions_m, atol=1e-6)


def test_a_drift_of_seconds_is_taken_out_and_a_place_stays() -> None:
    truth_m, velocities, times_s = drive_by(3)
    drift_m = 0.3 * np.sin(2 * np.pi * times_s / 5)[:, None] * [1, -1, 0]
    path_m = dead_reckon(truth_m + drift_m + [0, 0, 7.0], velocities, times_s)
    assert path_m is not None
    wrong_m = path_m - truth_m - [0, 0, 7.0]
    assert np.abs(wrong_m).max() < 0.05
    assert np.abs(np.diff(wrong_m, axis=0)).max() < 0.1 * np.abs(np.diff(drift_m, axis=0)).max()


def test_a_drift_of_minutes_is_followed() -> None:
    """Velocities that are 3 cm/s off would take the path 3 m away in 100 s."""
    truth_m, velocities, times_s = drive_by(4, 1000)
    path_m = dead_reckon(truth_m, velocities + 0.03, times_s)
    assert path_m is not None
    inside = (times_s > 3 * TIE_S[0]) & (times_s < times_s[-1] - 3 * TIE_S[0])
    assert np.abs(path_m - truth_m)[inside].max() < 0.03


def test_steps_without_velocity_are_those_of_the_positions() -> None:
    positions_m, velocities, times_s = drive_by(5, 40)
    velocities[10:20] = np.nan
    velocities[:, 2] = np.nan
    velocities[30] = 0  # it is known, and wrong
    path_m = dead_reckon(positions_m, velocities, times_s)
    assert path_m is not None
    np.testing.assert_allclose(path_m[:, 2], positions_m[:, 2], atol=1e-9)
    kept = np.diff(path_m, axis=0) - np.diff(positions_m, axis=0)
    assert np.abs(kept[10:19]).max() < 0.05 < np.abs(kept[29:31]).max()


def test_a_pause_is_not_sailed_over() -> None:
    positions_m, velocities, times_s = drive_by(6, 40)
    times_s[20:] += 5
    path_m = dead_reckon(positions_m, velocities, times_s)
    assert path_m is not None
    np.testing.assert_allclose(path_m, positions_m, atol=1e-6)


@pytest.mark.parametrize("spoil", ["kilometres an hour", "backwards", "times", "nothing known", "one record"])
def test_velocities_of_something_else_are_not_taken(spoil: str) -> None:
    positions_m, velocities, times_s = drive_by(7, 40)
    if spoil == "times":
        times_s[5] = times_s[4]
    elif spoil == "one record":
        positions_m, velocities, times_s = positions_m[:1], velocities[:1], times_s[:1]
    else:
        velocities *= {"kilometres an hour": 3.6, "backwards": -1, "nothing known": np.nan}[spoil]
    assert dead_reckon(positions_m, velocities, times_s) is None


def write_drifting(root: Path, left_m_s: float = 0.05, number_of_records: int = COUNT) -> Path:
    """A drive east whose positions drift 20 cm/s to the north, which its velocities do not."""
    drive = write_raw(root, range(3))
    records = drive / "oxts"
    for number in range(number_of_records):
        write_oxts(records / "data" / f"{number:010d}.txt", number * STEP_M, 49.0 + np.degrees(0.02 * number / 6378137))
        path = records / "data" / f"{number:010d}.txt"
        words = path.read_text().split()
        words[8:11] = [f"{STEP_M / 0.1}", f"{left_m_s}", "0"]
        path.write_text(" ".join(words) + "\n")
    stamps = [f"2011-09-26 13:02:{25 + 0.1 * n:012.9f}\n" for n in range(number_of_records)]
    (records / "timestamps.txt").write_text("".join(stamps))
    return drive


def north_m_s(drive: kitti_raw.KittiRaw) -> float:
    """How fast the drive goes north, 0.1 s between records."""
    poses = [drive._track.T_world_imu(f"{number:010d}") for number in range(COUNT)]
    return float(np.median(np.diff([pose[1, 3] for pose in poses if pose is not None])) / 0.1)


def test_a_drive_is_dead_reckoned_where_it_records_velocities(tmp_path: Path) -> None:
    path = write_drifting(tmp_path)
    drive, recorded = open_drive(path), open_drive(path, options=RECORDED)
    assert isinstance(drive, kitti_raw.KittiRaw) and isinstance(recorded, kitti_raw.KittiRaw)
    assert north_m_s(recorded) == pytest.approx(0.2, abs=0.001)
    assert north_m_s(drive) == pytest.approx(0.05, abs=0.005)
    assert drive.fingerprint() != recorded.fingerprint()
    assert drive.describe() == {**recorded.describe(), "poses": "dead-reckoned"}
    for one in (drive, recorded):  # what a manifest says opens the same drive again
        assert reopen(one.describe()).fingerprint() == one.fingerprint()


def test_poses_are_as_before_where_velocities_are_not_recorded(tmp_path: Path) -> None:
    path = write_drifting(tmp_path, left_m_s=0)
    drive, recorded = open_drive(path), open_drive(path, options=RECORDED)
    assert drive.describe() == recorded.describe() and "poses" not in drive.describe()
    assert drive.fingerprint() == recorded.fingerprint()
    np.testing.assert_array_equal(drive[2].pose(), recorded[2].pose())
    with pytest.raises(UsageError, match=r"--poses dead-reckoned: .* has no velocities that fit its positions"):
        open_drive(path, options=DriveOptions(poses="dead-reckoned"))


def test_poses_are_as_before_without_time_stamps(tmp_path: Path) -> None:
    path = write_drifting(tmp_path)
    (path / "oxts" / "timestamps.txt").unlink()
    assert "poses" not in open_drive(path).describe()


def test_a_damaged_record_spoils_its_own_frame_only(tmp_path: Path) -> None:
    path = write_drifting(tmp_path)
    (path / "oxts" / "data" / "0000000001.txt").write_text("nan " * 30)
    drive = open_drive(path)
    assert drive.describe()["poses"] == "dead-reckoned"
    with pytest.raises(DataError, match=r"0000000001\.txt"):
        drive[1].pose()
    assert drive[2].pose().shape == (4, 4)


def test_a_record_of_few_columns_has_no_velocity_and_a_pose(tmp_path: Path) -> None:
    path = write_drifting(tmp_path)
    file = path / "oxts" / "data" / "0000000001.txt"
    file.write_text(" ".join(file.read_text().split()[:6]))
    drive = open_drive(path)
    assert drive[1].pose().shape == (4, 4)
    assert isinstance(drive, kitti_raw.KittiRaw)
    assert north_m_s(drive) == pytest.approx(0.05, abs=0.005)


def test_other_data_sets_have_no_velocities(image_folder: Path) -> None:
    with pytest.raises(UsageError, match="--poses dead-reckoned"):
        open_drive(image_folder, options=DriveOptions(poses="dead-reckoned"))
    with pytest.raises(UsageError, match="--poses guessed: expected one of auto, recorded"):
        DriveOptions(poses="guessed")  # type: ignore[arg-type]


def test_the_real_test_drive_keeps_its_poses(real_data: RealData) -> None:
    """Its records have the velocity forward and no other."""
    path = real_data("kitti_raw") / "2011_09_26" / "2011_09_26_drive_0001_sync"
    drive, recorded = open_drive(path), open_drive(path, options=RECORDED)
    assert drive.fingerprint() == recorded.fingerprint()
    np.testing.assert_array_equal(drive[7].pose(), recorded[7].pose())


def test_real_travel_is_along_the_velocity(real_data: RealData) -> None:
    """Drive 0009: positions travel at -1.01 degrees to the yaw, velocities at +0.48 as on drive 0001."""
    path = real_data("kitti_raw_train") / "2011_09_26" / "2011_09_26_drive_0009_sync"
    degrees = []
    for options in (RECORDED, DriveOptions()):
        track = open_drive(path, options=options)._track  # type: ignore[attr-defined]
        steps_m = np.diff([track.pose(id_)[:2, 3] for id_ in track.files], axis=0)
        yaw = np.array([track.record(id_).yaw for id_ in track.files])
        degrees.append(np.degrees(np.median(np.arctan2(steps_m[:, 1], steps_m[:, 0]) - (yaw[1:] + yaw[:-1]) / 2)))
    np.testing.assert_allclose(degrees, [-1.01, 0.48], atol=0.06)


def test_maps_of_other_poses_are_not_mixed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_drifting(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = build.prepare(open_drive(path, options=RECORDED), Lidar(sweeps=1)).run().prior
    after = build.prepare(open_drive(path), Lidar(sweeps=1))
    assert after.prior.folder != before.folder
    with pytest.raises(DataError, match="made with recorded poses, these are dead-reckoned: --poses recorded, or"):
        open_scene(open_drive(path), before, SceneConfig(), tmp_path / "scenes")
    with pytest.raises(UsageError, match="--poses dead-reckoned: the priors were made with recorded poses"):
        open_sources(DriveArguments(part=DriveOptions(poses="dead-reckoned")), before.folder, [])
    assert PROGRAM.run(["build", str(path), "--method", "lidar", "--lidar.sweeps", "1", "--dry-run"]) == 0
    told = " ".join(capsys.readouterr().err.split())
    assert f"{before.folder}: made with recorded poses, these are dead-reckoned: --poses recorded goes on" in told
    again = build.prepare(open_drive(path, options=RECORDED), Lidar(sweeps=1))
    assert again.prior.folder == before.folder and not again.plan().todo
