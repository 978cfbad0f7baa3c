"""Depth and disparity metrics: equal to the loops, stable, and with a stated answer to extreme input."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import eval as loops

from eval.depth import DepthSums, has_value
from eval.stereo import DisparitySums

pytestmark = pytest.mark.filterwarnings("error")

EXTREMES = [0.0, -0.0, -1.0, math.nan, math.inf, -math.inf, 1.4e-45, 1e-38, 1e-3, 65504.0, 1e30, 3.4028235e38]
depths = st.one_of(st.floats(0.5, 120, width=32), st.sampled_from(EXTREMES))
pairs = st.lists(st.tuples(depths, depths), max_size=40)
ordinary = st.lists(st.tuples(st.floats(0.5, 120), st.floats(0.5, 120)), min_size=1, max_size=40)


def columns(rows, dtype=np.float32):
    array = np.array(rows, dtype=np.float64).reshape(-1, 2)
    return array[:, 0].astype(dtype), array[:, 1].astype(dtype)


def same(got, expected, rtol=1e-9):
    assert got.keys() == expected.keys()
    for key, value in expected.items():
        # Logarithms differ in the last bit; SILog's 100 sqrt(variance) turns that into some 1e-11.
        np.testing.assert_allclose(got[key], value, rtol=rtol, atol=1e-9, err_msg=key)


@given(pairs)
def test_depth_metrics_equal_the_loops_on_random_and_extreme_input(rows):
    p, t = columns(rows)
    same(DepthSums.over(p, t).finish(), loops.depth_metrics(p.tolist(), t.tolist()))


@given(pairs)
def test_disparity_metrics_equal_the_loops_on_random_and_extreme_input(rows):
    p, t = columns(rows)
    same(DisparitySums.over(p, t).finish(), loops.disparity_metrics(p.tolist(), t.tolist()))


@given(pairs, st.integers(0, 40))
def test_sums_of_parts_are_the_sums_of_the_whole(rows, cut):
    p, t = columns(rows)
    joined = DepthSums.over(p[:cut], t[:cut]) + DepthSums.over(p[cut:], t[cut:])
    same(joined.finish(), DepthSums.over(p, t).finish())
    disparity = DisparitySums.over(p[:cut], t[:cut]) + DisparitySums.over(p[cut:], t[cut:])
    same(disparity.finish(), DisparitySums.over(p, t).finish())


@given(ordinary, st.randoms(use_true_random=False))
def test_the_order_of_pixels_does_not_matter(rows, random):
    shuffled = list(rows)
    random.shuffle(shuffled)
    same(DepthSums.over(*columns(shuffled)).finish(), DepthSums.over(*columns(rows)).finish())


@given(ordinary, st.floats(0.01, 100))
def test_silog_does_not_see_a_scale_and_the_others_do_not_see_a_common_one(rows, scale):
    p, t = columns(rows, np.float64)
    before, scaled = DepthSums.over(p, t).finish(), DepthSums.over(scale * p, t).finish()
    assert scaled["silog"] == pytest.approx(before["silog"], rel=1e-6, abs=1e-9)
    both = DepthSums.over(scale * p, scale * t).finish()
    for key in ("abs_rel", "rmse_log", "silog", "log10"):
        assert both[key] == pytest.approx(before[key], rel=1e-6, abs=1e-9)
    for key in ("rmse", "mae", "sq_rel"):
        assert both[key] == pytest.approx(scale * before[key], rel=1e-6, abs=1e-9)


@given(ordinary)
def test_bounds(rows):
    figures = DepthSums.over(*columns(rows)).finish()
    assert 0 <= figures["delta_1"] <= figures["delta_2"] <= figures["delta_3"] <= 1
    assert figures["mae"] <= figures["rmse"] * (1 + 1e-12)
    assert figures["silog"] <= 100 * figures["rmse_log"] * (1 + 1e-12)


def test_known_values():
    p, t = np.array([10.0, 22.0, 0.0, 5.0]), np.array([8.0, 20.0, 4.0, 0.0])
    figures = DepthSums.over(p, t).finish()
    assert figures["abs_rel"] == pytest.approx((2 / 8 + 2 / 20) / 2)
    assert figures["sq_rel"] == pytest.approx((4 / 8 + 4 / 20) / 2)
    assert figures["rmse"] == figures["mae"] == 2
    assert figures["delta_1"] == 0.5  # 10 / 8 is 1.25, and the bound is strict
    assert figures["delta_2"] == 1
    assert figures["imae"] == pytest.approx(500 * ((1 / 8 - 1 / 10) + (1 / 20 - 1 / 22)))
    assert figures["silog"] == pytest.approx(50 * (math.log(1.25) - math.log(1.1)))
    assert figures["density"] == pytest.approx(2 / 3)
    assert figures["density_image"] == 0.75


def test_silog_of_a_scaled_truth_is_zero_where_the_plain_formula_cancels():
    t = np.linspace(5, 80, 10_000)
    figures = DepthSums.over(1e4 * t, t).finish()
    assert figures["silog"] < 1e-11
    g = np.log(1e4 * t) - np.log(t)
    assert 100 * np.sqrt(abs(np.mean(g**2) - np.mean(g) ** 2)) > 1e-7  # what this avoids
    halves = DepthSums.over(1e4 * t[:99], t[:99]) + DepthSums.over(1e4 * t[99:], t[99:])
    assert halves.finish()["silog"] < 1e-11


def test_d1_needs_both_three_pixels_and_five_percent():
    truth = np.array([10.0, 100.0, 100.0, 10.0, 60.0])
    prediction = truth + np.array([2.9, 4.9, 5.1, 3.1, -3.0])
    figures = DisparitySums.over(prediction, truth).finish()
    assert figures["d1"] == pytest.approx(40)
    assert figures["bad_3"] == pytest.approx(60)
    assert figures["bad_2"] == 100
    assert figures["epe"] == pytest.approx((2.9 + 4.9 + 5.1 + 3.1 + 3.0) / 5)


def test_disparities_of_depths():
    p, t = np.array([10.0, 0.0, 386.0]), np.array([12.0, 5.0, 193.0])
    expected = DisparitySums.over(386 / p[[0, 2]], 386 / t[[0, 2]])
    assert DisparitySums.over_depths(p, t, 386.0) == expected


@pytest.mark.parametrize("bad", [0.0, -3.0, math.nan, math.inf])
def test_a_prediction_without_a_value_lowers_density_and_nothing_else(bad):
    truth = np.array([5.0, 6.0, 7.0], np.float32)
    whole = DepthSums.over(truth[:2] * 1.1, truth[:2]).finish()
    holed = DepthSums.over(np.array([*(truth[:2] * 1.1), bad]), truth).finish()
    assert holed["density"] == pytest.approx(2 / 3)
    assert {k: v for k, v in holed.items() if "density" not in k} == {
        k: v for k, v in whole.items() if "density" not in k
    }


def test_nothing_to_score_is_nan_and_counts_zero():
    for size in (0, 3):
        sums = DepthSums.over(np.zeros(size), np.zeros(size))
        assert sums.count == sums.truth == 0
        figures = sums.finish()
        assert all(math.isnan(value) for key, value in figures.items() if key != "density_image")
    assert all(math.isnan(value) for value in DisparitySums.over(np.zeros(3), np.zeros(3)).finish().values())


def test_float16_and_integer_maps_are_maps():
    assert has_value(np.array([0, 65504, np.inf, np.nan], np.float16)).tolist() == [False, True, False, False]
    assert DepthSums.over(np.array([3, 0, 65535], np.uint16), np.array([3, 4, 65535])).finish()["density"] == 2 / 3


def test_real_maps_equal_the_loops(real_data):
    import cv2

    maps = real_data("kitti_depth", "train", "2011_09_26_drive_0001_sync", "proj_depth")
    raw, truth = (
        cv2.imread(str(maps / kind / "image_02" / "0000000005.png"), -1) / 256.0
        for kind in ("velodyne_raw", "groundtruth")
    )
    expected = loops.depth_metrics(raw.ravel().tolist(), truth.ravel().tolist())
    same(DepthSums.over(raw, truth).finish(), expected)
    assert 0.01 < expected["density"] < 0.3  # something was compared
