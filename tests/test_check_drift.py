"""The audit tells poses that leave flow over, and positions that travel elsewhere than velocities."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from conftest import RealData
from test_drives_dead_reckoning import RECORDED, write_drifting
from test_egomotion import off_course

from priors.check.audit import check
from priors.check.drift import judge_drift, left_over
from priors.check.sample import Sample
from priors.drives import open_drive


def samples(street: Path, degrees: float) -> list[Sample]:
    drive = open_drive(street)
    frames = off_course([drive[index] for index in range(6)], degrees)
    return [Sample(this, None, after) for this, after in pairwise(frames)]


@pytest.mark.parametrize(("degrees", "level"), [(0.0, "ok"), (8.0, "warning"), (-8.0, "warning")])
def test_poses_that_travel_aside_are_told(street: Path, degrees: float, level: str) -> None:
    found = list(judge_drift(open_drive(street), samples(street, degrees)))
    assert [finding.level for finding in found] == [level]
    assert ("refine them by `priors poses`" in found[0].message) == (level == "warning")


def test_no_judgement_without_poses_depth_or_images(street: Path) -> None:
    whole = samples(street, 0)[0]
    assert left_over(whole) is not None
    frame, after = whole.frame, whole.after
    assert after is not None
    bare = replace(frame, readers={"image": frame.readers["image"]})
    for lacking in (
        Sample(replace(frame, T_world_cam=None), None, after),
        Sample(frame, None, replace(after, T_world_cam=None)),
        Sample(frame, None, None),
        Sample(bare, None, after),
    ):
        assert left_over(lacking) is None
    assert not list(judge_drift(open_drive(street), [whole]))


def test_positions_beside_the_velocities_are_told(tmp_path: Path) -> None:
    """Positions go 20 cm/s to the left, velocities 30 cm/s to the right."""
    path = write_drifting(tmp_path, -0.3)
    wanted = {"note": open_drive(path), "warning": open_drive(path, options=RECORDED)}
    for level, drive in wanted.items():
        (found,) = judge_drift(drive, [])
        assert found.level == level and "positions travel at +" in found.message
    angles = open_drive(path).travel_deg()  # type: ignore[attr-defined]
    np.testing.assert_allclose(angles, np.degrees(np.arctan2([0.2, -0.3], [drive_speed(path)] * 2)), atol=0.02)


def drive_speed(path: Path) -> float:
    return float((path / "oxts" / "data" / "0000000004.txt").read_text().split()[8])


@pytest.mark.parametrize("left_m_s", [0.2, 0.0])
def test_nothing_is_told_where_they_agree_or_are_not_recorded(tmp_path: Path, left_m_s: float) -> None:
    found = list(judge_drift(open_drive(write_drifting(tmp_path, left_m_s)), []))
    assert [finding.level for finding in found] == (["ok"] if left_m_s else [])


@pytest.mark.slow
def test_real_drift_is_told(real_data: RealData) -> None:
    path = real_data("kitti_raw_train") / "2011_09_26" / "2011_09_26_drive_0009_sync"
    for options, count in ((RECORDED, 2), (None, 0)):
        told = [finding for finding in check(open_drive(path, options=options)) if finding.subject == "poses"]
        assert sum(finding.level == "warning" for finding in told) == count
