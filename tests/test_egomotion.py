"""Ego motion: what corners show is the true motion, and a drive's poses are corrected by it without drifting."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from conftest import RealData
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from priors.codecs import as_grey
from priors.drives import DriveOptions, open_drive
from priors.egomotion.corners import Corners
from priors.egomotion.graph import DOUBT, Edge, misfit, solve
from priors.egomotion.motion import exp, see
from priors.egomotion.refine import refine
from priors.egomotion.residual import residual
from priors.egomotion.sight import Sight, halve_camera, open_eyes, shrink
from priors.errors import DataError
from priors.geometry import invert, project
from priors.pairs.matching import halve
from priors.pairs.rectification import RectificationError
from priors.types import Camera, Frame, Matrix

CAMERA = Camera(np.array([[360.0, 0, 310], [0, 360, 90], [0, 0, 1]]), (187, 621))
some_seed = st.integers(0, 2**32 - 1)


def seen_points(seed: int, T_other_this: Matrix, noise_px: float, count: int = 300) -> Corners:
    """Points all over the image, and where a motion puts them, off by noise."""
    rng = np.random.default_rng(seed)
    start_px = rng.uniform([0, 0], [620, 186], (count, 2))
    z = 1 / rng.uniform(1 / 60, 1 / 5, count)
    xyz_m = np.column_stack([(start_px - CAMERA.K[:2, 2]) / CAMERA.fx, np.ones(count)]) * z[:, None]
    end_px, _ = project(CAMERA, xyz_m @ T_other_this[:3, :3].T + T_other_this[:3, 3])
    return Corners(xyz_m, start_px, end_px + rng.normal(0, noise_px, (count, 2)), CAMERA, 200.0)


def some_motion(seed: int) -> Matrix:
    rng = np.random.default_rng(seed)
    return exp(np.array([0, 0, -1, 0, 0, 0]) + rng.uniform(-1, 1, 6) * [0.2, 0.2, 0.2, 0.03, 0.03, 0.03])


@settings(deadline=None, max_examples=20)
@given(some_seed)
def test_a_motion_is_found_among_things_that_move(seed: int) -> None:
    T_other_this = some_motion(seed)
    corners = seen_points(seed, T_other_this, 0.1)
    corners.end_px[:90] += [8, 1]  # a car
    motion = see(corners)
    assert motion is not None
    off = invert(T_other_this) @ invert(motion.T_this_other)
    assert np.linalg.norm(off[:3, 3]) < 0.02 and np.abs(off[:3, :3] - np.eye(3)).max() < 1e-3
    deviations = np.sqrt(np.diag(motion.covariance))
    assert np.abs(np.concatenate([(T_other_this @ motion.T_this_other)[:3, 3]]) / deviations[:3]).max() < 5


def test_the_way_is_less_sure_along_than_across() -> None:
    motion = see(seen_points(1, some_motion(1), 0.1))
    assert motion is not None
    way = motion.T_this_other[:3, :3].T @ motion.T_this_other[:3, 3]
    along = way / np.linalg.norm(way)
    spread_m = np.sqrt(np.linalg.eigvalsh(motion.covariance[:3, :3]))
    assert np.sqrt(along @ motion.covariance[:3, :3] @ along) > 0.9 * spread_m[-1] > 2 * spread_m[0]


@pytest.mark.parametrize("count", [0, 5, 300])
def test_no_motion_where_corners_are_few_or_agree_on_none(count: int) -> None:
    corners = seen_points(2, np.eye(4), 40.0, count)
    assert see(corners) is None


@given(some_seed)
def test_residual_flow_is_what_poses_leave_over(seed: int) -> None:
    """A turn to the right by an angle that poses do not know moves the middle of the image to the left."""
    T_other_this = some_motion(seed)
    corners = seen_points(seed, exp(np.array([0, 0, 0, 0, -0.002, 0])) @ T_other_this, 0.0)
    flow = residual(corners, T_other_this)
    assert flow is not None
    assert -1.3 < flow.sideways_px < -0.7 and abs(flow.vertical_px) < 0.1
    exact = residual(seen_points(seed, T_other_this, 0.0), T_other_this)
    assert exact is not None
    np.testing.assert_allclose(exact, 0, atol=1e-9)


def cost(poses: Sequence[Matrix], edges: Sequence[Edge]) -> list[float]:
    """Cauchy's costs, of which the graph's poses make the least sum, as roots."""
    offs = [(misfit(poses, edge), edge.information) for edge in edges]
    return [DOUBT * float(np.sqrt(np.log1p(off @ information @ off / DOUBT**2))) for off, information in offs]


@pytest.mark.parametrize("seed", [1])
def test_the_graph_finds_what_a_general_solver_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = [np.eye(4)]
    for _ in range(4):
        truth.append(truth[-1] @ exp(rng.normal(0, [0.1, 0.1, 1, 0.02, 0.02, 0.02])))
    spread = np.array([0.02, 0.02, 0.05, 0.002, 0.002, 0.002])
    pairs = [(0, 1), (1, 2), (2, 3), (3, 4), (0, 2), (1, 3), (2, 4)]
    measured = [(a, b, invert(truth[a]) @ truth[b] @ exp(rng.normal(0, spread))) for a, b in pairs]
    measured.append((0, 3, invert(truth[0]) @ truth[3] @ exp(np.array([2.0, 0, 0, 0, 0.1, 0]))))  # wrong
    edges = [Edge(a, b, T, np.diag(spread**-2.0)) for a, b, T in measured]
    edges += [
        Edge(None, n, T @ exp(rng.normal(0, 10 * spread)), np.diag((10 * spread) ** -2.0)) for n, T in enumerate(truth)
    ]
    found = solve(truth, edges)

    def moved(steps: Matrix) -> list[Matrix]:
        return [T @ exp(step) for T, step in zip(truth, steps.reshape(-1, 6), strict=True)]

    peer = least_squares(lambda steps: cost(moved(steps), edges), np.zeros(30), max_nfev=15)
    assert np.square(cost(found, edges)).sum() < 2 * peer.cost * (1 + 1e-4)
    assert np.linalg.norm(found[3][:3, 3] - truth[3][:3, 3]) < 0.5, "the wrong one is held off"


@given(st.integers(3, 40), st.integers(3, 40))
def test_a_halved_image_has_its_camera(height: int, width: int) -> None:
    """A bright pixel lies where the halved camera has its ray."""
    camera = Camera(CAMERA.K, (2 * height, 2 * width))
    image = np.zeros(camera.size, np.uint8)
    image[2:4, 4:6] = 200
    small = halve_camera(camera)
    row, column = np.argwhere(halve(image) == 200)[0]
    large_ray = (np.array([4.5, 2.5]) - camera.K[:2, 2]) / camera.fx
    np.testing.assert_allclose((np.array([column, row]) - small.K[:2, 2]) / small.fx, large_ray)
    assert halve(image).shape == small.size


def test_a_rectification_error_shrinks_with_its_image() -> None:
    error, large = RectificationError(0.5, 0.1, 1.1, -0.7, 0.98), Camera(CAMERA.K, (188, 620))
    disparity_px = np.full(large.size, 12, np.float32)
    small_px = shrink(error, 2).correct(disparity_px[::2, ::2] / 2, halve_camera(large))
    large_px = error.correct(disparity_px, large)
    np.testing.assert_allclose(2 * small_px, (large_px[::2, ::2] + large_px[1::2, 1::2]) / 2, atol=1e-3)


def true_sight(frame: Frame) -> Sight:
    """The street's own depth: at this small size a match of its pairs is off by more than its poses."""
    return Sight(as_grey(frame.image()), frame.truth().depth_m, frame.camera, None)


def off_course(frames: Sequence[Frame], degrees: float = 4) -> list[Frame]:
    """Frames whose positions travel to the left of where the car goes, as a satellite's do."""
    poses = [frames[0].pose()]
    turn = exp(np.array([0, 0, 0, 0, -np.radians(degrees), 0]))
    for before, after in pairwise(frames):
        step = invert(before.pose()) @ after.pose()
        step[:3, 3] = turn[:3, :3] @ step[:3, 3]
        poses.append(poses[-1] @ step)
    return [replace(frame, T_world_cam=T) for frame, T in zip(frames, poses, strict=True)]


def aside_m(frames: Sequence[Frame], poses: Sequence[Matrix]) -> float:
    """How far steps are beside the true ones, median."""
    pairs = [(invert(a.pose()) @ b.pose(), n) for n, (a, b) in enumerate(pairwise(frames))]
    return float(np.median([abs((invert(poses[n]) @ poses[n + 1])[0, 3] - T[0, 3]) for T, n in pairs]))


def test_a_drifting_path_is_put_right(street: Path) -> None:
    drive = open_drive(street)
    frames = [drive[index] for index in range(6)]
    wrong = off_course(frames)
    steps = []
    refined = refine(wrong, true_sight, on_frame=lambda: steps.append(1))
    assert len(steps) == 6 and refined.seen >= 8
    assert refined.after_px[0] < 0.5 * refined.before_px[0]
    before_m, after_m = aside_m(frames, [frame.pose() for frame in wrong]), aside_m(frames, refined.T_world_cam)
    assert after_m < 0.3 * before_m
    lengths = [np.linalg.norm((invert(refined.T_world_cam[0]) @ T)[:3, 3]) for T in refined.T_world_cam[1:]]
    true = [np.linalg.norm((invert(frames[0].pose()) @ frame.pose())[:3, 3]) for frame in frames[1:]]
    np.testing.assert_allclose(lengths, true, rtol=0.02)


def test_a_frame_that_is_left_out_is_not_looked_at(street: Path) -> None:
    drive = open_drive(street)
    frames = off_course([drive[index] for index in range(5)])
    looked: list[str] = []

    def look(frame: Frame) -> Sight:
        looked.append(frame.id)
        return true_sight(frame)

    refined = refine(frames, look, left_out=[frames[3].id])
    assert looked == [frame.id for n, frame in enumerate(frames) if n != 3]
    relative = invert(refined.T_world_cam[2]) @ refined.T_world_cam[3]
    recorded = invert(frames[2].pose()) @ frames[3].pose()
    assert np.abs(refined.T_world_cam[3] - frames[3].pose()).max() > 0.02, "it follows its neighbours"
    np.testing.assert_allclose(relative, recorded, atol=0.1)


def test_a_frame_that_cannot_be_read_is_as_if_left_out(street: Path) -> None:
    drive = open_drive(street)
    frames, eyes = [drive[index] for index in range(4)], open_eyes(drive)

    def broken() -> None:
        raise DataError("damaged")

    frames[1] = replace(frames[1], readers={**frames[1].readers, "image": broken})
    assert len(refine(frames, eyes).T_world_cam) == 4
    dark = [replace(frame, readers={**frame.readers, "image": broken}) for frame in frames]
    with pytest.raises(DataError, match="no motion can be seen"):
        refine(dark, eyes)


@pytest.mark.parametrize("source", ["stereo", "lidar"])
def test_either_source_sees_the_depth(street: Path, source: Literal["stereo", "lidar"]) -> None:
    drive = open_drive(street)
    sight, truth_m = open_eyes(drive, source)(drive[0]), drive[0].truth().depth_m
    both = (sight.depth_m > 0) & (truth_m > 0) & (truth_m < 30)
    assert np.mean(both) > {"stereo": 0.3, "lidar": 0.02}[source]
    assert np.median(np.abs(sight.depth_m - truth_m)[both] / truth_m[both]) < 0.05
    np.testing.assert_array_equal(sight.grey, as_grey(drive[0].image()))


def test_a_drive_that_shows_no_motion_says_so(image_folder: Path) -> None:
    with pytest.raises(DataError, match="no LiDAR: its motion cannot be seen"):
        open_eyes(open_drive(image_folder), "lidar")


@pytest.mark.slow
def test_real_poses_leave_little_over(real_data: RealData) -> None:
    """Drive 0009 at half size: recorded poses leave 0.4 px sideways, dead-reckoned ones a tenth, refined ones less."""
    path = real_data("kitti_raw_train") / "2011_09_26" / "2011_09_26_drive_0009_sync"
    drive, recorded = open_drive(path), open_drive(path, options=DriveOptions(poses="recorded"))
    eyes = open_eyes(drive)
    refined = refine([drive[index] for index in range(30, 42)], eyes)
    before = refine([recorded[index] for index in range(30, 42)], eyes)
    assert before.before_px[0] > 0.3
    assert refined.before_px[0] < 0.1 and refined.before_px[1] < 0.16
    assert before.after_px.max() < 0.04 and refined.after_px.max() < 0.04
