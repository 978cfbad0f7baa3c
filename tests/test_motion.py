"""Where a path breaks, against a slow version; and that what joins frames by their poses stays on one side of it."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from factories import STEP_M, write_argoverse_tracking, write_av_pose, write_odometry, write_oxts, write_raw
from hypothesis import given, settings
from hypothesis import strategies as st

from priors.adapt.posed_views import pair_up
from priors.drives import open_drive
from priors.methods.lidar import Lidar
from priors.motion import Trajectory, trajectory
from priors.selection import range_of, select
from priors.types import Camera, Frame


def straight(places_m: list[float], turns_deg: list[float] | None = None) -> dict[int, np.ndarray]:
    """Poses along z, turned about y, by number."""
    poses = {}
    for number, place_m in enumerate(places_m):
        angle = np.radians(turns_deg[number]) if turns_deg else 0.0
        T = np.eye(4)
        T[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        T[2, 3] = place_m
        poses[number] = T
    return poses


def slow_breaks(places_m: list[float], gaps_s: list[float]) -> list[bool]:
    """The rule, step by step."""
    steps = [abs(b - a) for a, b in pairwise(places_m)]
    speeds = [step / gap for step, gap in zip(steps, gaps_s, strict=True)]
    found = []
    for n, speed in enumerate(speeds):
        around = float(np.median([speeds[k] for k in range(len(speeds)) if abs(k - n) <= 5]))
        jump = speed > 3 * around and steps[n] > around * gaps_s[n] + max(0.5, 10 * gaps_s[n] ** 2)
        found.append(jump or (speed > 70 and float(np.median(speeds)) <= 70))
    return found


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(-12, 12), st.integers(1, 4)), min_size=1, max_size=25))
def test_breaks_are_those_of_the_slow_rule(steps: list[tuple[float, int]]) -> None:
    places = np.cumsum([0.0, *(step for step, _ in steps)]).tolist()
    times = np.cumsum([0.0, *(0.1 * gap for _, gap in steps)]).tolist()
    path = Trajectory.of_numbers(straight(places), dict(enumerate(times)))
    assert path.breaks.tolist() == slow_breaks(places, np.diff(times).tolist())


def test_parts_and_the_longest() -> None:
    places = [1.0 * n for n in range(4)] + [50.0 + n for n in range(9)] + [200.0 + n for n in range(5)]
    path = Trajectory.of_numbers(straight(places), {})
    assert path.parts == [(0, 4), (4, 13), (13, 18)]
    assert path.longest(path.names) == (4, 13)
    assert path.longest(path.names[:6]) == (0, 4)  # of what was chosen
    assert path.broken("3", "4") and path.broken("4", "3") and not path.broken("4", "12")
    assert not path.broken("4", "99")  # nothing is known of it


def test_a_turn_that_no_car_makes_is_a_break() -> None:
    turns = [3.0 * n for n in range(6)] + [60.0 + 3 * n for n in range(6)]
    path = Trajectory.of_numbers(straight([1.0 * n for n in range(12)], turns), {})
    assert np.flatnonzero(path.breaks).tolist() == [5]


@pytest.mark.parametrize("times", [True, False])
def test_frames_left_out_are_no_break(times: bool) -> None:
    numbers = [0, 1, 2, 3, 30, 31, 32, 33, 60, 61]
    poses = {number: straight([1.0 * number])[0] for number in numbers}
    path = Trajectory.of_numbers(poses, {number: 0.1 * number for number in numbers} if times else {})
    assert not path.breaks.any()


@pytest.mark.parametrize("gap_s", [0.1, 0.5, 1.0])
def test_a_car_that_starts_or_stops_is_no_break(gap_s: float) -> None:
    times_s = gap_s * np.arange(24)
    started_s = np.maximum(0, times_s - times_s[-5])
    places = (2.0 * started_s**2).tolist()  # 4 m/s2 after a long stop
    for path in (places, [places[-1] - place for place in reversed(places)]):
        assert not Trajectory.of_numbers(straight(path), dict(enumerate(times_s.tolist()))).breaks.any()


def test_another_unit_is_no_break() -> None:
    """Poses in centimetres are all too fast: the audit says so, and no step stands out."""
    assert not Trajectory.of_numbers(straight([120.0 * n for n in range(12)]), {}).breaks.any()


def test_ranges_are_those_of_the_selection() -> None:
    for ids in (
        ["000004", "000005", "000009", "000010"],
        ["a", "b", "c", "d"],
        ["315970000000000000", "315970000100000000"],
    ):
        text = range_of(ids, 1, len(ids))
        assert select(ids, text) == list(range(1, len(ids)))


def break_raw(root: Path, count: int, at: int) -> Path:
    """A KITTI raw drive whose poses jump 8 m from a number on."""
    drive = write_raw(root, range(count))
    for number in range(at, count):
        write_oxts(drive / "oxts" / "data" / f"{number:010d}.txt", number * STEP_M + 8)
    return drive


def test_lidar_accumulates_on_its_own_side_raw(tmp_path: Path) -> None:
    broken, cut = break_raw(tmp_path / "broken", 12, 7), write_raw(tmp_path / "cut", range(7))
    method = Lidar(sweeps=9, stereo=False)
    for index in (3, 6):
        np.testing.assert_array_equal(method(open_drive(broken)[index]).depth_m, method(open_drive(cut)[index]).depth_m)
    whole = write_raw(tmp_path / "whole", range(12))
    assert (method(open_drive(whole)[6]).depth_m > 0).sum() > (method(open_drive(cut)[6]).depth_m > 0).sum()


def test_a_pose_between_two_breaks_stands_alone_and_is_untwisted_by_its_neighbours_speed(tmp_path: Path) -> None:
    drive = write_raw(tmp_path, range(12))
    write_oxts(drive / "oxts" / "data" / "0000000006.txt", 6 * STEP_M + 8)
    frame = open_drive(drive)[6]
    own, before = frame.sweep(), frame.sweep(-1)
    assert own is not None and before is not None and own.velocity is not None
    assert before.T_world_lidar is None and own.T_world_lidar is not None
    assert own.velocity[0] == pytest.approx(10 * STEP_M, rel=1e-3)


def test_records_beside_a_break_are_not_mixed(tmp_path: Path) -> None:
    """The pose of a frame lies between two records of the IMU, but not between those of two sides of a break."""
    drive = break_raw(tmp_path, 14, 7)
    lines = [f"2011-09-26 13:02:{25 + 0.1 * n + (0.004 if n % 2 else 0):012.9f}\n" for n in range(14)]
    (drive / "oxts" / "timestamps.txt").write_text("".join(lines))
    places_m = np.array([open_drive(drive)[n].T_world_cam for n in range(14)])[:, 0, 3]
    steps_m = np.diff(places_m - places_m[0])
    assert abs(steps_m[6] - STEP_M - 8) < 0.1  # the whole of the jump in one step, none of it in those beside
    assert np.abs(np.delete(steps_m, 6) - STEP_M).max() < 0.1


def test_a_jump_of_recorded_positions_is_not_dead_reckoned_away(tmp_path: Path) -> None:
    """Velocities go on evenly over the jump: the path breaks there all the same, and each side is right by itself."""
    drive = break_raw(tmp_path, 20, 9)
    for path in (drive / "oxts" / "data").iterdir():
        words = path.read_text().split()
        words[8:11] = [f"{STEP_M / 0.1}", "0.05", "0"]
        path.write_text(" ".join(words) + "\n")
    stamps = [f"2011-09-26 13:02:{25 + 0.1 * n:012.9f}\n" for n in range(20)]
    (drive / "oxts" / "timestamps.txt").write_text("".join(stamps))
    opened = open_drive(drive)
    assert opened.describe()["poses"] == "dead-reckoned"
    steps_m = trajectory(opened).steps_m
    assert steps_m[8] == pytest.approx(8 + STEP_M, abs=0.05)
    np.testing.assert_allclose(np.delete(steps_m, 8), STEP_M, atol=0.01)


def test_lidar_accumulates_on_its_own_side_odometry(tmp_path: Path) -> None:
    root = write_odometry(tmp_path / "odometry", count=12)
    lines = [f"1 0 0 0 0 1 0 0 0 0 1 {STEP_M * n + (8 if n >= 7 else 0):.9f}\n" for n in range(12)]
    (root / "poses" / "06.txt").write_text("".join(lines))
    frame = open_drive(root)[6]
    placed = [offset for offset in range(-3, 4) if (sweep := frame.sweep(offset)) and sweep.T_world_lidar is not None]
    assert placed == [-3, -2, -1, 0]


def test_lidar_accumulates_on_its_own_side_argoverse(tmp_path: Path) -> None:
    log = write_argoverse_tracking(tmp_path / "log-a", count=8)
    times = sorted(int(path.stem[3:]) for path in (log / "lidar").iterdir())
    assert len(times) >= 12
    for number, time in enumerate(times):
        write_av_pose(log, time, 1.0 * number + (20.0 if number >= 8 else 0.0))
    drive = open_drive(log)
    frame = drive[int(np.searchsorted([int(id_) for id_ in drive.ids], times[7])) - 1]
    own = [n for n in range(-12, 13) if (sweep := frame.sweep(n)) is not None and sweep.T_world_lidar is not None]
    far = [n for n in range(-12, 13) if (sweep := frame.sweep(n)) is not None and sweep.T_world_lidar is None]
    assert own and far and max(own) < min(far) and len(own) == 8


def test_lidar_far_from_the_origin_is_the_same(tmp_path: Path) -> None:
    maps = []
    for name, origin_m in (("near", np.zeros(3)), ("far", np.array([455000.3, 5428000.7, 110.0]))):
        root = write_odometry(tmp_path / name, count=7)
        lines = []
        for n in range(7):
            T = np.eye(4)
            T[:3, 3] = origin_m + np.array([0, 0, STEP_M * n])
            lines.append(" ".join(f"{value:.9f}" for value in T[:3].ravel()) + "\n")
        (root / "poses" / "06.txt").write_text("".join(lines))
        maps.append(Lidar(sweeps=5)(open_drive(root)[3]).depth_m)
    np.testing.assert_allclose(maps[0], maps[1], rtol=0, atol=1e-5)


class Line:
    """A drive along z, 1 m a frame, whose poses jump between frames 9 and 10 by so little that no neighbour is far."""

    name = "line"

    def __init__(self, jump_m: float) -> None:
        self.jump_m = jump_m
        self.ids = [f"{number:06d}" for number in range(20)]

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, index: int) -> Frame:
        T = np.eye(4)
        T[2, 3] = 0.4 * index + (self.jump_m if index >= 10 else 0)
        return Frame(self.ids[index], Camera(np.eye(3), (2, 2)), {}, T_world_cam=T)


def test_video_compares_frames_of_one_side() -> None:
    """1.4 m is a neighbour's usual distance, and no place of the same path."""
    whole, broken = (pair_up(Line(jump_m), range(20), 20) for jump_m in (0.0, 1.4))  # type: ignore[arg-type]
    assert any(index < 10 <= max(near) for index, near in whole.items())
    assert not any((index < 10) != (other < 10) for index, near in broken.items() for other in near)
    assert set(broken) == set(range(20))


def test_a_drive_whose_frames_cannot_all_be_opened_has_a_trajectory(tmp_path: Path) -> None:
    drive = write_raw(tmp_path, range(6))
    (drive / "oxts" / "data" / "0000000002.txt").write_text("nan " * 6)
    path = trajectory(open_drive(drive))
    assert "0000000002" not in path.names and len(path.names) == 5
    assert not path.breaks.any()
