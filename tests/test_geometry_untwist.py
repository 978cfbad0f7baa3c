"""Untwisting: equal to a matrix exponential a point, and to what KITTI's own tools do."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import lidar as reference

from priors.drives import open_drive
from priors.geometry import project, scatter_nearest, transform, untwist
from priors.types import Sweep

DRIVE = Path(__file__).resolve().parents[2] / "shared/data/kitti_raw/2011_09_26/2011_09_26_drive_0001_sync"


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), speed=st.sampled_from([0.0, 1e-3, 15.0]), turn=st.sampled_from([0, 1e-6, 1, 30]))
def test_untwist_equals_a_matrix_exponential_per_point(seed, speed, turn):
    rng = np.random.default_rng(seed)
    xyz_m = rng.uniform(-80, 80, (20, 3)).astype(np.float32)
    time_s = rng.uniform(-0.05, 0.05, 20).astype(np.float32)
    velocity = np.concatenate([rng.normal(size=3) * speed, rng.normal(size=3) * turn])
    moved = untwist(Sweep(xyz_m, np.eye(4), time_s, velocity))
    assert moved.dtype == np.float32
    np.testing.assert_allclose(moved, reference.untwist(xyz_m, time_s, velocity), atol=2e-5)


def test_untwist_moves_left_and_right_apart():
    # Driving forward at 10 m/s: a point measured 50 ms early was measured from half a metre behind.
    xyz_m = np.array([[10, 0, 0], [10, 0, 0]], dtype=np.float32)
    velocity = np.array([10.0, 0, 0, 0, 0, 0])
    moved = untwist(Sweep(xyz_m, None, np.array([-0.05, 0.05], dtype=np.float32), velocity))
    np.testing.assert_allclose(moved[:, 0], [9.5, 10.5], atol=1e-6)


@pytest.mark.parametrize("lacking", ["time", "velocity"])
def test_untwist_leaves_what_it_cannot_know(lacking):
    xyz_m = np.ones((3, 3), dtype=np.float32)
    time_s = None if lacking == "time" else np.ones(3, dtype=np.float32)
    velocity = None if lacking == "velocity" else np.ones(6)
    assert untwist(Sweep(xyz_m, None, time_s, velocity)) is xyz_m


def test_untwist_of_an_empty_sweep_is_empty():
    moved = untwist(Sweep(np.zeros((0, 3), np.float32), None, np.zeros(0, np.float32), np.ones(6)))
    assert moved.shape == (0, 3)


@pytest.mark.skipif(not DRIVE.exists(), reason=f"no KITTI drive 0001 at {DRIVE}")
@pytest.mark.parametrize("index", [0, 5, 11])
def test_one_sweep_repeats_the_official_velodyne_raw(index):
    """Sign of the rotation, the poses, the calibration and the pixel centres, all in one comparison."""
    frame = open_drive(DRIVE)[index]
    same, common = _agreement(frame, untwist(frame.sweep()))
    assert same > 0.9995
    assert common > 0.9
    same, common = _agreement(frame, frame.sweep().xyz_m)
    assert common < 0.5  # without untwisting, it is another map


def _agreement(frame, xyz_m):
    """Share of the common pixels within 2 cm, and share of the official pixels that are common."""
    official_m = frame.sparse().depth_m
    uv_px, depth_m = project(frame.camera, transform(frame.T_cam_lidar, xyz_m))
    ours_m = scatter_nearest(uv_px, depth_m, frame.camera.size)
    both = (ours_m > 0) & (official_m > 0)
    return np.mean(np.abs(ours_m - official_m)[both] < 0.02), both.sum() / (official_m > 0).sum()
