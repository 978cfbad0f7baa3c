"""What completion's training shows of a scene: lines, random points, one to eleven sweeps."""

from dataclasses import replace

import numpy as np
import pytest
from test_learn_completion import scene
from test_mffnet import F

from priors.learn.accumulated_lidar import INPUTS
from priors.learn.lidar_dropout import Density, drop_points
from priors.learn.lidar_scene import crop
from priors.learn.scan_lines import ELEVATIONS_RAD, beam_of, met
from priors.types import Camera

pytestmark = pytest.mark.networks


def test_official_truth_is_not_added_to() -> None:
    official = replace(scene(real=True), source="kitti2015")
    official.truth_m[:, 300:] = 0
    shown = drop_points(official, np.random.default_rng(0), Density(every=2))
    np.testing.assert_array_equal(shown.truth_m, official.truth_m)


@pytest.mark.parametrize("number", [30, 500])
def test_random_points(number: int) -> None:
    shown = drop_points(scene(), np.random.default_rng(0), Density(points=number))
    assert 0.5 * number < (shown.sparse_m > 0).sum() < 2 * number


@pytest.mark.parametrize("sweeps", [3, 11])
def test_more_sweeps_of_a_street_are_denser_and_right(sweeps: int) -> None:
    one = drop_points(scene(), np.random.default_rng(0), Density())
    shown = drop_points(scene(), np.random.default_rng(0), Density(sweeps=sweeps))
    seen = shown.sparse_m > 0
    assert seen.sum() > (1 + 0.2 * sweeps) * (one.sparse_m > 0).sum()
    off = np.abs(shown.sparse_m / scene().truth_m - 1)[seen]
    assert np.median(off) < 0.02 and 0 < np.mean(off > 0.1) < 0.05  # they are as far off as other sweeps are
    assert shown.T_cam_lidar is None and one.T_cam_lidar is not None


def test_a_real_drives_sweeps_are_shown_without_the_truth() -> None:
    """The truth is pieces of the frame's own lines; the map that is shown has no value there."""
    real = replace(scene(real=True), accumulated_m={sweeps: scene().truth_m + sweeps for sweeps in INPUTS})
    shown = drop_points(real, np.random.default_rng(0), Density(sweeps=11))
    known = shown.weight > 0
    assert 100 < known.sum() < 0.5 * len(real.points_m) and not (known & (shown.sparse_m > 0)).any()
    np.testing.assert_allclose(shown.truth_m[known], scene().truth_m[known], rtol=1e-5)
    np.testing.assert_array_equal(shown.sparse_m[~known], (scene().truth_m + 11)[~known])


def test_what_is_drawn_covers_all_densities() -> None:
    part = crop(scene(), 150, 100, (96, 192))
    lone = replace(part, real=True)
    rng = np.random.default_rng(0)
    for one in (part, replace(lone, accumulated_m=dict.fromkeys(INPUTS, part.truth_m))):
        counts = [int((drop_points(one, rng).sparse_m > 0).sum()) for _ in range(40)]
        assert min(counts) < len(one.points_m) / 4 and max(counts) > 2 * len(one.points_m)
    counts = [int((drop_points(lone, rng).sparse_m > 0).sum()) for _ in range(40)]
    assert max(counts) <= len(lone.points_m), "it has one sweep only"


def test_scan_lines_that_a_view_meets() -> None:
    """On a wall straight ahead, lines are as far apart as their elevations; nothing is met where nothing is."""
    camera = Camera(np.array([[720.0, 0, 200], [0, 720, 60], [0, 0, 1]]), (120, 400))
    wall_m = np.full((120, 400), 10, F)
    wall_m[:, :100] = 0
    T = np.array([[0, -1.0, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    rows = np.flatnonzero(met(wall_m, camera, T, 0.3)[:, 195:206].any(axis=1))
    inside = ELEVATIONS_RAD[np.abs(ELEVATIONS_RAD) < np.arctan(59 / 720)]
    off = np.abs(rows[:, None] - (60 - 720 * np.tan(inside)))
    assert off.min(axis=1).max() < 1 and off.min(axis=0).max() < 1
    assert not met(wall_m, camera, T, 0.3)[:, :100].any()


def test_beams_are_numbered_from_the_highest() -> None:
    xyz = np.stack([10 * np.cos(ELEVATIONS_RAD), np.zeros(64), 10 * np.sin(ELEVATIONS_RAD)], axis=1)
    assert np.array_equal(beam_of(xyz), np.arange(64))
