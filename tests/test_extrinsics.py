"""How the LiDAR is turned against the camera: corrections, what outlines and surfaces tell, and what is kept of it."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import extrinsics as reference

from priors import build
from priors.drive_around import DriveAround
from priors.drives import open_drive
from priors.errors import DataError
from priors.extrinsics import kept
from priors.extrinsics import measured as measuring
from priors.extrinsics.belief import PRIOR, UNKNOWNS, Belief, Told
from priors.extrinsics.correction import NONE, Correction
from priors.extrinsics.edges import EdgeView, told_by_edges
from priors.extrinsics.fit import fit_surfaces
from priors.extrinsics.measure import FRAMES, measure, spread_frames
from priors.extrinsics.measured import Measured
from priors.extrinsics.outlines import find_outlines
from priors.extrinsics.points import Points
from priors.extrinsics.samples import weigh
from priors.extrinsics.surfaces import COLUMNS, DELAY, PLACE, TURN, SurfaceView, slopes
from priors.geometry import invert, project, transform, untwist
from priors.methods.completion import Completion
from priors.methods.lidar import Lidar
from priors.pairs.rectification import RectificationError
from priors.street.rig import T_left_velo
from priors.types import Camera, Drive, Frame, Sweep

CAMERA = Camera(np.array([[360.0, 0, 310], [0, 360, 94], [0, 0, 1]]), (188, 621))
BASELINE_M, FX_BASELINE = 0.54, 360 * 0.54
GOES = np.array([11.0, 0.2, 0.1, 0.0, 0.02, 0.3])
"""Forward, and around a bend: m/s and rad/s in the LiDAR's frame."""
NEAR_M = 0.01
"""Ours takes a car's turn and way apart: after 50 ms, half of time squared times turn times speed is 4 mm."""
angles = st.tuples(*[st.floats(-0.5, 0.5)] * 3)


class Turned(DriveAround):
    """A drive whose calibration is wrong by a correction."""

    def __init__(self, drive: Drive, wrong: Correction) -> None:
        super().__init__(drive)
        self.wrong = wrong

    def frame(self, index: int) -> Frame:
        return self.wrong.frame(self.drive[index])


def road_and_walls(rays: np.ndarray) -> np.ndarray:
    """How far along rays (..., 3), z = 1, a camera sees a road and two walls: depth, metres."""
    x, y = rays[..., 0], rays[..., 1]
    with np.errstate(divide="ignore"):
        road_m = np.where(y > 0, 1.65 / y, np.inf)
        wall_m = np.where(x > 0, 6 / x, np.where(x < 0, -5 / x, np.inf))
    return np.minimum(np.minimum(road_m, wall_m), 60.0)


def street_view(wrong: Correction, seed: int = 0) -> SurfaceView:
    """A road between walls as an exact match sees it, and a sweep of it by a LiDAR that a correction would mend."""
    columns, rows = np.meshgrid(np.arange(CAMERA.size[1]), np.arange(CAMERA.size[0]))
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1).astype(np.float64)
    disparity_px = (FX_BASELINE / road_and_walls(pixels @ np.linalg.inv(CAMERA.K).T)).astype(np.float32)
    rng = np.random.default_rng(seed)
    uv = np.column_stack([rng.uniform(8, 612, 4000), rng.uniform(8, 180, 4000), np.ones(4000)])
    rays = uv @ np.linalg.inv(CAMERA.K).T
    at_m = rays * road_and_walls(rays)[:, None] - np.array(wrong.moved_m)
    T = T_left_velo()
    rate = np.tile(T[:3, :3] @ GOES[:3], (len(at_m), 1)) + np.cross(T[:3, :3] @ GOES[3:], at_m - T[:3, 3])
    around_m = (at_m - T[:3, 3]) @ wrong.R - wrong.delay_s * rate  # placed by `wrong`, they are where they are
    points = Points(around_m, rate, T[:3, 3])
    return SurfaceView(points, CAMERA, FX_BASELINE, disparity_px, slopes(disparity_px), RectificationError())


@settings(max_examples=8, deadline=None)
@given(angles, st.floats(-0.03, 0.03), st.integers(0, 5))
def test_a_point_is_seen_where_the_slow_version_sees_it(
    turn: tuple[float, float, float], delay_s: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    xyz_m = np.column_stack([rng.uniform(5, 30, 5), rng.uniform(-4, 4, 5), rng.uniform(-1.5, 1, 5)]).astype(np.float32)
    by, T = Correction(turn, delay_s), T_left_velo()
    sweep = Sweep(xyz_m, None, rng.uniform(-0.02, 0.02, 5).astype(np.float32), GOES)
    given_ = Frame("0", CAMERA, {"sweep": lambda offset: sweep}, T_cam_lidar=T)
    frame = by.frame(given_)
    read = frame.sweep()
    assert read is not None and read.time_s is not None and frame.T_cam_lidar is not None
    uv, z = project(CAMERA, transform(frame.T_cam_lidar, untwist(read)))
    quick_uv, quick_z = project(CAMERA, Points.of_sweep(sweep, T).placed(by))
    for n in range(5):
        u, v, depth_m = reference.seen_at(xyz_m[n], by.R, T, GOES, float(read.time_s[n]), CAMERA.K)
        for seen_uv, seen_z in ((uv[n], z[n]), (quick_uv[n], quick_z[n])):
            np.testing.assert_allclose(seen_z, depth_m, rtol=0, atol=NEAR_M)
            np.testing.assert_allclose(seen_uv, [u, v], rtol=0, atol=2 * 360 * NEAR_M / depth_m)


@pytest.mark.parametrize("posed", ["camera", "lidar"])
def test_a_turn_keeps_the_poses_that_the_drive_has(street: Path, posed: Literal["camera", "lidar"]) -> None:
    turn, back = Correction((0.3, -0.2, 0.1), 0.02), Correction((-0.3, 0.2, -0.1), -0.02)
    frame = replace(open_drive(street)[3], posed=posed)
    turned = turn.frame(frame)
    assert turned.T_cam_lidar is not None and frame.T_cam_lidar is not None
    for offset in (0, 1, -2):
        own, moved, again = (each.sweep(offset) for each in (frame, turned, back.frame(turned)))
        assert own is not None and again is not None and moved is not None
        assert own.T_world_lidar is not None and moved.T_world_lidar is not None
        np.testing.assert_allclose(again.T_world_lidar, own.T_world_lidar, atol=1e-9)
        np.testing.assert_allclose(again.time_s, own.time_s, atol=1e-7)
        if posed == "lidar":
            np.testing.assert_array_equal(moved.T_world_lidar, own.T_world_lidar)
        else:  # where a sweep puts its camera does not change
            seen = moved.T_world_lidar @ invert(turned.T_cam_lidar)
            np.testing.assert_allclose(seen, own.T_world_lidar @ invert(frame.T_cam_lidar), atol=1e-9)
        if offset == 0:
            np.testing.assert_allclose(invert(turned.pose()) @ moved.T_world_lidar, turned.T_cam_lidar, atol=1e-6)
    assert np.allclose(turned.pose(), frame.pose()) == (posed == "camera")
    bare = replace(frame, T_cam_lidar=None)
    assert turn.frame(bare) is bare


def test_a_sweep_of_unknown_motion_keeps_its_times() -> None:
    still = Sweep(np.ones((3, 3), np.float32), None)
    timed = replace(still, velocity=GOES)
    for sweep, wanted in ((still, None), (timed, [0.02] * 3)):
        frame = Frame("0", CAMERA, {"sweep": lambda offset, sweep=sweep: sweep}, T_cam_lidar=np.eye(4))
        read = Correction(delay_s=0.02).frame(frame).sweep()
        assert read is not None
        assert read.time_s is None if wanted is None else np.allclose(read.time_s, wanted)


def scan(seed: int) -> np.ndarray:
    """Points of six lines: posts before a wall, some echoes missing."""
    rng = np.random.default_rng(seed)
    azimuth, elevation = np.meshgrid(np.arange(-8, 8, 0.2), np.arange(-2, 1, 0.5))
    range_m = 25 / np.cos(np.radians(azimuth + 20))
    for centre in rng.uniform(-7, 7, 4):
        range_m = np.where(np.abs(azimuth - centre) < rng.uniform(0.3, 1.5), rng.uniform(6, 20), range_m)
    there = rng.random(azimuth.shape) < 0.9
    a, e, r = (np.radians(azimuth[there]), np.radians(elevation[there]), range_m[there])
    return np.column_stack([r * np.cos(e) * np.cos(a), r * np.cos(e) * np.sin(a), r * np.sin(e)]).astype(np.float32)


@pytest.mark.parametrize("seed", [0, 1])
def test_outlines_are_those_of_the_slow_version(seed: int) -> None:
    xyz_m = scan(seed)
    found = find_outlines(xyz_m)
    for side in (-1, 1):
        own = sorted(found.source[found.side == side].tolist())
        assert own == reference.outline_sources(xyz_m, side, 0.2) and len(own) > 8
    range_m = np.linalg.norm(xyz_m, axis=1)
    np.testing.assert_allclose(np.linalg.norm(found.xyz_m, axis=1), range_m[found.source], rtol=1e-5)


def test_a_grazing_plane_and_a_few_points_have_no_outline() -> None:
    azimuth = np.radians(np.arange(2, 40, 0.2))
    wall = np.column_stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth]) * (3 / np.sin(azimuth))[:, None]
    assert not len(find_outlines(wall.astype(np.float32)).source)
    assert not len(find_outlines(np.zeros((0, 3), np.float32)).source)


def test_factors_are_the_derivatives_of_residuals() -> None:
    view, start = street_view(NONE), Correction((0.1, -0.1, 0.05), 0.002)
    factors, residual_px = view.compare(start, RectificationError(), 4.0)
    assert factors.shape == (len(residual_px), COLUMNS) and len(residual_px) > 2000
    steps: list[tuple[int, Callable[[float], tuple[SurfaceView, Correction]], float]] = [
        *((TURN.start + n, lambda h, n=n: (view, turned_more(start, n, h)), np.radians(1e-5)) for n in range(3)),
        (DELAY, lambda h: (view, replace(start, delay_s=start.delay_s + h)), 1e-6),
        *((PLACE.start + n, lambda h, n=n: (moved(view, n, h), start), 1e-5) for n in range(3)),
    ]
    for column, change, step in steps:
        ahead, behind = (seen.compare(by, RectificationError(), 4.0)[1] for seen, by in (change(step), change(-step)))
        assert len(ahead) == len(behind) == len(residual_px), column  # so small a step takes no point out
        slope = (behind - ahead) / (2 * step)  # the match less the sweep
        off = np.abs(slope - factors[:, column])
        assert np.quantile(off, 0.9) < 0.01 * np.quantile(np.abs(factors[:, column]), 0.9), column


def turned_more(start: Correction, axis: int, radians: float) -> Correction:
    turn = np.array(start.turn_deg)
    turn[axis] += np.degrees(radians)
    return replace(start, turn_deg=(float(turn[0]), float(turn[1]), float(turn[2])))


def moved(view: SurfaceView, axis: int, metres: float) -> SurfaceView:
    points = view.points
    return replace(view, points=replace(points, origin_m=points.origin_m + metres * np.eye(3)[axis]))


@settings(max_examples=3, deadline=None)
@given(angles, st.floats(-0.02, 0.02))
def test_surfaces_tell_turn_and_delay(turn: tuple[float, float, float], delay_s: float) -> None:
    wrong = Correction(turn, delay_s)
    fit = fit_surfaces([street_view(wrong, seed) for seed in range(3)])
    assert fit is not None
    found, errors = fit.belief.correction, fit.belief.errors
    np.testing.assert_allclose(found.turn_deg[::2], turn[::2], atol=0.06)
    np.testing.assert_array_less(np.abs(np.array(found.turn_deg) - turn), 2 * errors[:3])
    assert abs(found.delay_s - delay_s) < 2 * errors[3]  # it looks like yaw on a bend between walls
    assert (errors > 0).all() and (errors <= 1.0001 * PRIOR).all()


@pytest.mark.parametrize("down_m", [0.01, -0.01])
def test_surfaces_tell_how_high_the_lidar_is(down_m: float) -> None:
    """The prior pulls it towards 0."""
    fit = fit_surfaces([street_view(Correction(moved_m=(0, down_m, 0)), seed) for seed in range(3)])
    assert fit is not None and 0.2 < fit.belief.correction.moved_m[1] / down_m < 1.2
    assert (np.abs(fit.belief.mean[:3]) < 2 * fit.belief.errors[:3]).all()


def test_few_points_tell_nothing() -> None:
    few = [replace(view, points=view.points.take(np.arange(20))) for view in (street_view(NONE, n) for n in range(3))]
    assert fit_surfaces(few) is None and fit_surfaces([]) is None


def test_a_delay_is_told_the_worse_the_slower_the_car_is() -> None:
    """A LiDAR that stands ahead looks like it: by 2 cm and more."""
    views = [street_view(NONE, seed) for seed in range(3)]
    errors_s = []
    for speed in (3.0, 1.0, 0.3, 0.0):
        seen = [replace(view, points=replace(view.points, rate_m_s=speed * view.points.rate_m_s)) for view in views]
        fit = fit_surfaces(seen)
        assert fit is not None
        errors_s.append(float(fit.belief.errors[3]))
    assert errors_s == sorted(errors_s) and errors_s[0] > 0.02 / 33 and errors_s[-1] == pytest.approx(PRIOR[3])


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 3))
def test_what_is_told_is_joined_as_least_squares_join_it(seed: int, count: int) -> None:
    """The slow version: all information matrices added up."""
    rng, before = np.random.default_rng(seed), Belief.of_calibration()
    scaled = rng.normal(size=(count, len(UNKNOWNS)))
    errors = rng.uniform(0.1, 2, count)
    told = Told(scaled / PRIOR, rng.normal(size=count), np.diag(errors**2))
    after = before.after(told)
    information = np.diag(PRIOR**-2) + told.factors.T @ np.diag(errors**-2) @ told.factors
    covariance = np.linalg.inv(information)
    unit = np.outer(PRIOR, PRIOR)
    np.testing.assert_allclose(after.covariance / unit, covariance / unit, rtol=0, atol=1e-9)
    mean = covariance @ told.factors.T @ (told.values / errors**2)
    np.testing.assert_allclose(after.mean / PRIOR, mean / PRIOR, rtol=0, atol=1e-8)


@pytest.mark.parametrize("lean", [0.0, 0.7, -0.9])
def test_samples_find_mean_and_covariance(lean: float) -> None:
    wanted, mean = np.array([[1.0, lean], [lean, 1.0]]), np.array([0.8, -0.5])
    inverse = np.linalg.inv(wanted)
    found, covariance = weigh(
        lambda x: -np.einsum("ni,ij,nj->n", x - mean, inverse, x - mean) / 2, np.zeros(2), 2 * np.ones(2)
    )
    np.testing.assert_allclose(found, mean, atol=0.15)
    np.testing.assert_allclose(covariance, wanted, atol=0.2)


def posts(wrong: Correction, seed: int, speed_m_s: float = 0.0) -> EdgeView:
    """Bright posts on a dark wall, and the outlines that a LiDAR sees of them; half a pixel too wide.

    A correction would mend the LiDAR.
    """
    rng = np.random.default_rng(seed)
    image = np.full(CAMERA.size, 60, np.uint8) + rng.integers(0, 6, CAMERA.size, dtype=np.uint8)
    points, sides = [], []
    for left in (np.arange(20, 540, 65) + rng.integers(0, 25, 8)).tolist():
        width, z = int(rng.integers(6, 30)), float(rng.uniform(6, 20))
        image[20:170, left : left + width] = rng.integers(110, 250)
        for side, u in ((-1.0, left - 1.0), (1.0, left + width)):
            v = np.arange(30, 160, 6.0)
            points.append(np.column_stack([np.full_like(v, u), v, np.ones_like(v)]) @ np.linalg.inv(CAMERA.K).T * z)
            sides.append(np.full(len(v), side))
    rate = np.array([0.0, 0.0, speed_m_s])
    xyz_m = (np.concatenate(points) - np.array(wrong.moved_m)) @ wrong.R - wrong.delay_s * rate
    moves = np.tile(rate, (len(xyz_m), 1))
    return EdgeView(Points(xyz_m, moves, np.zeros(3)), np.concatenate(sides), CAMERA, image)


def told_errors(told: Told) -> np.ndarray:
    return np.sqrt(np.diag(told.covariance))


@pytest.mark.parametrize("yaw_deg", [0.0, 0.27, -0.8])
def test_upright_edges_tell_yaw(yaw_deg: float) -> None:
    views = [posts(Correction((0, yaw_deg, 0)), seed) for seed in range(3)]
    told = told_by_edges(views, NONE, 1.2)
    assert told is not None and abs(told.values[0] - yaw_deg) < 0.03 and 0 < told.covariance[0, 0] < 0.1**2
    assert told_by_edges(views[:1], NONE, 1.2) is not None
    assert told_by_edges([replace(views[0], points=views[0].points.take(np.arange(99)))], NONE, 1.2) is None


@pytest.mark.parametrize(("aside_m", "ahead_m"), [(-0.02, 0.0), (0.015, 0.06), (0.0, -0.1)])
def test_upright_edges_near_and_far_tell_where_the_lidar_is(aside_m: float, ahead_m: float) -> None:
    wrong = Correction((0, 0.1, 0), moved_m=(aside_m, 0.0, ahead_m))
    told = told_by_edges([posts(wrong, seed) for seed in range(6)], NONE, 1.2)
    assert told is not None and told.factors[2, UNKNOWNS.index("delay")] == 0
    np.testing.assert_array_less(np.abs(told.values - [0.1, aside_m, ahead_m]), 3 * told_errors(told))
    np.testing.assert_array_less(told_errors(told), [0.1, 0.02, 0.03])


@pytest.mark.parametrize("delay_s", [0.02, -0.03])
def test_upright_edges_tell_a_delay_of_a_car_that_moves(delay_s: float) -> None:
    """Nothing is known before: it is looked for as far as a car goes in some hundredths of a second."""
    views = [posts(Correction((0, 0.1, 0), delay_s), seed, speed_m_s=10.0) for seed in range(6)]
    told = told_by_edges(views, NONE, 1.2, reach_m=0.4)
    assert told is not None and told.factors[2, UNKNOWNS.index("delay")] == pytest.approx(10)
    np.testing.assert_array_less(np.abs(told.values - [0.1, 0, 10 * delay_s]), 3 * told_errors(told))
    belief = Belief.of_calibration().after(told)
    assert abs(belief.correction.delay_s - delay_s) < 0.004 and 0.002 < belief.errors[3] < 0.004


def test_outlines_are_moved_as_by_the_slow_version() -> None:
    """Each place placed for itself, each outline looked up by rows and columns."""
    view, start = posts(NONE, 1, speed_m_s=10.0), Correction((0.1, -0.1, 0.05), 0.01, (0.01, 0.0, 0.02))
    edges = np.tile(np.arange(CAMERA.size[1], dtype=np.float32), (CAMERA.size[0], 1))  # tells the column
    more = np.array([[0, 0, 0, 0], [0.1, 0, 0, 0.5], [-0.1, 0.02, 0.05, 0], [0.05, -0.01, -0.1, -1.0]])
    found = view.strengths(start, more, 10.0, edges)
    for (yaw, aside, ahead, out), total in zip(more.tolist(), found.tolist(), strict=True):
        by = Correction((0.1, start.turn_deg[1] + yaw, 0.05), 0.01 + ahead / 10, (0.01 + aside, 0.0, 0.02))
        wanted = sum(u - out * side for u, side in zip(view.pixels(by)[0], view.side, strict=True))
        assert total / len(view.points) == pytest.approx(wanted / len(view.points), abs=0.03)


def test_posts_of_one_distance_leave_the_place_unknown() -> None:
    """Yaw and place look alike there: the calibration's place stays, and yaw's error holds that it may be off."""
    views = []
    for seed in range(3):
        view = posts(NONE, seed)
        z = view.points.xyz_m[:, 2:]
        views.append(replace(view, points=replace(view.points, xyz_m=view.points.xyz_m * 12 / z)))
    told = told_by_edges(views, NONE, 1.2)
    assert told is not None
    belief = Belief.of_calibration().after(told)
    assert abs(belief.correction.moved_m[0]) < 0.005 and belief.errors[4] > 0.008
    assert belief.errors[1] > np.degrees(0.008 / 12)


def test_an_image_without_edges_tells_no_yaw() -> None:
    plain = [replace(posts(NONE, seed), grey=np.full(CAMERA.size, 90, np.uint8)) for seed in range(3)]
    assert told_by_edges(plain, NONE, 1.2) is None


def test_what_is_told_and_restored() -> None:
    measured = Measured(Correction((0.3, -0.1, 0.0), 0.021), (0.05, 0.04, np.inf), 0.004, frames=["a", "b"])
    assert str(measured) == (
        "turned by 0.32 degrees (pitch +0.30 +-0.05, yaw -0.10 +-0.04, roll not seen); +21 +-4 ms late"
    )
    assert Measured.restore(json.loads(json.dumps(measured.record()))) == measured
    placed = replace(measured.correction, moved_m=(0.012, -0.004, 0.0))
    moved = replace(measured, correction=placed, moved_errors_m=(0.008, 0.005, np.inf))
    assert str(moved) == f"{measured}; it stands +1.2 +-0.8 cm right, -0.4 +-0.5 cm down"
    assert Measured.restore(json.loads(json.dumps(moved.record()))) == moved
    assert "no delay (+-4 ms)" in str(replace(measured, correction=Correction()))
    assert "delay not seen" in str(replace(measured, delay_error_s=np.inf))
    assert measured.error_deg == pytest.approx(np.hypot(0.3 * 0.05, 0.1 * 0.04) / np.hypot(0.3, 0.1))


def test_only_angles_that_are_sure_are_corrected() -> None:
    """What is not seen has an error of inf."""
    measured = Measured(Correction((0.3, -0.07, 0.0), 0.021), (0.05, 0.04, np.inf), 0.004)
    assert measured.sure == Correction((0.3, 0.0, 0.0), 0.021)
    assert replace(measured, errors_deg=(0.2, 0.022, np.inf)).sure.turn_deg == (0.0, -0.07, 0.0)
    moved = replace(measured, correction=replace(measured.correction, moved_m=(0.01, 0.0, 0.0)))
    assert moved.sure.moved_m == (0.01, 0.0, 0.0)  # the angles were found beside it
    still = replace(moved, correction=replace(moved.correction, delay_s=0.0), errors_deg=(0.3, 0.3, np.inf))
    assert still.sure == NONE
    small = Measured(Correction((0.09, 0.0, 0.0)), (0.01, 0.01, 0.01), 0.004)
    assert not small.is_off and small.sure == NONE  # sure, and too small to count
    assert replace(small, correction=Correction((0.13, 0.0, 0.0))).sure.turn_deg == (0.13, 0.0, 0.0)
    assert not replace(small, correction=Correction((0.13, 0.0, 0.0)), errors_deg=(0.04,) * 3).is_off  # likely
    assert not replace(
        small, correction=Correction((0.16, 0.0, 0.0)), errors_deg=(0.055, 0.04, 0.04)
    ).is_off  # not sure


def test_frames_are_spread_over_the_drive(street: Path) -> None:
    assert spread_frames(open_drive(street)) == list(range(6))
    places = spread_frames(Long())  # type: ignore[arg-type]
    assert len(places) == FRAMES and places[0] == 4 and places[-1] == 95


class Long:
    def __len__(self) -> int:
        return 100


def test_what_shows_too_little_is_refused(street: Path) -> None:
    drive = open_drive(street)
    with pytest.raises(DataError, match="2 frames have an image and a sweep: expected 3 or more"):
        measure([drive[0], drive[1], replace(drive[2], T_cam_lidar=None)])
    with pytest.raises(DataError, match=r"leave --lidar\.extrinsics out"):
        kept.measured_on(open_drive(street)[:2], street)


def test_a_plain_wall_tells_no_turn(raw_drive: Path) -> None:
    """It leans, and fills the image: turned about its own, it looks the same but for where its ends are."""
    drive = open_drive(raw_drive)
    try:
        measured = measure([drive[index] for index in range(len(drive))])
    except DataError as error:
        assert "too few surfaces and outlines" in str(error)
    else:
        assert "not seen" in str(measured) and measured.correction.size_deg < 0.3


def test_it_is_measured_once_and_again_where_a_frame_has_changed(own_street: Path, tmp_path: Path) -> None:
    drive, notes = open_drive(own_street), list[str]()
    first = kept.measured_on(drive, tmp_path / "kept", notes.append)
    assert first.frames == list(drive.ids) and "measured on 6 frames" in notes[-1]
    (path,) = (tmp_path / "kept").iterdir()
    marked = json.loads(path.read_text()) | {"turn_deg": [0.25, 0.0, 0.0]}
    path.write_text(json.dumps(marked))
    assert kept.measured_on(drive, tmp_path / "kept", notes.append).correction.turn_deg == (0.25, 0.0, 0.0)
    assert "measured before" in notes[-1]
    path.write_text("{")
    assert kept.measured_on(drive, tmp_path / "kept") == first
    path.write_text(json.dumps(marked))
    image = drive[4].files["image"]()
    assert image is not None
    image.write_bytes(drive[3].files["image"]().read_bytes())  # type: ignore[union-attr]
    assert kept.measured_on(drive, tmp_path / "kept").correction.turn_deg[0] != 0.25


def test_methods_work_as_measured_and_say_what_they_need(
    street: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measuring, "SURE", 1e-9)  # a right street's angles are not sure, and here they shall count
    monkeypatch.setattr(measuring, "TURNED_DEG", -1.0)
    drive = open_drive(street)
    found = kept.measured_on(drive, tmp_path / drive.name / "weights").sure
    assert found.size_deg > 0
    corrected = found.frame(drive[2])
    for name, asked in (("lidar", Lidar(sweeps=3)), ("completion", Completion(source="lidar", lidar=Lidar(sweeps=3)))):
        as_measured = replace(asked, **({"extrinsics": "measured"} if name == "lidar" else measured_lidar(asked)))
        with pytest.raises(DataError, match="call prepare first"):
            as_measured(drive[2])
        prior = build.prepare(drive, as_measured, folder=tmp_path).run().prior
        np.testing.assert_allclose(prior.read("0000000002").depth_m, asked(corrected).depth_m, rtol=0.01, atol=0.01)
        plain = build.prepare(drive, asked, folder=tmp_path).prior
        assert plain.folder != prior.folder


def measured_lidar(method: Completion) -> dict[str, Lidar]:
    return {"lidar": replace(method.lidar, extrinsics="measured")}
