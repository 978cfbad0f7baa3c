"""Steady frame times from stamps that tick."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from priors.drives import _oxts, kitti_raw


@given(seed=st.integers(0, 2**32 - 1), period_s=st.floats(0.08, 0.12), lost=st.sets(st.integers(1, 38), max_size=5))
def test_late_is_never_worse_than_rounding(seed, period_s, lost):
    """Stamps are the nearest ticks of 10 ms: at most 5 ms off, and so is the line through them."""
    error, _ = errors_s(seed, period_s, lost)
    assert np.abs(error).max() < 0.006  # a line through a lopsided window may add a little


@pytest.mark.parametrize("period_s", [0.0837, 0.0963, 0.1037, 0.1171])
def test_late_is_what_rounding_took(period_s):
    """Periods that are no multiple of the tick round evenly: most of it is found."""
    error, rounding = errors_s(1, period_s, set())
    assert np.std(rounding) > 0.0025 and np.std(error) < 0.3 * np.std(rounding)


def errors_s(seed, period_s, lost):
    """How far off the frames' own times are: what late_s finds, and the stamps; frames far from the ends."""
    start = np.random.default_rng(seed).uniform(0, 0.01)
    frames_s = {number: start + period_s * number for number in range(40) if number not in lost}
    stamps_s = {number: round(time, 2) for number, time in frames_s.items()}
    late = _oxts.late_s(stamps_s)
    assert set(late) == set(stamps_s)
    inner = [number for number in range(10, 30) if number in late]
    found = [stamps_s[number] + late[number] - frames_s[number] for number in inner]
    return np.array(found), np.array([stamps_s[number] - frames_s[number] for number in inner])


def test_exact_stamps_are_left_alone():
    late = _oxts.late_s({number: 0.1 * number for number in range(30)})
    np.testing.assert_allclose(list(late.values()), 0, atol=1e-12)


@pytest.mark.parametrize("stamps", [{}, {0: 0.0, 1: 0.1}, dict.fromkeys(range(20), 1.0)])
def test_nothing_is_known_from_too_few_or_standing_stamps(stamps):
    assert _oxts.late_s(stamps) == {}


def test_stamps_around_a_jump_are_not_used():
    late = _oxts.late_s({number: 0.1 * number + (number >= 30) for number in range(60)})
    assert set(late) == {*range(20), *range(40, 60)}


def test_between_two_poses():
    a, b = np.eye(4), np.eye(4)
    b[:3, :3], b[:3, 3] = Rotation.from_rotvec([0, 0, 0.2]).as_matrix(), [2, 0, 4]
    np.testing.assert_allclose(_oxts.between(a, b, 0), a, atol=1e-12)
    np.testing.assert_allclose(_oxts.between(a, b, 1), b, atol=1e-12)
    half = _oxts.between(a, b, 0.5)
    np.testing.assert_allclose(half[:3, 3], [1, 0, 2])
    np.testing.assert_allclose(Rotation.from_matrix(half[:3, :3]).as_rotvec(), [0, 0, 0.1], atol=1e-12)


def test_real_car_drives_smoothly(real_data):
    """At 13 m/s a record 5 ms off is 7 cm: the steps between frames jump by that, unless it is taken out."""
    drive = kitti_raw.KittiRaw(real_data("kitti_raw") / "2011_09_26" / "2011_09_26_drive_0001_sync")
    position_m = np.array([drive._T_world_velo(f"{number:010d}")[:3, 3] for number in range(60)])
    record_m = np.array([drive._track.record(f"{number:010d}").T_mercator_imu[:3, 3] for number in range(60)])
    jump, record_jump = (np.abs(np.diff(np.linalg.norm(np.diff(p, axis=0), axis=1))) for p in (position_m, record_m))
    assert np.median(record_jump) > 0.05
    assert jump.max() < 0.03
