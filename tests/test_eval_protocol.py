"""Protocols: crops to the pixel, caps, fills and alignments."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from reference import eval as loops

from eval.depth import DepthSums
from eval.protocol import PRESETS, Protocol, ScoreError, align, crop_window, fill_rows, preset

pytestmark = pytest.mark.filterwarnings("error")

SIZE = (12, 15)
# Rows and columns of a 375x1242 image, counted from the published fractions by hand: 0.40810811 * 375 = 153.04, ...
KITTI_CROPS = {
    "none": (0, 375, 0, 1242),
    "garg": (153, 371, 44, 1197),
    "eigen": (124, 342, 44, 1197),
    "kb": (23, 375, 13, 1229),
}
odd = np.array([0.0, math.nan, math.inf, 1e-3, 80.0, 79.99, 1e30, 1.4e-45], np.float32)
values = st.one_of(st.floats(0.5, 100, width=32), st.sampled_from(odd.tolist()))
maps = hnp.arrays(np.float32, SIZE, elements=values)
gappy = hnp.arrays(np.float64, (6, 9), elements=st.sampled_from([0.0, 0.0, 0.0, 3.0, 5.0, 9.0]))


@pytest.mark.parametrize("crop", KITTI_CROPS)
def test_crops_of_a_kitti_image_to_the_pixel(crop):
    rows, columns = crop_window(crop, (375, 1242))
    assert (rows.start, rows.stop, columns.start, columns.stop) == KITTI_CROPS[crop]


def test_the_kb_crop_of_other_kitti_sizes():
    assert crop_window("kb", (370, 1226)) == (slice(18, 370), slice(5, 1221))
    assert crop_window("kb", (352, 1216)) == (slice(0, 352), slice(0, 1216))
    assert crop_window("kb", (376, 1241)) == (slice(24, 376), slice(12, 1228))


def test_an_image_smaller_than_the_kb_crop_is_refused():
    with pytest.raises(ScoreError, match=r"kb needs at least 352x1216 pixels, found 120x397"):
        crop_window("kb", (120, 397))


@pytest.mark.parametrize("name", ["paper", "uncapped", "garg", "eigen"])
@given(maps, maps)
def test_presets_score_what_the_loops_score(name, prediction, truth):
    protocol = PRESETS[name]
    ready = protocol.prepare(prediction, truth)
    fractions = {"garg": (0.40810811, 0.99189189, 0.03594771, 0.96405229)}
    fractions["eigen"] = (0.3324324, 0.91351351, 0.0359477, 0.96405229)
    top, bottom, left, right = fractions.get(name, (0, 1, 0, 1))
    expected = loops.depth_metrics(
        *loops.scored_pairs(
            prediction.tolist(),
            truth.tolist(),
            lambda h, w: (int(top * h), int(bottom * h), int(left * w), int(right * w)),
            protocol.min_m,
            protocol.max_m or math.inf,
            protocol.clamp,
        )
    )
    got = DepthSums.over(ready.prediction_m, ready.truth_m, ready.own).finish()
    for key, value in expected.items():
        np.testing.assert_allclose(got[key], value, rtol=1e-9, atol=1e-9, err_msg=key)


def test_the_cap_is_on_the_truth_and_the_clamp_on_the_prediction():
    truth = np.array([[0.0005, 0.001, 0.0011, 79.9, 80.0, 81.0]])
    prediction = np.array([[5.0, 5.0, 1e-6, 200.0, 5.0, 5.0]])
    ready = preset("paper").prepare(prediction, truth)
    assert ready.truth_m.tolist() == [[0, 0, 0.0011, 79.9, 0, 0]]
    assert ready.prediction_m[0, 2:4].tolist() == [1e-3, 80.0]
    bare = preset("uncapped").prepare(prediction, truth)
    assert bare.truth_m.tolist() == truth.tolist()
    assert bare.prediction_m.tolist() == prediction.tolist()


@given(gappy)
def test_fills_equal_the_loops(depth_m):
    assert fill_rows(depth_m, "fill_near").tolist() == loops.fill_rows(depth_m.tolist(), min)
    assert fill_rows(depth_m, "fill_far").tolist() == loops.fill_rows(depth_m.tolist(), max)


def test_filled_pixels_count_as_errors_but_not_as_density():
    prediction, truth = np.array([[4.0, 0.0, 0.0, 10.0]]), np.array([[4.0, 5.0, 0.0, 10.0]])
    near, far = (PRESETS[name].prepare(prediction, truth) for name in ("kitti-completion", "stereo2015"))
    assert near.prediction_m.tolist() == [[4, 4, 4, 10]]
    assert far.prediction_m.tolist() == [[4, 10, 10, 10]]
    sums = DepthSums.over(near.prediction_m, near.truth_m, near.own)
    assert (sums.count, sums.covered, sums.truth, sums.values) == (3, 2, 3, 2)
    assert sums.finish()["mae"] == pytest.approx(1 / 3)


positive = st.lists(st.tuples(st.floats(1, 90), st.floats(1, 90)), min_size=2, max_size=20)


@given(positive, st.sampled_from(["median", "lsq"]))
def test_alignments_equal_the_loops_and_are_idempotent(rows, how):
    p, t = np.array(rows).T
    if how == "lsq" and np.ptp(p) < 1e-3:
        return  # no slope to speak of; the constant case has its own test
    fitted = align(p, t, how)
    np.testing.assert_allclose(fitted, loops.align(p.tolist(), t.tolist(), how), rtol=1e-6, atol=1e-6)
    if (fitted > 1e-3).all() and np.ptp(fitted) > 1e-3:
        np.testing.assert_allclose(align(fitted, t, how), fitted, rtol=1e-6, atol=1e-6)


@given(positive, st.floats(0.1, 10))
def test_median_alignment_forgets_the_scale(rows, scale):
    p, t = np.array(rows).T
    np.testing.assert_allclose(align(scale * p, t, "median"), align(p, t, "median"), rtol=1e-9)


def test_least_squares_finds_scale_and_shift_again():
    t = np.array([4.0, 9.0, 20.0, 0.0, 50.0])
    p = np.array([3.0, 5.5, 11.0, 7.0, 26.0])  # t = 2 p - 2
    np.testing.assert_allclose(align(p, t, "lsq"), [4, 9, 20, 12, 50])
    ready = Protocol("x", align="lsq").prepare(p[None], t[None])
    assert DepthSums.over(ready.prediction_m, ready.truth_m).finish()["rmse"] == pytest.approx(0, abs=1e-12)


def test_least_squares_on_a_constant_only_shifts_and_what_it_makes_negative_is_gone():
    np.testing.assert_allclose(align(np.full(3, 2.0), np.array([4.0, 6.0, 8.0]), "lsq"), [6, 6, 6])
    prediction, truth = np.array([[1.0, 10.0, 20.0]]), np.array([[0.0, 1.0, 30.0]])
    ready = Protocol("x", align="lsq").prepare(prediction, truth)  # 2.9 p - 28: the first lands at -25
    assert ready.prediction_m[0, 0] == 0
    assert not ready.own[0, 0]


def test_alignment_without_a_common_pixel_changes_nothing():
    p = np.array([1.0, 0.0])
    for how in ("median", "lsq"):
        assert align(p, np.array([0.0, 2.0]), how).tolist() == [1, 0]


@pytest.mark.parametrize("how", ["none", "median", "lsq"])
def test_extreme_predictions_are_aligned_without_a_warning(how):
    prediction = np.array([[1.4e-45, 3.4e38, 1e30, 65504.0, math.nan, math.inf, 0.0]], np.float32)
    ready = Protocol("x", align=how).prepare(prediction, np.full((1, 7), 10.0))
    figures = DepthSums.over(ready.prediction_m, ready.truth_m, ready.own).finish()
    assert not any(math.isnan(value) or math.isinf(value) for value in figures.values())


def test_other_sizes_are_refused():
    with pytest.raises(ScoreError, match="prediction is 3x4, truth 4x3"):
        preset("paper").prepare(np.ones((3, 4)), np.ones((4, 3)))


def test_an_unknown_protocol_lists_the_known():
    with pytest.raises(ScoreError, match=r"no protocol 'best': choose one of paper, .*stereo2015"):
        preset("best")


def test_no_truth_is_said_in_words():
    assert replace(preset("garg"), truth="none").describe() == "garg: images alone, this drive has no true depth"


def test_descriptions_tell_protocols_apart():
    assert len({protocol.describe().split(":", 1)[1] for protocol in PRESETS.values()}) == len(PRESETS)
    assert preset("garg").describe() == (
        "garg: annotated truth, 0.001-80 m, garg crop, prediction clamped, no alignment, mean over images"
    )
