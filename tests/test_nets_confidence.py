"""Confidence: evidence, the fitted table, and that both come back from a file's header."""

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.calibration import calibration_error
from priors.learn.confidence_calibration import CLEARLY, FAR, CalibrationPixels, area, calibrate, ratios
from priors.nets.confidence import TERMS, ConfidenceCalibration, evidence, falling, fit, is_hidden


def drawn(seed: int = 0, n: int = 40_000, honest: float = 1.0) -> CalibrationPixels:
    """Pixels whose errors are Laplace-distributed with a spread that the doubt knows, overstated by `honest`."""
    rng = np.random.default_rng(seed)
    truth_px = np.exp(rng.uniform(np.log(3), np.log(150), n))
    scale = np.exp(rng.normal(-1.2, 0.8, n)) * (1 + truth_px / 60)
    found_px = np.maximum(truth_px + rng.laplace(0, scale), 0.5)
    wrong = np.exp(-1 / scale)
    doubt = honest * np.log(wrong / (1 - wrong))
    terms = np.stack([doubt, np.log(scale), -np.log(found_px), np.zeros(n), np.zeros(n)])
    return CalibrationPixels(terms.astype(np.float32), found_px.astype(np.float32), truth_px.astype(np.float32))


def test_terms_have_the_shape_of_the_map() -> None:
    disparity_px = np.tile(np.linspace(5, 9, 40, dtype=np.float32), (20, 1))
    terms = evidence(disparity_px, np.full((20, 40), 0.5, np.float32), np.full((20, 40), -2, np.float32))
    assert terms.shape == (len(TERMS), 20, 40) and terms.dtype == np.float32
    assert np.allclose(terms[0], -2) and np.allclose(terms[1], np.log(0.5))
    assert np.allclose(terms[3][:, 1:-1], 4 / 39, atol=1e-3)
    zeros = evidence(np.zeros((3, 4), np.float32), np.zeros((3, 4), np.float32), np.zeros((3, 4), np.float32))
    assert np.isfinite(zeros).all()


def test_hidden_is_what_the_right_view_cannot_see() -> None:
    disparity_px = np.full((1, 30), 2.0, np.float32)
    disparity_px[0, 15:20] = 8
    expected = np.zeros(30, np.bool_)
    expected[:2] = True  # beyond the right view's edge
    expected[10:15] = True  # behind the box, which covers columns 7 to 11 there: 9 (its edge) to 13, and 14 beside it
    assert np.array_equal(is_hidden(disparity_px)[0], expected)
    slant_px = np.linspace(20, 5, 40, dtype=np.float32)[None] * np.ones((4, 1), np.float32)
    assert not is_hidden(slant_px)[:, 25:].any()  # a wall that leaves hides nothing of itself


@given(st.lists(st.tuples(st.floats(0, 1), st.integers(1, 9)), min_size=1, max_size=20))
@settings(deadline=None)
def test_falling_is_the_projection(pairs: list[tuple[float, int]]) -> None:
    values, counts = np.array([v for v, _ in pairs]), np.array([c for _, c in pairs])
    found = falling(values, counts)
    assert all(a >= b - 1e-12 for a, b in pairwise(found))
    assert np.sum(found * counts) == pytest.approx(np.sum(values * counts))
    # Nearest: no constant shift of a pool and no falling sequence of the same length does better.
    error = np.sum(counts * (found - values) ** 2)
    for other in (np.full_like(values, np.average(values, weights=counts)), np.minimum.accumulate(values)):
        assert error <= np.sum(counts * (other - values) ** 2) + 1e-9


def test_fit_is_calibrated_on_new_pixels() -> None:
    made, fresh = fit(drawn(0).terms, drawn(0).within), drawn(1)
    confidence = made.probability(made.score(fresh.terms))
    assert calibration_error(confidence, fresh.within) < 0.015


@pytest.mark.parametrize("honest", [0.4, 2.5])
def test_fit_mends_a_network_that_misjudges_itself(honest: float) -> None:
    seen, fresh = drawn(0, honest=honest), drawn(1, honest=honest)
    raw, made = ConfidenceCalibration.trusting(), fit(seen.terms, seen.within)
    errors = [calibration_error(c.probability(c.score(fresh.terms)), fresh.within) for c in (raw, made)]
    assert errors[1] < 0.02 < errors[0]


def test_confidence_falls_with_doubt() -> None:
    made = fit(drawn().terms, drawn().within)
    low, high = (np.full((4, 5), value, np.float32) for value in (-4, 1))
    flat = np.full((4, 5), 20, np.float32)
    assert made(flat, np.full_like(flat, 0.3), low).min() > made(flat, np.full_like(flat, 0.3), high).max()
    assert ConfidenceCalibration.trusting()(flat, flat, np.zeros_like(flat)) == pytest.approx(0.5)


def test_different_scores_get_different_probabilities() -> None:
    """Even where all pixels are right: the order is what the filters and curves use."""
    seen = drawn()
    made = fit(seen.terms, np.ones_like(seen.within))
    confidence = made.probability(made.score(seen.terms))
    assert confidence.min() > 0.99 and confidence.max() <= 1
    assert np.unique(np.rint(confidence * 65535)).size > 250
    assert (np.diff(made.probabilities) < 0).all() and (np.diff(made.scores) > 0).all()


@pytest.mark.parametrize("clearly", [0.8, CLEARLY], ids=["reached", "out of reach"])
def test_distance_counts_as_little_as_does_it(clearly: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("priors.learn.confidence_calibration.CLEARLY", clearly)
    seen = drawn()
    worst = [max(ratios(fit(seen.terms, seen.within, far), seen)) for far in FAR]
    assert worst[-1] < worst[0]
    clear = [far for far, ratio in zip(FAR, worst, strict=True) if ratio < clearly]
    made = calibrate([seen])
    assert made.weights[TERMS.index("distance")] == (clear[0] if clear else FAR[int(np.argmin(worst))])
    assert bool(clear) == (clearly > CLEARLY)


def test_ratios_know_a_perfect_and_a_reversed_order() -> None:
    """The score of pixels whose errors are known: sorted by error nothing does better, the other way nothing worse."""
    seen = drawn()
    relative = np.abs(seen.truth_px / seen.disparity_px - 1)
    by_error = CalibrationPixels(np.stack([relative, *seen.terms[1:]]), seen.disparity_px, seen.truth_px)
    best, worst = (ConfidenceCalibration((sign, 0, 0, 0, 0), (0.0, 1.0), (1.0, 0.0)) for sign in (1.0, -1.0))
    assert ratios(best, by_error)[0] < min(ratios(fit(seen.terms, seen.within, far), seen)[0] for far in FAR)
    assert min(ratios(worst, by_error)) > 1


def test_area_is_the_mean_of_the_curve() -> None:
    error: npt.NDArray[np.float64] = np.array([4.0, 0.0, 2.0])
    # In order of the score 0, 2, 4: means 0, 1, 2.
    assert area(error, np.array([3, 1, 2], np.float32)) == pytest.approx(1)


def test_header_round_trip() -> None:
    made = fit(drawn().terms, drawn().within)
    again = ConfidenceCalibration.read({"calibration": made.record()})
    terms = drawn(2).terms
    assert np.allclose(made.probability(made.score(terms)), again.probability(again.score(terms)), atol=2e-3)
    assert ConfidenceCalibration.read({}) == ConfidenceCalibration.trusting()


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), knots=st.integers(1, 9), repeated=st.booleans())
def test_the_kernels_equal_numpy(seed: int, knots: int, repeated: bool) -> None:
    rng = np.random.default_rng(seed)
    disparity_px = rng.uniform(0, 6, (3, 17)).astype(np.float32)
    lands = np.arange(17, dtype=np.float32) - disparity_px
    expected = lands < 0
    for y, x in np.ndindex(3, 17):
        expected[y, x] |= (lands[y, x + 1 :] <= lands[y, x] - 0.5).any()
    assert np.array_equal(is_hidden(disparity_px), expected)

    scores = np.sort(rng.normal(size=knots)).astype(np.float32)
    if repeated:
        scores[knots // 2 :] = scores[knots // 2]
    heights = np.sort(rng.uniform(size=knots))[::-1].astype(np.float32)
    table = ConfidenceCalibration((0.0,) * len(TERMS), tuple(map(float, scores)), tuple(map(float, heights)))
    asked = np.concatenate([rng.normal(size=(2, 50)) * 2, np.tile(scores.astype(np.float64), (2, 1))], axis=1)
    found = table.probability(asked.astype(np.float32))
    assert found.shape == asked.shape and found.dtype == np.float32
    off = np.abs(asked[..., None] - scores).min(-1) > 1e-5  # at a jump either side is right
    assert np.allclose(found[off], np.interp(asked, scores, heights)[off], atol=1e-4)
    assert found.min() >= heights.min() - 1e-6 and found.max() <= heights.max() + 1e-6
