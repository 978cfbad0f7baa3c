"""The procedural street: the same for a seed, true to itself, and read back as written."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.street import meet

from priors import geometry
from priors.street import mesh, rig
from priors.street.config import StreetConfig
from priors.street.materials import Material
from priors.street.noise import band, fade, hash_, line
from priors.street.path import Ego, Path
from priors.street.raycast import Body, RayCaster
from priors.street.street import Street

SIZE = (96, 320)
SEED = 3
LENGTH_M = 90.0


@pytest.fixture(scope="module")
def street() -> Street:
    return Street(SEED, LENGTH_M)


@pytest.fixture(scope="module")
def pair(street):
    return street.pair(street.T_world_cam(0.5), rig.camera(SIZE), 0.5)


def test_a_seed_gives_the_same_bytes(street, pair):
    again = Street(SEED, LENGTH_M)
    for one, other in zip(pair, again.pair(again.T_world_cam(0.5), rig.camera(SIZE), 0.5), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(street.sweep(0.5)[0], again.sweep(0.5)[0])


def test_another_seed_or_moment_gives_another_picture(street, pair):
    later = street.view(street.T_world_cam(0.6), rig.camera(SIZE), 0.6)
    assert np.mean(later.image != pair[0]) > 0.5
    assert StreetConfig.draw(4).lane_m != street.config.lane_m


def test_the_right_camera_sees_no_deeper_than_the_left_ones_points(street, pair):
    """A ray from the right camera to what the left one sees ends there, or before it where something hides it."""
    camera, T_world_cam = rig.camera(SIZE), street.T_world_cam(0.5)
    xyz_world = geometry.transform(T_world_cam, geometry.unproject(camera, pair[2]).astype(np.float64))
    right = rig.right_of(T_world_cam)[:3, 3]
    hits = street.caster.cast(right[None].astype(np.float32), (xyz_world - right).astype(np.float32), 0.5)
    assert np.mean(hits.distance < 1.001) > 0.995
    assert np.mean(np.abs(hits.distance - 1) < 0.001) > 0.75


def test_depth_maps_of_both_views_agree_where_both_see(street, pair):
    camera = rig.camera(SIZE)
    right = street.view(rig.right_of(street.T_world_cam(0.5)), camera, 0.5)
    depth = pair[2]
    rows, columns = np.nonzero((depth > 0) & (depth < 60))
    z = depth[rows, columns]
    landing = np.rint(columns - camera.fx * rig.BASELINE_M / z).astype(int)
    inside = landing >= 0
    there = right.depth_m[rows[inside], landing[inside]]
    agrees = np.abs(there - z[inside]) < 0.03 * z[inside]
    hidden = (there > 0) & (there < 0.97 * z[inside])
    assert np.mean(agrees | hidden) > 0.93
    assert np.mean(agrees) > 0.75


def test_sky_and_depth_exclude_each_other(pair):
    _, _, depth, sky = pair
    assert 0.02 < sky.mean() < 0.6
    np.testing.assert_array_equal(sky, depth == 0)
    assert not sky[-SIZE[0] // 4 :].any()


def test_semi_global_matching_finds_the_disparity(street):
    camera = rig.camera((188, 620))
    left, right, depth, _ = street.pair(street.T_world_cam(1.0), camera, 1.0)
    matcher = cv2.StereoSGBM_create(0, 96, 5, 8 * 75, 32 * 75, 1, 0, 10, 100, 2)
    found = matcher.compute(cv2.cvtColor(left, cv2.COLOR_RGB2GRAY), cv2.cvtColor(right, cv2.COLOR_RGB2GRAY)) / 16
    true = geometry.convert_disparity(depth, camera.fx, rig.BASELINE_M)
    inside = (true > 1) & (true < 90) & (np.arange(620) > 96)
    matched = inside & (found > 0)
    assert matched.sum() > 0.7 * inside.sum()
    assert np.mean(np.abs(found - true)[matched] < 1.5) > 0.85


def test_traffic_moves_and_the_street_does_not(street):
    camera, T_world_cam = rig.camera(SIZE), street.T_world_cam(0.0)
    now, later = (street.view(T_world_cam, camera, time_s).depth_m for time_s in (0.0, 1.0))
    moved = np.mean(now != later)
    assert 0 < moved < 0.2


def test_the_brightness_of_a_place_does_not_depend_on_the_eye(street, pair):
    """Textures belong to the world: matte places look alike from both cameras."""
    left, right, depth, _ = pair
    camera = rig.camera(SIZE)
    rows, columns = np.nonzero((depth > 4) & (depth < 25))
    landing = columns - camera.fx * rig.BASELINE_M / depth[rows, columns]
    inside = landing > 1
    grey = [view.astype(np.float32).mean(axis=2) for view in (left, right)]
    moved = cv2.remap(grey[1], landing[inside].astype(np.float32), rows[inside].astype(np.float32), cv2.INTER_LINEAR)
    assert np.median(np.abs(moved.ravel() - grey[0][rows[inside], columns[inside]])) < 6


def test_the_scanner_meets_what_stands_there_at_each_points_own_time(street):
    points, times = street.sweep(0.5)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    np.testing.assert_allclose(times, -0.1 / (2 * np.pi) * azimuth, atol=1e-6)
    poses = street.T_world_velo(0.5 + times)
    rays = np.einsum("nij,nj->ni", poses[:, :3, :3], points[:, :3].astype(np.float64))
    hits = street.caster.cast(poses[:, :3, 3].astype(np.float32), rays.astype(np.float32), 0.5 + times)
    off_m = (hits.distance - 1) * np.linalg.norm(rays, axis=1)
    usual = np.abs(off_m) < 0.2
    assert usual.mean() > 0.97  # the rest passed an edge by less than the beam's jitter
    assert 0.015 < off_m[usual].std() < 0.04
    assert np.linalg.norm(points[:, :3], axis=1).max() < 111


def test_casting_equals_the_loop_for_still_and_moving_things():
    rng = np.random.default_rng(1)
    corner = rng.uniform(-5, 5, (6, 1, 3))
    still = mesh.boxes(np.concatenate([corner, corner + 1], axis=1), mesh.Finish(Material.PLAIN, [0.5] * 3))
    thing = mesh.box([-1, -1, -1], [1, 0.5, 1], mesh.Finish(Material.PLAIN, [0.5] * 3))

    def pose(time_s):
        T = np.tile(np.eye(4), (len(time_s), 1, 1))
        T[:, 0, 3], T[:, 2, 3] = 20 * time_s, 3
        cos, sin = np.cos(time_s), np.sin(time_s)
        T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1] = cos, -sin, sin, cos
        return T

    scene = RayCaster(still, [Body(thing, pose)])
    origins = rng.uniform(-8, 8, (150, 3)).astype(np.float32)
    directions = (rng.uniform(-4, 4, (150, 3)) - origins).astype(np.float32)
    times = rng.uniform(-0.05, 0.05, 150)
    hits = scene.cast(origins, directions, times)
    for index in range(150):
        T = pose(times[index : index + 1])[0]
        moved = thing.corners @ T[:3, :3].T + T[:3, 3]
        expected = meet(origins[index], directions[index], np.concatenate([still.corners, moved]))
        assert hits.distance[index] == pytest.approx(expected, rel=1e-4)
    assert np.isfinite(hits.distance).any() and np.isinf(hits.distance).any()


def test_light_is_blocked_by_the_moving_thing_where_it_is():
    floor = mesh.quads([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], mesh.Finish(Material.PLAIN, [0.5] * 3))
    roof = mesh.quads([(-1, -1, 2), (1, -1, 2), (1, 1, 2), (-1, 1, 2)], mesh.Finish(Material.PLAIN, [0.5] * 3))

    def pose(time_s):
        T = np.tile(np.eye(4), (len(time_s), 1, 1))
        T[:, 0, 3] = time_s
        return T

    scene = RayCaster(floor, [Body(roof, pose)])
    places = np.array([[0, 0, 0.1], [5, 0, 0.1]], np.float32)
    up = np.array([0, 0, 1], np.float32)
    np.testing.assert_array_equal(scene.blocked(places, up, 0.0), [True, False])
    np.testing.assert_array_equal(scene.blocked(places, up, 5.0), [False, True])


@given(st.integers(0, 10_000), st.floats(0, 300), st.floats(-6, 6))
@settings(max_examples=30, deadline=None)
def test_bending_keeps_lengths_near_the_centre_line_and_can_be_located(seed, s, t):
    path = Path(StreetConfig.draw(seed))
    here, ahead, aside = path.bend(np.array([[s, 0, 0], [s + 0.5, 0, 0], [s, t, 0]]))
    assert np.linalg.norm(ahead - here) == pytest.approx(0.5, rel=2e-3)
    assert np.linalg.norm(aside - here) == pytest.approx(abs(t), abs=1e-6)
    assert path.locate(here[:1], here[1:2])[0][0] == pytest.approx(s, abs=1e-3)


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_the_rig_moves_like_a_car(seed):
    config = StreetConfig.draw(seed)
    poses = Ego(config, Path(config)).T_world_rig(np.arange(0, 4, 0.1))
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert np.all((steps > 0.6) & (steps < 1.6))
    assert np.abs(np.diff(steps)).max() < 0.05
    np.testing.assert_allclose(
        poses[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2), np.tile(np.eye(3), (40, 1, 1)), atol=1e-9
    )
    assert np.all(poses[:, 2, 2] > 0.99)


@given(st.floats(0.01, 50), st.integers(0, 9), st.floats(0, 1000))
@settings(max_examples=30, deadline=None)
def test_noise_is_centred_and_bounded(wave, number, key):
    uv = np.random.default_rng(0).uniform(0, 300 * wave, (4000, 2)).astype(np.float32)
    values = band(uv, wave, np.full(4000, key, np.float32), number)
    assert abs(values.mean()) < 0.15
    assert 0.7 < values.std() < 1.3
    assert np.abs(values).max() < 6


@given(st.floats(0.001, 10), st.floats(0.0001, 10), st.floats(0.0001, 10))
def test_details_fade_as_pixels_grow(wave, one, other):
    small, large = sorted((one, other))
    seen = fade(wave, np.array([small, large], np.float32))
    assert 0 <= seen[1] <= seen[0] <= 1


def test_a_line_covers_what_it_should():
    across = np.linspace(-1, 1, 20001).astype(np.float32)
    for footprint in (0.005, 0.05, 0.3):
        cover = line(across, 0.06, np.full(20001, footprint, np.float32))
        assert cover.mean() * 2 == pytest.approx(0.12, rel=0.1)


def test_hashes_are_even():
    x, y = np.meshgrid(np.arange(100.0), np.arange(100.0))
    values = hash_(x.ravel(), y.ravel())
    counts, _ = np.histogram(values, bins=10, range=(0, 1))
    assert values.min() >= 0 and values.max() < 1
    assert np.all(np.abs(counts - 1000) < 150)
