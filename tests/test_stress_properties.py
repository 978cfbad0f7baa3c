"""What holds for all numbers: metrics, projection, scale, light, losses, contraction, where the world's origin is."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.depth import DepthSums
from eval.stereo import DisparitySums
from nerf.kernels import cpu_kernels
from nerf.space import Kind, Space
from nerf.twin import space as twin
from nerf.types import BALL, CUBE, SPHERES, Samples, Target
from priors.geometry import convert_disparity, depth_from_range, project, range_from_depth, transform, unproject
from priors.origin import origin_of, without
from priors.stress.projection import camera_of

pytestmark = pytest.mark.stress
KINDS: list[Kind] = ["cube", "ball", "spheres"]
Place = tuple[float, ...]
Ray = list[tuple[float, float]]
CODES = {"cube": CUBE, "ball": BALL, "spheres": SPHERES}


def float32(least: float, most: float) -> st.SearchStrategy[float]:
    return st.floats(float(np.float32(least)), float(np.float32(most)), width=32)


depths = float32(1e-3, 1e6)
pairs = st.lists(st.tuples(st.one_of(st.just(0.0), depths), depths), min_size=2, max_size=30)
quick = settings(max_examples=40, deadline=None)


def metrics(rows: list[tuple[float, float]]) -> tuple[DepthSums, DisparitySums]:
    prediction, truth = np.array(rows, np.float32).T
    return DepthSums.over(prediction, truth), DisparitySums.over(prediction, truth)


@quick
@given(pairs, st.randoms(use_true_random=False), st.integers(1, 29))
def test_metrics_depend_on_neither_order_nor_batches(rows: list[tuple[float, float]], order, cut: int) -> None:
    shuffled = list(rows)
    order.shuffle(shuffled)
    cut = min(cut, len(rows) - 1)
    whole, mixed = metrics(rows), metrics(shuffled)
    split = [a + b for a, b in zip(metrics(rows[:cut]), metrics(rows[cut:]), strict=True)]
    for one, two, three in zip(whole, mixed, split, strict=True):
        figures, others, joined = one.finish(), two.finish(), three.finish()
        size = max(1.0, abs(getattr(one, "log_mean", 0.0)))
        for name, value in figures.items():
            tolerance = 1e-6 * size if name in ("silog", "rmse_log") else 1e-12
            assert others[name] == pytest.approx(value, rel=1e-9, abs=tolerance, nan_ok=True), name
            assert joined[name] == pytest.approx(value, rel=1e-9, abs=tolerance, nan_ok=True), name


@quick
@given(st.lists(st.tuples(st.floats(1, 80), st.floats(1, 80)), min_size=1, max_size=20), st.floats(0.1, 10))
def test_a_change_of_unit_scales_what_has_a_unit(rows: list[tuple[float, float]], scale: float) -> None:
    prediction, truth = np.array(rows).T
    one, two = (DepthSums.over(k * prediction, k * truth).finish() for k in (1.0, scale))
    for name, power in {"abs_rel": 0, "silog": 0, "rmse_log": 0, "rmse": 1, "mae": 1, "sq_rel": 1, "irmse": -1}.items():
        assert two[name] == pytest.approx(one[name] * scale**power, rel=1e-9, abs=1e-6), name


@quick
@given(st.lists(depths, min_size=12, max_size=12))
def test_unprojected_maps_are_projected_to_where_they_were(values: list[float]) -> None:
    depth_m, camera = np.array(values, np.float32).reshape(3, 4), camera_of((3, 4))
    uv_px, back_m = project(camera, unproject(camera, depth_m))
    v, u = np.indices((3, 4)).reshape(2, -1)
    np.testing.assert_allclose(uv_px, np.stack([u, v], axis=1), atol=1e-5)
    np.testing.assert_allclose(back_m, depth_m.ravel(), rtol=1e-6)
    np.testing.assert_allclose(depth_from_range(camera, range_from_depth(camera, depth_m)), depth_m, rtol=1e-6)


@quick
@given(depths, st.floats(10, 2000), st.floats(0.05, 2), st.floats(0.5, 4))
def test_depth_follows_the_baseline_and_the_focal_length(depth_m: float, fx_px: float, base_m: float, k: float) -> None:
    map_ = np.array([[depth_m]], np.float32)
    there = convert_disparity(map_, fx_px, base_m)
    assert convert_disparity(there, fx_px, base_m)[0, 0] == pytest.approx(depth_m, rel=1e-6)
    assert convert_disparity(map_, fx_px * k, base_m)[0, 0] == pytest.approx(k * float(there[0, 0]), rel=1e-5)
    assert convert_disparity(map_, fx_px, base_m * k)[0, 0] == pytest.approx(k * float(there[0, 0]), rel=1e-5)


def a_ray(sigma: list[float], lengths_m: list[float]) -> tuple[Samples, torch.Tensor]:
    count, dt_m = len(sigma), torch.tensor(lengths_m)
    ends = dt_m.double().cumsum(0).float()
    room, reach = torch.zeros(count), float(ends[-1])
    samples = Samples(
        torch.tensor([0, count]), room.int(), ends - dt_m / 2, dt_m, (ends - dt_m) / reach, ends / reach,
        torch.zeros(count, 3), room.int(), count,
    )  # fmt: skip
    return samples, torch.tensor(sigma)


densities = st.one_of(st.just(0.0), float32(1e-38, 1e30))
rays = st.lists(st.tuples(densities, float32(1e-3, 1e6)), min_size=1, max_size=30)


@quick
@given(rays)
def test_weights_sum_to_one_at_most_and_transmittance_never_rises(ray: Ray) -> None:
    samples, sigma = a_ray([each for each, _ in ray], [length for _, length in ray])
    made = cpu_kernels().render.forward(samples, sigma, torch.ones(len(ray), 3), torch.zeros(1, 3))
    assert (made.weights >= 0).all()
    assert float(made.weights.double().sum()) <= 1 + 1e-6
    left = [1.0]
    for used in range(1, len(ray) + 1):
        cut, _ = a_ray([each for each, _ in ray[:used]], [length for _, length in ray[:used]])
        part = cpu_kernels().render.forward(cut, sigma[:used], torch.ones(used, 3), torch.zeros(1, 3))
        left.append(float(part.transmittance))
    assert all(after <= before for before, after in pairwise(left))


@quick
@given(rays, float32(1e-3, 1e6), float32(1e-3, 1e5))
def test_kl_and_the_line_of_sight_are_never_nan(ray: Ray, prior_m: float, deviation_m: float) -> None:
    samples, sigma = a_ray([each for each, _ in ray], [length for _, length in ray])
    target, slopes = Target(*(torch.tensor([x]) for x in (1.0, prior_m, deviation_m))), torch.zeros(len(ray))
    kernels = cpu_kernels().render
    made = kernels.forward(samples, sigma, torch.ones(len(ray), 3), torch.zeros(1, 3))
    for value, loss in ((sigma, kernels.kl), (made.weights, kernels.sight)):
        assert not torch.isnan(loss(samples, value, target, torch.ones(1), slopes)).any()
        assert not torch.isnan(slopes).any()


offsets = st.tuples(*[st.integers(-500_000, 500_000)] * 3)
places = st.tuples(*[st.floats(-1e6, 1e6)] * 3)


@pytest.mark.parametrize("kind", KINDS)
@quick
@given(places, places)
def test_contraction_is_continuous_bounded_and_undone(kind: Kind, one: Place, way: Place) -> None:
    space = Space(kind, (0.0, 0.0, 0.0), (20.0, 10.0, 8.0), 0.5, 1e7)
    step_m = 1e-3 * np.array(way) / max(math.hypot(*way), 1e-9)
    points = torch.from_numpy(np.stack([np.array(one), np.array(one) + step_m]))
    u, table = space.warp(points)
    assert (u >= 0).all() and (u <= 1).all()
    if table[0] == table[1]:  # the two tables of spheres are two maps
        moved = float((u[1] - u[0]).norm())
        assert moved <= 1e-3 * 3**0.5 / min(space.half_m) * (1 if kind == "spheres" else 0.5) + 1e-15
    torch.testing.assert_close(space.unwarp(u, table), points, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_contraction_is_continuous_across_the_border(kind: Kind) -> None:
    directions = torch.nn.functional.normalize(torch.randn(200, 3, dtype=torch.float64), dim=1)
    border = directions / twin.size(directions, CODES[kind])[:, None]
    inside, outside = (twin.warp(border * k, CODES[kind])[0] for k in (1 - 1e-9, 1 + 1e-9))
    if kind == "spheres":
        inside = (inside * 2 - 1) / 4 + 0.5  # where the outer table has it
    torch.testing.assert_close(inside, outside, rtol=0, atol=2e-9)


@quick
@given(
    st.tuples(*[st.integers(-500_000, 500_000)] * 3),
    st.lists(st.tuples(*[st.floats(-200, 200)] * 3), min_size=2, max_size=8),
)
def test_a_translation_of_the_world_changes_no_place(offset_m: Place, path: list[Place]) -> None:
    near = np.tile(np.eye(4), (len(path), 1, 1))
    near[:, :3, 3] = path
    far = near.copy()
    far[:, :3, 3] += offset_m
    spaces, points = [], []
    for poses in (near, far):
        own = without(origin_of(poses), poses)
        spaces.append(Space.along(own, "cube"))
        points.append(torch.from_numpy(own[:, :3, 3].astype(np.float32)))
    (one, _), (two, _) = (space.warp(xyz) for space, xyz in zip(spaces, points, strict=True))
    assert float((one - two).abs().max()) < 1e-3
    seen = transform(np.linalg.inv(far[0]), far[:, :3, 3])
    np.testing.assert_allclose(seen, transform(np.linalg.inv(near[0]), near[:, :3, 3]), atol=1e-3)
