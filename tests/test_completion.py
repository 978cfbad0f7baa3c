"""Completion: planes, edges, what the camera cannot see, any number of samples, bad input, and the real figures."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from conftest import RealData
from hypothesis import example, given, settings
from hypothesis import strategies as st
from reference import completion as reference

from eval.protocol import preset
from eval.result import Result, score
from priors.bench.baselines import fill
from priors.drives import open_drive
from priors.errors import DataError
from priors.kernels import plane_propagation
from priors.kernels import sparse_samples as kernels
from priors.methods.completion import GENTLE, Completion, complete
from priors.methods.lidar import Lidar
from priors.records import record, upgrade
from priors.types import Camera, Depth, Frame, Sweep

Map = npt.NDArray[np.float32]
F = np.float32
SIZE = (120, 400)
CAMERA = Camera(np.array([[720.0, 0, 200], [0, 720, 40], [0, 0, 1]]), SIZE)
T_CAM_LIDAR = np.array([[0, -1.0, 0, 0.06], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]])
ABOVE = np.array([[0, -1.0, 0, 0], [0, 0, -1, -0.6], [1, 0, 0, 0], [0, 0, 0, 1]])
GREY = np.full((*SIZE, 3), 128, np.uint8)


def lines(depth_m: Map, down: int = 5, across: int = 2) -> Map:
    """Sample a dense map on scan lines."""
    sparse = np.zeros_like(depth_m)
    sparse[2::down, ::across] = depth_m[2::down, ::across]
    return sparse


def ground(height_m: float = 1.65, tilt: float = 0.1, size: tuple[int, int] = SIZE) -> Map:
    """A road seen from above it, rolled a little: linear in inverse depth; 5 to 150 m."""
    row, column = np.mgrid[: size[0], : size[1]]
    return (720 * height_m / (row + 8 + tilt * column)).astype(F)


def random_samples(
    seed: int, size: tuple[int, int] = (20, 30)
) -> tuple[kernels.SparseSamples, list[tuple[int, int, float]]]:
    rng = np.random.default_rng(seed)
    sparse = np.where(rng.random(size) < 0.15, rng.choice([4, 5, 20, 40], size) * rng.uniform(1, 1.1, size), 0)
    found = kernels.list_samples(sparse.astype(F))
    return found, list(zip(found[1].tolist(), found[2].tolist(), found[3].astype(float).tolist(), strict=True))


# --- kernels against loops


@pytest.mark.parametrize("seed", range(4))
def test_covered_is_the_reference(seed: int) -> None:
    samples, listed = random_samples(seed)
    rng = np.random.default_rng(seed)
    pull_y, pull_x = (rng.uniform(-40, 40, len(listed)).astype(F) for _ in range(2))
    everything = np.full((5, 8), 1e9, F)
    got = kernels.covered(*samples, pull_y, pull_x, 5.0, 4.0, 6, 7, 1.1, everything, 4)
    want = reference.covered(listed, pull_y, pull_x, 5, 4, 6, 7, 1.1)
    assert 0 < np.count_nonzero(want) < len(want)
    np.testing.assert_allclose(got, want, atol=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_slopes_are_the_reference(seed: int) -> None:
    samples, listed = random_samples(seed)
    tolerance = (0.1 * samples[3] + 0.01).astype(F)
    got = np.transpose(kernels.slopes(*samples, 6, 7, tolerance, F(1), 1))
    np.testing.assert_allclose(got, reference.slopes(listed, 6, 7, tolerance, 1), rtol=2e-3, atol=1e-6)


def test_samples_in_a_row_share_a_slope() -> None:
    samples = kernels.list_samples(lines(ground()))
    tolerance = (0.1 * samples[3] + 0.01).astype(F)
    alone, shared = (kernels.slopes(*samples, 6, 4, tolerance, F(1), share)[0] for share in (1, 3))
    changes = [np.count_nonzero(np.diff(slope)) for slope in (alone, shared)]
    assert changes[1] < 0.5 * changes[0]
    assert np.median(np.abs(shared - alone) / np.abs(alone)) < 0.03


@pytest.mark.parametrize("runs", [1, 2])
def test_spread_is_the_reference(runs: int) -> None:
    samples, listed = random_samples(7)
    samples = (samples[0], samples[1][:12], samples[2][:12], samples[3][:12])  # leave holes
    listed, rng, pad = listed[:12], np.random.default_rng(7), 16
    slope = rng.normal(0, 1e-3, (2, 12)).astype(F)
    handicap = rng.uniform(0, 0.3, 12).astype(F)
    guide = rng.integers(0, 255, (20, 30), dtype=np.uint8)
    scale = 0.02, 0.01, 6e-4
    coarse, sure = rng.uniform(0.01, 0.2, (2, 4, 5)).astype(F)
    want = reference.spread(listed, slope.T, handicap, guide, 4, 8 * runs, *scale, 0.05, 5e-4)
    padded = np.pad(guide, pad)
    cost, value, top, bottom = (np.zeros(padded.shape, F) for _ in range(4))
    cost.fill(plane_propagation.NOTHING)
    planes = (samples[1] + pad, samples[2] + pad, samples[3], *slope, handicap, 4, runs)
    plane_propagation.assign(*planes, F(scale[0]), F(scale[1]), padded, F(scale[2]), cost, value)
    inside = slice(pad, -pad), slice(pad, -pad)
    seen = np.isfinite(want[0])
    assert seen.any() and not seen.all()
    np.testing.assert_allclose(cost[inside][seen], want[0][seen], rtol=1e-4)
    np.testing.assert_allclose(value[inside][seen], want[1][seen], rtol=1e-4)
    plane_propagation.average(*planes, F(scale[0]), F(scale[1]), value, F(0.05), F(5e-4), top, bottom)
    plane_propagation.fill_holes(cost, top, bottom, pad, coarse, sure, 0, 6)
    dense, certain = reference.settle(want[0], want[2], coarse, sure, 6)
    np.testing.assert_allclose(top[inside], dense, rtol=1e-3)
    np.testing.assert_allclose(cost[inside], certain, rtol=1e-3)


def test_spacing_of_lines_and_of_random_points() -> None:
    found = kernels.list_samples(lines(ground(), 5, 2))
    assert kernels.gaps(*found[:3], 48, 1) == (5, 2)
    rng = np.random.default_rng(0)
    down, across = kernels.gaps(*kernels.list_samples(np.where(rng.random((300, 300)) < 0.01, F(9), F(0)))[:3], 48, 1)
    assert 0.6 < down / across < 1.7 and 4 < down < 20


# --- scenes


@pytest.mark.parametrize("down", [5, 10, 20])
def test_plane_is_kept(down: int) -> None:
    true_m = ground()
    got = complete(lines(true_m, down), GREY, CAMERA)
    inner = np.abs(got.depth_m / true_m - 1)[2 * down : -2 * down, 8:-8]
    assert inner.max() < 0.005 * down and np.median(inner) < 0.002
    morphed = np.abs(fill(lines(true_m, down)) / true_m - 1)[2 * down : -2 * down, 8:-8]
    assert np.median(inner) < 0.2 * np.median(morphed)


def test_wall_is_exact() -> None:
    got = complete(lines(np.full(SIZE, 12.5, F)), GREY, CAMERA)
    np.testing.assert_allclose(got.depth_m, 12.5, rtol=1e-5)
    assert got.depth_m.dtype == F and got.confidence is not None and got.confidence.dtype == F


def test_mirrored_input_gives_the_mirrored_map() -> None:
    rng = np.random.default_rng(3)
    true_m = np.where(np.arange(SIZE[1]) < 150, 10.0, ground()).astype(F)
    sparse = np.where(rng.random(SIZE) < 0.05, true_m, F(0))
    image = rng.integers(0, 255, (*SIZE, 3), dtype=np.uint8)
    here = complete(sparse, image, CAMERA).depth_m
    there = complete(np.fliplr(sparse), np.fliplr(image), CAMERA).depth_m[:, ::-1]
    assert np.mean(np.abs(here / there - 1) < 0.01) > 0.97


def test_edge_follows_the_image() -> None:
    rng = np.random.default_rng(5)
    near = np.arange(SIZE[1]) < 203
    true_m = np.broadcast_to(np.where(near, 10.0, 30.0), SIZE).astype(F)
    sparse = np.where(rng.random(SIZE) < 0.02, true_m, F(0))
    image = np.broadcast_to(np.where(near, 60, 190)[None, :, None], (*SIZE, 3)).astype(np.uint8)
    wrong = {g: np.mean(np.abs(complete(sparse, image, CAMERA, None, g).depth_m - true_m) > 5) for g in (0.0, 1.0)}
    assert wrong[1.0] < 0.25 * wrong[0.0]
    sharp = complete(sparse, image, CAMERA).depth_m[:, 190:216]
    assert np.mean((sharp > 11) & (sharp < 28)) < 3 / 26  # no more than the blur's width lies between the two


def past_a_box() -> tuple[Map, Map]:
    """A box at 12 m, a wall at 30 m: what a scanner 0.6 m above the camera measures, and what the camera sees."""
    row, column = np.mgrid[: SIZE[0], : SIZE[1]]
    shown = np.where((column >= 60) & (column < 180) & (row >= 30), F(12), F(30))
    drop_px = 720 * 0.6 * (1 / 12 - 1 / 30)  # against the wall, the scanner sees the box's upper edge that much lower
    measured = ~((column >= 60) & (column < 180) & (row >= 30 + drop_px))
    sparse = np.zeros(SIZE, F)
    sparse[::9, ::6] = np.where(shown == 12, F(12), F(0))[::9, ::6]  # dark paint: few returns
    sparse[2::5, 1::2] = np.where(measured, F(30), F(0))[2::5, 1::2]
    return sparse, shown


def test_samples_seen_past_an_edge_are_dropped() -> None:
    sparse, shown = past_a_box()
    assert np.count_nonzero((sparse == 30) & (shown == 12)) > 100
    blind, seeing = (complete(sparse, GREY, CAMERA, T).depth_m for T in (None, ABOVE))
    wrong = [np.mean(depth_m[shown == 12] > 15) for depth_m in (blind, seeing)]
    assert wrong[0] > 0.1 and wrong[1] < 0.6 * wrong[0]
    lost = [np.mean(depth_m[shown == 30] < 20) for depth_m in (blind, seeing)]
    assert lost[1] < lost[0] + 0.005  # the wall beside the box stays


def test_surface_without_parallax_is_not_dropped() -> None:
    """A far fence in front of a wall: the scanner sees through its gaps what the camera sees through them too."""
    wall = lines(np.full(SIZE, 80.0, F))
    fence = np.zeros(SIZE, bool)
    fence[:, ::12] = True
    sparse = np.where(fence & (wall > 0), F(60), wall)
    a, b = (complete(sparse, GREY, CAMERA, T).depth_m for T in (None, T_CAM_LIDAR))
    np.testing.assert_array_equal(a, b)


def test_confidence_falls_away_from_samples_and_at_edges() -> None:
    true_m = np.broadcast_to(np.where(np.arange(SIZE[1]) < 200, 8.0, 30.0), SIZE).astype(F)
    sparse = lines(true_m)
    sparse[40:100, 260:340] = 0
    got = complete(sparse, GREY, CAMERA)
    assert got.confidence is not None
    surface, edge, hole = got.confidence[:, 40:120], got.confidence[:, 196:204], got.confidence[60:80, 290:310]
    assert edge.min(axis=1).max() < 0.8 * np.median(surface) and hole.max() < 0.6 * np.median(got.confidence[:, 360:])


# --- any number of samples


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (5, 4), (33, 17), (120, 397)])
@pytest.mark.parametrize("shape", [(), (3,)])
def test_small_and_grey_images(size: tuple[int, int], shape: tuple[int, ...]) -> None:
    sparse = np.full(size, 7.0, F)
    got = complete(sparse, np.zeros((*size, *shape), np.uint8), Camera(CAMERA.K, size), T_CAM_LIDAR)
    np.testing.assert_allclose(got.depth_m, 7, rtol=1e-5)


def test_no_sample_gives_no_value() -> None:
    got = complete(np.zeros(SIZE, F), GREY, CAMERA, T_CAM_LIDAR)
    assert not got.depth_m.any() and got.confidence is not None and not got.confidence.any()


def test_one_sample_reaches_as_far_as_told() -> None:
    sparse = np.zeros(SIZE, F)
    sparse[60, 200] = 9
    got = complete(sparse, GREY, CAMERA, T_CAM_LIDAR, reach_px=40)
    row, column = np.nonzero(got.valid)
    away = np.hypot(row - 60, column - 200)
    assert 34 < away.max() < 50 and np.count_nonzero(got.valid) > 0.8 * np.pi * 34**2
    np.testing.assert_allclose(got.depth_m[got.valid], 9, rtol=1e-5)
    assert got.confidence is not None and got.confidence[60, 200] == got.confidence.max()
    assert np.count_nonzero(complete(sparse, GREY, CAMERA, reach_px=0).depth_m) <= 16


def test_one_line_of_samples() -> None:
    sparse = np.zeros(SIZE, F)
    sparse[60, ::3] = ground()[60, ::3]
    got = complete(sparse, GREY, CAMERA, T_CAM_LIDAR)
    np.testing.assert_allclose(got.depth_m[60, 10:-10], ground()[60, 10:-10], rtol=0.02)
    assert np.isfinite(got.depth_m).all() and got.valid[30:90].all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -5.0, 0.0, 1e-40, 1e-6, 1e30, 65504.0])
def test_impossible_samples_are_left_out(bad: float) -> None:
    sparse = lines(ground())
    clean = complete(sparse, GREY, CAMERA, T_CAM_LIDAR)
    sparse[3::5, 1::2] = bad
    got = complete(sparse, GREY, CAMERA, T_CAM_LIDAR)
    np.testing.assert_array_equal(got.depth_m, clean.depth_m)


@settings(deadline=None, max_examples=40)
@example(seed=9090412, count=4, size=(5, 36), range_m=(1.1e-3, 9.9e3))  # planes through four samples run below 0
@given(
    seed=st.integers(0, 2**31),
    count=st.integers(0, 300),
    size=st.tuples(st.integers(1, 60), st.integers(1, 90)),
    range_m=st.sampled_from([(1.1e-3, 9.9e3), (2.0, 80.0), (0.01, 0.02)]),
)
def test_values_stay_between_the_samples(
    seed: int, count: int, size: tuple[int, int], range_m: tuple[float, float]
) -> None:
    rng = np.random.default_rng(seed)
    sparse = np.zeros(size, F)
    row, column = rng.integers(0, size[0], count), rng.integers(0, size[1], count)
    sparse[row, column] = np.exp(rng.uniform(*np.log(range_m), count))
    image = rng.integers(0, 255, (*size, 3), dtype=np.uint8)
    got = complete(sparse, image, Camera(CAMERA.K, size), T_CAM_LIDAR)
    assert got.depth_m.shape == size and got.confidence is not None
    assert np.isfinite(got.depth_m).all() and np.isfinite(got.confidence).all()
    assert (got.confidence >= 0).all() and (got.confidence <= 1).all()
    np.testing.assert_array_equal(got.valid, got.confidence > 0)
    if got.valid.any():
        assert got.depth_m[got.valid].min() >= 0.79 * sparse[sparse > 0].min()
        assert got.depth_m.max() <= 1.26 * sparse.max()


def test_input_is_left_alone_and_threads_agree() -> None:
    rng = np.random.default_rng(1)
    inputs = [
        np.where(rng.random(size) < 0.05, F(9) + rng.random(size, F), F(0)) for size in [SIZE, (60, 90), SIZE] * 3
    ]

    def fill(sparse: Map) -> Map:
        image = np.full(sparse.shape, 90, np.uint8)
        return complete(sparse, image, Camera(CAMERA.K, (sparse.shape[0], sparse.shape[1])), T_CAM_LIDAR).depth_m

    before = [sparse.copy() for sparse in inputs]
    alone = [fill(sparse) for sparse in inputs]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(fill, inputs))
    for a, b, c, d in zip(alone, together, inputs, before, strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(c, d)


# --- the method


def frame(**readers: Any) -> Frame:
    return Frame(id="7", camera=CAMERA, readers={"image": lambda: GREY, **readers}, T_cam_lidar=T_CAM_LIDAR)


def test_source_follows_what_the_frame_has() -> None:
    with_maps = frame(sparse=lambda: Depth(lines(ground())))
    assert Completion().resolve(with_maps).source == "velodyne_raw"
    assert Completion(source="lidar").resolve(with_maps).source == "lidar"
    assert Completion().resolve(frame()).source == "lidar"
    want = complete(lines(ground()), GREY, CAMERA, T_CAM_LIDAR)
    np.testing.assert_array_equal(Completion()(with_maps).depth_m, want.depth_m)


def test_lidar_source_fills_the_lidar_methods_map() -> None:
    rng = np.random.default_rng(2)
    xyz = np.stack([np.full(4000, 20.0), rng.uniform(-5, 5, 4000), rng.uniform(-2, 1, 4000)], axis=1).astype(F)
    with_sweep = frame(sweep=lambda offset=0: Sweep(xyz, None) if offset == 0 else None)
    config = Completion(lidar=Lidar(sweeps=3)).resolve(with_sweep)
    assert config.lidar.sweeps == 1  # no poses
    got = config(with_sweep)
    assert got.density > 0.9
    np.testing.assert_allclose(got.depth_m[got.valid], 20 - 0.27, rtol=1e-3)


def test_a_sweep_is_cleaned_gently() -> None:
    """Of a box before a wall: samples beside the outline stay, and what the scanner sees past it goes by its place."""
    rng = np.random.default_rng(3)
    ahead = np.stack([np.full(6000, 20.0), rng.uniform(-5, 5, 6000), rng.uniform(-2, 1, 6000)], axis=1)
    ahead[np.abs(ahead[:, 1]) < 1, 0] = 8.0
    read = {"sweep": lambda offset=0: Sweep(ahead.astype(F), None) if offset == 0 else None}
    alone, posed = frame(**read), replace(frame(**read), T_world_cam=np.eye(4))
    for one, place in ((alone, T_CAM_LIDAR), (posed, None)):
        gentle = Completion().resolve(one)
        sparse_m = gentle.lidar.look(one, GENTLE).depth_m
        assert (sparse_m > 0).sum() > (gentle.lidar(one).depth_m > 0).sum()
        want = complete(sparse_m, GREY, CAMERA, place).depth_m
        np.testing.assert_array_equal(gentle(one).depth_m, want)
        full = replace(gentle, cleaning="full")
        as_before = complete(gentle.lidar(one).depth_m, GREY, CAMERA).depth_m
        np.testing.assert_array_equal(full(one).depth_m, as_before)
        assert not np.array_equal(full(one).depth_m, want)


def test_a_network_gets_a_single_sweep_without_the_test_by_stereo() -> None:
    """A pair that sees a wall at 8 m takes points at 20 m from all others: several sweeps, the fill, full cleaning."""
    ahead = np.stack([np.full(6000, 20.0), *np.random.default_rng(3).uniform((-5, -2), (5, 1), (6000, 2)).T], axis=1)
    read = {"sweep": lambda offset=0: Sweep(ahead.astype(F), None) if offset == 0 else None}
    noise = cv2.GaussianBlur(np.random.default_rng(4).integers(0, 255, GREY.shape).astype(np.uint8), (0, 0), 1)
    shifted = np.roll(noise, -round(CAMERA.fx * 0.5 / 8), axis=1)
    paired = replace(frame(**read, image=lambda: noise, other=lambda: shifted), baseline_m=0.5)
    posed = replace(paired, T_world_cam=np.eye(4))

    def shown(config: Completion, one: Frame = paired) -> int:
        return int((config.resolve(one)._samples(one)[0] > 0).sum())

    network = Completion(model="mffnet")
    assert shown(network) == shown(replace(network, lidar=Lidar(stereo=False))) > 0
    tested = (shown(Completion()), shown(replace(network, cleaning="full")), shown(network, posed))
    assert max(tested) < 0.6 * shown(network)


def test_maps_of_before_are_found_where_cleaning_decides_nothing() -> None:
    """A record that lacks the field cleaned in full; so is one of maps that no cleaning touched."""
    posed = replace(frame(sweep=lambda offset=0: None), T_world_cam=np.eye(4))
    maps = frame(sparse=lambda: Depth(lines(ground())))
    for one, wish in ((maps, Completion()), (posed, Completion(lidar=Lidar(occlusion=False)))):
        today = record(wish.resolve(one))
        assert upgrade(Completion, {k: v for k, v in today.items() if k != "cleaning"}) == today
    assert Completion().resolve(posed).cleaning == "gentle"


def test_what_is_missing_is_named() -> None:
    with pytest.raises(DataError, match="frame 7"):
        Completion()(frame())
    with pytest.raises(DataError, match="frame 7"):
        Completion(source="velodyne_raw")(frame())


@pytest.mark.parametrize("flags", [{"guidance": -1.0}, {"guidance": np.nan}, {"guidance": np.inf}, {"reach_px": -1}])
def test_bad_flags_are_refused(flags: dict[str, Any]) -> None:
    with pytest.raises(DataError, match=r"--completion\.\S+ \S+: expected (0 or more|a whole number from 0)"):
        Completion(**flags)


def test_sizes_must_agree() -> None:
    with pytest.raises(DataError, match="differ in size"):
        complete(np.ones((4, 4), F), GREY, CAMERA)


# --- real frames


def real_scores(folder: Path, keep: float | None = None) -> dict[str, Result]:
    drive = open_drive(folder)
    frames = [f for f in (drive[i] for i in range(len(drive))) if f.has("sparse") and f.has("truth")]
    scored: dict[str, list[Any]] = {"recipe": [], "completion": []}
    for f in frames:
        sparse_m, truth_m = f.sparse().depth_m, f.truth().depth_m
        depth = Completion()(f)
        if keep is not None:
            assert depth.confidence is not None
            depth = depth.keep(depth.confidence > np.quantile(depth.confidence[truth_m > 0], 1 - keep))
        scored["completion"].append((f.id, depth.depth_m, None, truth_m))
        scored["recipe"].append((f.id, fill(sparse_m), None, truth_m))
    return {name: score(rows, preset("paper"), info={"prior": name}) for name, rows in scored.items()}


def test_better_than_the_recipe_on_every_metric(real_data: RealData) -> None:
    folder = real_data("kitti_raw", "2011_09_26", "2011_09_26_drive_0001_sync")
    real_data("kitti_depth")
    scores = real_scores(folder)
    ours, theirs = scores["completion"].metrics(), scores["recipe"].metrics()
    assert ours["density"] == 1
    for name in ("abs_rel", "sq_rel", "rmse", "rmse_log", "silog", "log10", "mae", "irmse", "imae"):
        assert ours[name] < theirs[name], name
    for name in ("delta_1", "delta_2"):
        assert ours[name] > theirs[name], name
    assert ours["delta_3"] > 0.99995  # both: 35 and 18 of 1,077,122 pixels are off by that much, at outlines
    assert ours["abs_rel"] < 0.011 and ours["rmse"] < 0.9 and ours["mae"] < 0.235


def test_confidence_sorts_real_errors(real_data: RealData) -> None:
    folder = real_data("kitti_raw", "2011_09_26", "2011_09_26_drive_0001_sync")
    real_data("kitti_depth")
    whole, sure = (real_scores(folder, keep)["completion"].metrics() for keep in (None, 0.9))
    assert 0.88 < sure["density"] < 0.92
    assert sure["rmse"] < 0.7 * whole["rmse"] and sure["abs_rel"] < 0.9 * whole["abs_rel"]
