"""Geometry: what must hold for any camera, any depth and the nastiest numbers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from reference import geometry as reference

from priors import geometry
from priors.types import Camera

EXTREMES = [0.0, -0.0, -1.0, 1e-45, 1e-38, 1e-3, 1.0, 80.0, 65504.0, 1e30, 3e38, np.nan, np.inf, -np.inf]
depths = st.floats(0.125, 250, width=32)


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    height, width = draw(st.integers(1, 12)), draw(st.integers(1, 12))
    focal = st.floats(5, 2000)
    K = np.array([[draw(focal), 0, draw(st.floats(-5, 20))], [0, draw(focal), draw(st.floats(-5, 20))], [0, 0, 1]])
    return Camera(K, (height, width))


@st.composite
def maps(draw: st.DrawFn) -> tuple[Camera, np.ndarray]:
    camera = draw(cameras())
    holes = st.one_of(st.just(np.float32(0)), depths.map(np.float32))
    return camera, draw(hnp.arrays(np.float32, camera.size, elements=holes))


@st.composite
def poses(draw: st.DrawFn) -> np.ndarray:
    rotation, _ = np.linalg.qr(np.random.default_rng(draw(st.integers(0, 2**32))).normal(size=(3, 3)))
    T_a_b = np.eye(4)
    T_a_b[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    T_a_b[:3, 3] = draw(st.tuples(*[st.floats(-1000, 1000)] * 3))
    return T_a_b


@given(maps())
def test_unprojecting_then_projecting_gives_the_pixels_back(case: tuple[Camera, np.ndarray]) -> None:
    camera, depth_m = case
    uv_px, z = geometry.project(camera, geometry.unproject(camera, depth_m).astype(np.float64))
    rows, columns = np.nonzero(depth_m)
    np.testing.assert_allclose(uv_px, np.stack([columns, rows], axis=1), atol=1e-3)
    np.testing.assert_array_equal(z.astype(np.float32), depth_m[rows, columns])


@given(cameras(), st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(0.5, 250)))
def test_projection_is_the_camera_matrix(camera: Camera, point: tuple[float, float, float]) -> None:
    uv_px, _ = geometry.project(camera, np.array([point]))
    np.testing.assert_allclose(uv_px[0], reference.project(camera.K, point), rtol=1e-9, atol=1e-6)


@given(maps())
def test_the_map_comes_back_when_its_points_are_scattered(case: tuple[Camera, np.ndarray]) -> None:
    camera, depth_m = case
    uv_px, z = geometry.project(camera, geometry.unproject(camera, depth_m).astype(np.float64))
    np.testing.assert_array_equal(geometry.scatter_nearest(uv_px, z, camera.size), depth_m)


@given(maps())
def test_range_is_the_points_distance_and_turns_back_into_depth(case: tuple[Camera, np.ndarray]) -> None:
    camera, depth_m = case
    range_m = geometry.range_from_depth(camera, depth_m)
    distances = np.linalg.norm(geometry.unproject(camera, depth_m), axis=1)
    np.testing.assert_allclose(range_m[depth_m > 0], distances, rtol=1e-5)
    np.testing.assert_allclose(geometry.depth_from_range(camera, range_m), depth_m, rtol=1e-6)
    assert not range_m[depth_m == 0].any()


@given(maps(), st.floats(100, 4000), st.floats(0.05, 2))
def test_disparity_of_disparity_is_depth(case: tuple[Camera, np.ndarray], fx_px: float, baseline_m: float) -> None:
    _, depth_m = case
    disparity_px = geometry.convert_disparity(depth_m, fx_px, baseline_m)
    known = depth_m > 0
    np.testing.assert_allclose(disparity_px[known] * depth_m[known], fx_px * baseline_m, rtol=1e-6)
    np.testing.assert_allclose(geometry.convert_disparity(disparity_px, fx_px, baseline_m), depth_m, rtol=1e-6)


@given(cameras(), st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(0.5, 250)), st.integers(1, 5))
def test_resizing_the_camera_keeps_where_things_lie_in_the_image(
    camera: Camera, point: tuple[float, float, float], factor: int
) -> None:
    size = camera.size[0] * factor, camera.size[1]
    before, _ = geometry.project(camera, np.array([point]))
    after, _ = geometry.project(geometry.resize(camera, size), np.array([point]))
    # As a share of the image, whose left edge is at -0.5.
    share = (before[0] + 0.5) / np.array(camera.size[::-1])
    np.testing.assert_allclose((after[0] + 0.5) / np.array(size[::-1]), share, rtol=1e-9, atol=1e-9)


def test_resizing_matches_averaging_pixels() -> None:
    camera = Camera(np.array([[100.0, 0, 3.5], [0, 100.0, 1.5], [0, 0, 1]]), (4, 8))
    half = geometry.resize(camera, (2, 4))
    rays = geometry.rays(camera)
    np.testing.assert_allclose(geometry.rays(half), rays.reshape(2, 2, 4, 2, 3).mean(axis=(1, 3)), atol=1e-12)


@given(cameras(), st.integers(-5, 5), st.integers(-5, 5), st.tuples(st.floats(-50, 50), st.floats(-50, 50)))
def test_cropping_shifts_pixels(camera: Camera, top: int, left: int, xy: tuple[float, float]) -> None:
    point = np.array([[*xy, 10.0]])
    before, _ = geometry.project(camera, point)
    cropped = geometry.crop(camera, top, left, (3, 4))
    after, _ = geometry.project(cropped, point)
    np.testing.assert_allclose(after, before - [left, top], atol=1e-6)
    assert cropped.size == (3, 4)


@given(cameras(), st.integers(1, 4), st.integers(1, 4))
def test_resize_and_crop_leave_the_given_camera_alone(camera: Camera, top: int, left: int) -> None:
    K = camera.K.copy()
    geometry.resize(camera, (7, 9))
    geometry.crop(camera, top, left, (1, 1))
    np.testing.assert_array_equal(camera.K, K)


@given(poses(), hnp.arrays(np.float64, st.tuples(st.integers(0, 5), st.just(3)), elements=st.floats(-100, 100)))
def test_inverse_pose_brings_points_back(T_a_b: np.ndarray, xyz: np.ndarray) -> None:
    back = geometry.transform(geometry.invert(T_a_b), geometry.transform(T_a_b, xyz))
    np.testing.assert_allclose(back, xyz, atol=1e-8)
    np.testing.assert_allclose(geometry.invert(T_a_b) @ T_a_b, np.eye(4), atol=1e-8)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_transform_keeps_the_points_precision(dtype: type) -> None:
    assert geometry.transform(np.eye(4), np.ones((2, 3), dtype)).dtype == dtype


pixels = st.one_of(st.floats(-2, 8), st.sampled_from([-0.5, 0.5, 1.5, 2.5, 3.5, 4.5, 5.5, np.nan, np.inf, -np.inf]))


@given(st.lists(st.tuples(pixels, pixels, st.one_of(st.floats(-1, 9), st.sampled_from(EXTREMES))), max_size=30))
def test_scatter_equals_the_loop(points: list[tuple[float, float, float]]) -> None:
    table = np.array(points).reshape(-1, 3)
    result = geometry.scatter_nearest(table[:, :2], table[:, 2], (5, 6))
    np.testing.assert_array_equal(result, reference.scatter_nearest(table[:, :2], table[:, 2], (5, 6)))


def test_scatter_leaves_the_nearest_point_standing_before_an_unusable_one() -> None:
    # 1e-50 is no float32: as 0 it would have won and left a hole.
    result = geometry.scatter_nearest(np.zeros((3, 2)), np.array([7.0, 1e-50, 1e300]), (1, 1))
    assert result[0, 0] == 7


@pytest.mark.parametrize("size", [(0, 0), (0, 5), (3, 0)])
def test_scatter_into_an_empty_image(size: tuple[int, int]) -> None:
    assert geometry.scatter_nearest(np.zeros((1, 2)), np.ones(1), size).shape == size


@pytest.mark.filterwarnings("error")
def test_extreme_values_give_numbers_or_no_value() -> None:
    disparity_px = geometry.convert_disparity(np.array([EXTREMES], np.float32), 700.0, 0.5)[0]
    assert np.isfinite(disparity_px).all()
    assert (disparity_px >= 0).all()
    known = dict(zip(EXTREMES, disparity_px.tolist(), strict=True))
    assert known[1.0] == 350
    assert known[65504.0] == pytest.approx(350 / 65504)
    for nothing in (0.0, -1.0, 1e-45, np.inf):  # a denormal depth has no finite disparity
        assert known[nothing] == 0


@pytest.mark.filterwarnings("error")
def test_points_behind_or_at_the_camera_do_not_warn() -> None:
    points = np.array([[1, 1, 0], [1, 1, -5], [1e38, 0, 1e-38], [np.nan, 0, 1]], np.float32)
    _, depth_m = geometry.project(Camera(np.diag([700.0, 700, 1]), (4, 4)), points)
    np.testing.assert_array_equal(depth_m, points[:, 2])


def test_unproject_leaves_out_what_has_no_value() -> None:
    camera = Camera(np.eye(3), (1, 4))
    points = geometry.unproject(camera, np.array([[0, np.nan, -1, 2]], np.float32))
    np.testing.assert_array_equal(points, [[6, 0, 2]])
    assert geometry.unproject(Camera(np.eye(3), (0, 4)), np.zeros((0, 4), np.float32)).shape == (0, 3)
