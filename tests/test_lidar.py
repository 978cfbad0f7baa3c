"""The LiDAR method: kernels against loops, small scenes with known answers, and the figures on KITTI."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import lidar as reference

from priors.drives import open_drive
from priors.errors import DataError
from priors.geometry import rays
from priors.kernels.visibility import deny
from priors.kernels.zbuffer import splat
from priors.methods import lidar
from priors.methods.lidar import Lidar
from priors.types import Camera, Frame, Sweep

DRIVE = Path(__file__).resolve().parents[2] / "shared/data/kitti_raw/2011_09_26/2011_09_26_drive_0001_sync"
INF = np.float32(np.inf)
K = np.array([[721.5, 0, 200.0], [0, 721.5, 60.0], [0, 0, 1]])
CAMERA = Camera(K, (200, 400))
# LiDAR axes (x forward, y left, z up) to camera axes, 27 cm ahead and 8 cm below it, as on KITTI's car.
T_CAM_LIDAR = np.array([[0, -1, 0, 0], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1.0]])
ROAD_M, WALL_M = -1.73, 40.0  # the road's height and the wall's distance in the first LiDAR's frame


# --- kernels -------------------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), agree=st.sampled_from([0.0, 0.02, 0.5]))
def test_splat_equals_the_loop(seed, agree):
    rng = np.random.default_rng(seed)
    camera = np.array([[10.0, 0, 8.3], [0, 11.0, 5.6], [0, 0, 1]])
    depth_m, sources = np.full((12, 17), INF), np.full((12, 17), 32767, dtype=np.int16)
    free_m = (rng.uniform(0, 3, depth_m.shape) * rng.integers(0, 2, depth_m.shape)).astype(np.float32)
    sweeps = []
    for source in (0, -1, 1):
        xyz = rng.normal(0, 5, (60, 3)).astype(np.float32)
        xyz[rng.integers(0, 60, 4), rng.integers(0, 3, 4)] = [np.nan, np.inf, -np.inf, 0]
        P = camera @ np.eye(3, 4)
        splat(xyz, np.zeros(0, np.float32), np.zeros(6), P, source, agree, free_m, depth_m, sources)
        sweeps.append((source, xyz, camera))
    expected_m, expected_sources = reference.splat(sweeps, depth_m.shape, agree, free_m)
    np.testing.assert_allclose(depth_m, expected_m, rtol=1e-6)
    np.testing.assert_array_equal(sources, expected_sources)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_splat_untwists_before_it_leaves_points_out(seed):
    """A wild motion brings points in from outside the view: none may be culled too early."""
    rng = np.random.default_rng(seed)
    xyz = rng.normal(0, 5, (200, 3)).astype(np.float32)
    time_s = rng.uniform(-0.05, 0.05, 200).astype(np.float32)
    velocity = rng.normal(0, [40, 40, 40, 10, 10, 10])
    camera = np.array([[10.0, 0, 8.3], [0, 11.0, 5.6], [0, 0, 1]])
    depth_m, sources = np.full((12, 17), INF), np.full((12, 17), 32767, dtype=np.int16)
    free_m = np.zeros((0, 0), dtype=np.float32)
    splat(xyz, time_s, velocity, camera @ np.eye(3, 4), 0, 0.02, free_m, depth_m, sources)
    moved = reference.untwist(xyz, time_s, velocity)
    expected_m, _ = reference.splat([(0, moved, camera)], depth_m.shape, 0.02, np.zeros_like(depth_m))
    np.testing.assert_allclose(depth_m, expected_m, rtol=1e-4)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), fx_px=st.sampled_from([100.0, 230.0, 721.5]), density=st.floats(0, 1))
def test_hidden_and_free_space_equal_the_loops(seed, fx_px, density):
    rng = np.random.default_rng(seed)
    depth_m = np.where(rng.random((23, 31)) < density, rng.uniform(5, 8, (23, 31)), np.inf).astype(np.float32)
    expected = np.zeros(depth_m.shape, dtype=bool)
    for rows_rad, columns_rad, share in lidar.HIDING:
        expected |= reference.hidden(depth_m, round(rows_rad * fx_px), round(columns_rad * fx_px), share)
    np.testing.assert_array_equal(lidar.hidden(depth_m, fx_px), expected)
    rows, columns = lidar.window(fx_px)
    free_m = lidar.free_space(depth_m, fx_px)
    np.testing.assert_array_equal(free_m, reference.free_space(depth_m, rows, columns, lidar.FREE))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), density=st.floats(0, 1), fx_px=st.sampled_from([80.0, 230.0, 721.5]))
def test_confidence_equals_the_loop(seed, density, fx_px):
    rng = np.random.default_rng(seed)
    depth_m = np.where(rng.random((23, 31)) < density, rng.uniform(2, 90, (23, 31)), np.inf).astype(np.float32)
    depth_m[:12] = np.where(depth_m[:12] < np.inf, 5, np.inf)
    fast = lidar.confidence(depth_m, fx_px)
    expected = reference.confidence(depth_m, round(lidar.SUPPORT_RAD * fx_px), lidar.STEADY)
    np.testing.assert_allclose(fast, expected, atol=1e-5)
    assert fast.dtype == np.float32 and fast.min() >= 0 and fast.max() <= 1


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), density=st.floats(0, 1))
def test_deny_equals_the_loop(seed, density):
    rng = np.random.default_rng(seed)
    depth_m = np.where(rng.random((23, 31)) < density, rng.uniform(2, 90, (23, 31)), np.inf).astype(np.float32)
    matched_px = rng.uniform(1, 50, (23, 31)).astype(np.float32)
    matched_px[rng.random((23, 31)) < 0.3] = 0
    matched_px[:12] *= 0.2
    np.testing.assert_array_equal(
        deny(depth_m, matched_px, 100.0, 1.0, 0.05), reference.deny(depth_m, matched_px, 100.0, 1.0, 0.05)
    )


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), density=st.floats(0.02, 1))
def test_no_plane_hides_itself(seed, density):
    """Grazing roads and walls stay, whatever their slope."""
    rng = np.random.default_rng(seed)
    slope = rng.normal(0, 1e-3, 2)
    height, width = 80, 120
    inverse = 0.02 + slope[0] * np.arange(height)[:, None] + slope[1] * np.arange(width)[None]
    inverse[rng.random(inverse.shape) > density] = 0
    with np.errstate(divide="ignore"):
        depth_m = np.where(inverse > 0.002, 1 / inverse, np.inf).astype(np.float32)
    assert not lidar.hidden(depth_m, 721.5).any()


# --- small scenes --------------------------------------------------------------------------------------------------


def hit(origin, directions, boxes):
    """Cast rays at a road, a wall and boxes ((low corner), (high corner)): range_m (n,) and what was hit (n,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        to_road = (ROAD_M - origin[2]) / directions[:, 2]
        to_wall = (WALL_M - origin[0]) / directions[:, 0]
        options = [np.where(t > 0, t, np.inf) for t in (to_road, to_wall)]
        for low, high in boxes:
            a, b = (np.array(low) - origin) / directions, (np.array(high) - origin) / directions
            near, far = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
            options.append(np.where((near < far) & (near > 0), near, np.inf))
    return np.min(options, axis=0), np.argmin(options, axis=0)


def scan(position, boxes):
    """One turn of a 64-line scanner standing still at position, the forward sector of it: points (n, 3)."""
    up, azimuth = np.meshgrid(np.radians(np.linspace(-24.8, 2, 64)), np.radians(np.arange(-30, 30, 0.17)))
    directions = np.stack([np.cos(up) * np.cos(azimuth), np.cos(up) * np.sin(azimuth), np.sin(up)], -1).reshape(-1, 3)
    range_m, _ = hit(position, directions, boxes)
    seen = range_m < 100
    return (directions[seen] * range_m[seen, None]).astype(np.float32)


def make_frame(boxes_at, step_m=1.0, **changes):
    """Make the middle frame of a drive along x; boxes_at(offset) are the boxes when the sweep `offset` is taken."""

    def sweep(offset=0):
        T_world_lidar = np.eye(4)
        T_world_lidar[0, 3] = offset * step_m
        return Sweep(scan(T_world_lidar[:3, 3], boxes_at(offset)), T_world_lidar)

    known = {"T_cam_lidar": T_CAM_LIDAR, "T_world_cam": np.linalg.inv(T_CAM_LIDAR), "readers": {"sweep": sweep}}
    return Frame(id="0000000005", camera=CAMERA, **{**known, **changes})


def true_depth(boxes):
    """What the camera sees, and which thing."""
    T_lidar_cam = np.linalg.inv(T_CAM_LIDAR)
    directions = rays(CAMERA).reshape(-1, 3) @ T_lidar_cam[:3, :3].T
    depth_m, thing = hit(T_lidar_cam[:3, 3], directions, boxes)
    return depth_m.reshape(CAMERA.size), thing.reshape(CAMERA.size)


def wrong(depth, boxes):
    """Where the map has a value that no pixel around, in a 3x3 window, truly has."""
    truth_m, _ = true_depth(boxes)
    padded = np.pad(truth_m, 1, mode="edge")
    near = [np.roll(padded, (y, x), (0, 1))[1:-1, 1:-1] for y in (-1, 0, 1) for x in (-1, 0, 1)]
    low, high = np.min(near, axis=0) * 0.98, np.max(near, axis=0) * 1.02
    inside = [(depth.depth_m > v * 0.95) & (depth.depth_m < v * 1.05) for v in near]
    return depth.valid & ~np.any(inside, axis=0) & ~((truth_m > 15) & (depth.depth_m > low) & (depth.depth_m < high))


POLE = ((8.0, -0.3, ROAD_M), (8.2, 0.3, 2.0))


def test_a_wall_behind_a_pole_is_not_seen_through():
    frame = make_frame(lambda offset: [POLE])
    plain, cleaned = Lidar(occlusion=False, motion=False)(frame), Lidar()(frame)
    assert wrong(plain, [POLE]).sum() > 50
    assert wrong(cleaned, [POLE]).sum() < 0.05 * wrong(plain, [POLE]).sum()
    _, thing = true_depth([POLE])
    for number, name in enumerate(("road", "wall", "pole")):
        kept = (cleaned.valid & (thing == number)).sum() / (
            plain.valid & (thing == number) & ~wrong(plain, [POLE])
        ).sum()
        assert kept > 0.97, name


def test_a_car_that_drives_leaves_no_smear():
    def car(offset):
        x = 15 + 1.5 * offset
        return ((x, -1.0, ROAD_M + 0.2), (x + 3, 1.0, -0.2))

    frame = make_frame(lambda offset: [car(offset)], step_m=0.0)
    plain, cleaned = Lidar(occlusion=False, motion=False)(frame), Lidar()(frame)
    assert wrong(plain, [car(0)]).sum() > 1000
    assert wrong(cleaned, [car(0)]).sum() < 0.05 * wrong(plain, [car(0)]).sum()
    assert cleaned.density > 0.9 * Lidar(sweeps=11)(make_frame(lambda offset: [car(0)], step_m=0.0)).density


def test_more_sweeps_fill_more():
    frame = make_frame(lambda offset: [POLE])
    densities = [Lidar(sweeps=count)(frame).density for count in (1, 3, 11)]
    assert densities == sorted(densities)
    assert densities[2] > 3 * densities[0]


def test_own_sweep_is_exact_where_nothing_hides():
    depth = Lidar(sweeps=1)(make_frame(lambda offset: []))
    truth_m, thing = true_depth([])
    wall = depth.valid & (thing == 1)
    assert wall.sum() > 500
    np.testing.assert_allclose(depth.depth_m[wall], truth_m[wall], rtol=1e-5)
    assert depth.depth_m.dtype == np.float32


# --- stereo --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", ["left", "right"])
def test_stereo_denies_what_it_sees_elsewhere(side):
    rng = np.random.default_rng(3)
    texture = np.kron(rng.integers(0, 255, (100, 230)), np.ones((2, 2))).astype(np.uint8)
    left, right = texture[:, :400], texture[:, 20:420]  # a wall at 20 px: texture[x] is left x and right x - 20
    image, other = (left, right) if side == "left" else (right, left)
    sources = {"image": lambda: image, "other": lambda: other}
    frame = Frame("1", CAMERA, sources, baseline_m=0.54, side=side)
    wall_m = np.float32(721.5 * 0.54 / 20)
    depth_m = np.full(CAMERA.size, wall_m)
    depth_m[90:110, 200:220] = wall_m / 2
    depth_m[:10] = np.inf
    denied = lidar.stereo_denies(frame, depth_m) & np.isfinite(depth_m)
    assert denied[90:110, 200:220].mean() > 0.9
    denied[90:110, 200:220] = False
    assert denied.mean() < 0.01


def test_stereo_is_left_out_where_a_frame_lacks_the_other_image():
    frame = make_frame(lambda offset: [POLE])
    alone = replace(frame, baseline_m=0.54)
    np.testing.assert_array_equal(Lidar()(frame).depth_m, Lidar()(alone).depth_m)


# --- what may be missing -------------------------------------------------------------------------------------------


def test_without_poses_the_own_sweep_is_used():
    frame = make_frame(lambda offset: [POLE])
    unposed = replace(frame, T_world_cam=None)
    assert Lidar().resolve(unposed) == Lidar(sweeps=1, stereo=False)
    assert Lidar().resolve(frame) == Lidar(stereo=False)
    np.testing.assert_array_equal(Lidar()(unposed).depth_m, Lidar(sweeps=1)(frame).depth_m)


def test_a_drive_without_poses_is_told(tmp_path):
    frame, notes = make_frame(lambda offset: [POLE]), []
    Lidar(sweeps=1).prepare([frame, replace(frame, T_world_cam=None)], tmp_path, notes.append)
    assert not notes

    class Unposed(list):
        name = "mine"

    Lidar(sweeps=1).prepare(Unposed([replace(frame, T_world_cam=None)]), tmp_path, notes.append)
    assert notes == ["mine: no poses to accumulate sweeps by: each map is made of its own sweep alone"]


def read_some(frame, lost, error=False):
    def sweep(offset=0):
        if offset in lost and error:
            raise DataError("damaged")
        return None if offset in lost else frame.sweep(offset)

    return replace(frame, readers={"sweep": sweep})


def test_missing_and_damaged_sweeps_are_left_out():
    frame = make_frame(lambda offset: [])
    three = Lidar(sweeps=3)(frame).depth_m
    lost = [-2, 2]
    np.testing.assert_array_equal(Lidar(sweeps=5)(read_some(frame, lost)).depth_m, three)
    np.testing.assert_array_equal(Lidar(sweeps=5)(read_some(frame, lost, error=True)).depth_m, three)
    assert 0 < Lidar(sweeps=3)(read_some(frame, [0])).density < np.mean(three > 0)


def test_no_sweep_at_all_is_an_error():
    frame = make_frame(lambda offset: [])
    with pytest.raises(DataError, match="0000000005"):
        Lidar(sweeps=3)(read_some(frame, [-1, 0, 1]))
    with pytest.raises(DataError, match="damaged"):
        Lidar(sweeps=3)(read_some(frame, [0], error=True))
    with pytest.raises(DataError, match="no sweep"):
        Lidar()(Frame("7", CAMERA, {}))
    with pytest.raises(DataError, match=r"--lidar\.sweeps 0: expected a whole number from 1 to 10001"):
        Lidar(sweeps=0)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((5, 3), np.nan), np.full((5, 3), [-5, 0, 0])])
def test_sweeps_without_usable_points_give_an_empty_map(points):
    sweep = Sweep(points.astype(np.float32), np.eye(4), np.zeros(len(points), np.float32), np.ones(6))
    sources = {"sweep": lambda offset=0: sweep, "image": lambda: np.zeros(CAMERA.size, np.uint8)}
    sources["other"] = sources["image"]
    frame = make_frame(lambda offset: [], readers=sources, baseline_m=0.54)
    depth = Lidar()(frame)
    assert depth.density == 0
    assert depth.depth_m.shape == CAMERA.size


# --- KITTI ---------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not DRIVE.exists(), reason=f"no KITTI drive 0001 at {DRIVE}")
def test_figures_on_drive_0001():
    drive = open_drive(DRIVE)
    rows = []
    for index in range(0, len(drive), 3):
        frame = drive[index]
        depth, truth = Lidar()(frame), frame.truth()
        both = depth.valid & truth.valid
        error_m = np.abs(depth.depth_m - truth.depth_m)[both]
        relative = error_m / truth.depth_m[both]
        far_off = (error_m > 1) & (relative > 0.05)
        sure = depth.confidence[both] > np.quantile(depth.confidence[both], 0.25)
        rows.append((relative.mean(), far_off.mean(), far_off[sure].mean(), depth.density))
    abs_rel, outliers, sure_outliers, density = np.mean(rows, axis=0)
    assert abs_rel <= 0.006
    assert outliers < 0.004
    assert sure_outliers < 0.5 * outliers  # the least sure quarter holds most of them
    assert density >= 0.25
