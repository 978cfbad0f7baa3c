"""Sparsification curves: equal to the expectation over random ties, and in the order that their meaning demands."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import eval as loops

from eval.curves import ScoredPixels, best, curves, join, scored_pixels, sparsify
from eval.protocol import preset

pytestmark = pytest.mark.filterwarnings("error")

pixels = st.lists(st.tuples(st.floats(0, 10), st.integers(0, 4)), min_size=1, max_size=25)


def samples(seed=0, n=4000, noise=0.5):
    """Errors that grow with a hidden scale, and a confidence that knows it up to noise; the scale is not the depth."""
    rng = np.random.default_rng(seed)
    truth, scale = rng.uniform(2, 80, n), rng.uniform(0, 0.2, n)
    prediction = truth * np.exp(scale * rng.standard_normal(n))
    return ScoredPixels(prediction, truth, 1 - scale - noise * 0.2 * rng.random(n))


@given(pixels)
def test_curves_equal_the_loops_and_break_ties_fairly(rows):
    error, confidence = np.array([e for e, _ in rows]), np.array([c for _, c in rows], dtype=np.float64)
    counts = np.arange(len(rows), 0, -1)
    expected = [loops.kept_mean(error.tolist(), confidence.tolist(), int(n)) for n in counts]
    np.testing.assert_allclose(sparsify(error, confidence, counts / len(rows)), expected, rtol=1e-9, atol=1e-12)


def test_ties_are_the_mean_over_every_order():
    error, confidence = [1.0, 2.0, 4.0, 8.0], [0.5, 0.5, 0.5, 0.9]
    for kept in (1, 2, 3, 4):
        means = []
        for order in itertools.permutations(range(4)):
            ranked = sorted(order, key=lambda i: -confidence[i])  # stable: equals keep the permutation's order
            means.append(np.mean([error[i] for i in ranked[:kept]]))
        got = sparsify(np.array(error), np.array(confidence), np.array([kept / 4]))
        assert got[0] == pytest.approx(np.mean(means))


@given(pixels, st.randoms(use_true_random=False))
def test_the_order_of_pixels_does_not_matter(rows, random):
    def curve(pairs):
        return sparsify(np.array([e for e, _ in pairs]), np.array([float(c) for _, c in pairs]))

    shuffled = list(rows)
    random.shuffle(shuffled)
    np.testing.assert_allclose(curve(shuffled), curve(rows), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("metric", ["abs_rel", "rmse", "d1"])
def test_the_oracle_is_below_and_everything_meets_at_the_whole(metric):
    made = curves(samples(), metric, 386.0)
    assert (made.oracle <= made.by_confidence + 1e-12).all()
    assert (made.oracle <= made.farthest_first + 1e-12).all()
    assert made.by_confidence[0] == pytest.approx(made.oracle[0]) == pytest.approx(made.farthest_first[0])
    assert (np.diff(made.oracle) <= 1e-12).all()


def test_whole_curves_start_at_the_metric():
    drawn = samples()
    whole = best(drawn, 1.0)
    for metric in ("abs_rel", "rmse"):
        assert curves(drawn, metric).by_confidence[0] == pytest.approx(whole[metric])


def test_ause_orders_confidences():
    areas = [curves(samples(noise=noise), "abs_rel").ause for noise in (0.0, 1.0, 10.0)]
    assert 0 < areas[0] < areas[1] < areas[2]
    informed = curves(samples(noise=0.1), "abs_rel")
    assert informed.ause < informed.ause_farthest_first
    drawn = samples()
    error = np.abs(drawn.prediction_m - drawn.truth_m)
    assert curves(ScoredPixels(drawn.prediction_m, drawn.truth_m, -error), "rmse").ause == pytest.approx(0, abs=1e-12)


def test_ause_is_an_area():
    error, confidence = np.array([4.0, 0.0]), np.array([1.0, 0.0])
    truth = np.array([100.0, 100.0])
    made = curves(ScoredPixels(truth + error, truth, confidence), "abs_rel", kept=np.array([1.0, 0.5]))
    # Whole: 0.02 for both; the better half: 0.04 by confidence, 0 by the oracle. A triangle of 0.5 x 0.04.
    assert made.ause == pytest.approx(0.01)


def test_farthest_first_is_a_confidence_of_minus_the_prediction():
    drawn = samples()
    made = curves(ScoredPixels(drawn.prediction_m, drawn.truth_m, -drawn.prediction_m), "rmse")
    np.testing.assert_allclose(made.by_confidence, made.farthest_first)


def gather(frames, protocol):
    return join([scored_pixels(protocol.prepare(prediction, truth), trust) for prediction, trust, truth in frames])


def test_samples_are_what_the_protocol_scores_and_no_filled_pixel():
    prediction = np.array([[4.0, 0.0, 9.0, 90.0]])
    truth = np.array([[5.0, 5.0, 0.0, 100.0]])
    confidence = np.array([[0.1, 0.2, 0.3, 0.4]])
    frames = [(prediction, confidence, truth)]
    drawn = gather(frames, preset("kitti-completion"))
    assert drawn.prediction_m.tolist() == [4, 90]
    assert drawn.truth_m.tolist() == [5, 100]
    assert drawn.confidence.tolist() == [0.1, 0.4]
    assert gather([(prediction, None, truth)] * 2, preset("paper")).prediction_m.tolist() == [4, 4]
    assert gather([], preset("paper")).truth_m.size == 0


def test_samples_crop_the_confidence_with_the_maps():
    size = (375, 1242)
    numbered = np.arange(size[0] * size[1], dtype=np.float64).reshape(size) + 1
    drawn = gather([(np.full(size, 7.0), numbered, np.full(size, 8.0))], preset("garg"))
    assert drawn.confidence[0] == numbered[153, 44]
    assert drawn.confidence[-1] == numbered[370, 1196]


def test_best_keeps_exactly_the_share_with_the_highest_confidence():
    drawn = ScoredPixels(
        np.array([10.0, 20.0, 30.0, 44.0]), np.array([10.0, 22.0, 30.0, 40.0]), np.array([3, 1, 2, 0.0])
    )
    assert best(drawn, 0.5)["rmse"] == 0
    assert best(drawn, 0.75)["mae"] == pytest.approx(2 / 3)
    assert best(drawn, 0.75)["density"] == 0.75
    tied = ScoredPixels(drawn.prediction_m, drawn.truth_m, np.ones(4))
    assert best(tied, 0.5, seed=1) == best(tied, 0.5, seed=1)
    assert len({best(tied, 0.5, seed=seed)["rmse"] for seed in range(20)}) > 1


def test_best_knows_disparities_of_a_rig():
    drawn = samples()
    for share in (1.0, 0.5):
        figures = best(drawn, share, fx_baseline=386.0)
        assert figures["d1"] == pytest.approx(curves(drawn, "d1", 386.0, np.array([share])).by_confidence[0])
        assert figures["rmse"] == best(drawn, share)["rmse"]
    assert "d1" not in best(drawn, 1.0)


def test_nan_confidence_is_the_least_and_no_pixels_give_nan():
    curve = sparsify(np.array([5.0, 1.0]), np.array([np.nan, 0.0]), np.array([1.0, 0.5]))
    assert curve.tolist() == [3.0, 1.0]
    empty = ScoredPixels(np.zeros(0), np.zeros(0), np.zeros(0))
    assert np.isnan(curves(empty, "rmse").ause)
    assert np.isnan(best(empty, 0.5)["rmse"])


def test_d1_needs_the_rig():
    with pytest.raises(ValueError, match="fx_baseline"):
        curves(samples(n=10), "d1")
