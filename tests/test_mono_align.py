"""Alignment: a known scale and shift come back, whatever a third of the samples say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from priors.errors import DataError
from priors.methods._mono_align import Alignment, fit


def samples(seed: int, count: int, noise: float) -> np.ndarray:
    """Depths as a street has them, 3 to 80 m, in random order."""
    rng = np.random.default_rng(seed)
    return np.exp(rng.uniform(np.log(3), np.log(80), count)) * np.exp(rng.normal(0, noise, count))


def spoil(known_m: np.ndarray, share: float, seed: int) -> np.ndarray:
    """Replace a share of the depths by anything, mostly far too near, as wrong matches do."""
    rng = np.random.default_rng(seed)
    wrong = rng.permutation(len(known_m))[: int(share * len(known_m))]
    out = known_m.copy()
    out[wrong] = rng.uniform(1, 200, len(wrong)) * rng.choice([0.02, 1.0], len(wrong))
    return out


@given(
    seed=st.integers(0, 10**6),
    scale=st.floats(0.01, 100),
    share=st.floats(0, 0.3),
    space=st.sampled_from(["depth", "disparity"]),
)
@settings(max_examples=60, deadline=None)
def test_a_scale_comes_back(seed: int, scale: float, share: float, space: str) -> None:
    true_m = samples(seed, 500, 0)
    values = (true_m if space == "depth" else 1 / true_m) / scale
    found = fit(values, spoil(true_m, share, seed), "scale", space)
    assert found.shift == 0
    assert found.scale == pytest.approx(scale, rel=1e-5)
    np.testing.assert_allclose(found.apply(values), true_m, rtol=1e-4)


@given(seed=st.integers(0, 10**6), scale=st.floats(0.01, 100), shift=st.floats(-1, 1), share=st.floats(0, 0.3))
@settings(max_examples=60, deadline=None)
def test_a_shift_in_disparity_comes_back(seed: int, scale: float, shift: float, share: float) -> None:
    """What a network of relative disparity leaves open: 1/z = scale * value + shift."""
    true_m = samples(seed, 500, 0)
    values = (1 / true_m - shift * 0.01) / scale
    seen = values > 0  # a value of 0 is none
    found = fit(values, spoil(true_m, share, seed), "scale-shift", "disparity")
    if seen.sum() > 400:
        np.testing.assert_allclose(found.apply(values)[seen], true_m[seen], rtol=1e-3)


@given(seed=st.integers(0, 10**6), scale=st.floats(0.01, 100), shift=st.floats(-2, 2), share=st.floats(0, 0.3))
@settings(max_examples=60, deadline=None)
def test_a_shift_in_depth_comes_back(seed: int, scale: float, shift: float, share: float) -> None:
    true_m = samples(seed, 500, 0)
    values = (true_m - shift) / scale
    found = fit(values, spoil(true_m, share, seed), "scale-shift", "depth")
    np.testing.assert_allclose(found.apply(values), true_m, rtol=1e-3)


@pytest.mark.parametrize("kind", ["scale", "scale-shift"])
@pytest.mark.parametrize("space", ["depth", "disparity"])
def test_noise_and_outliers_together(kind: str, space: str) -> None:
    """5 % noise on every sample and 30 % outliers: the depths are off by less than 2 %."""
    true_m = samples(1, 3000, 0)
    values = (true_m if space == "depth" else 1 / true_m) * 0.37
    known_m = spoil(true_m * np.exp(np.random.default_rng(2).normal(0, 0.05, 3000)), 0.3, 3)
    np.testing.assert_allclose(fit(values, known_m, kind, space).apply(values), true_m, rtol=0.02)


def test_least_squares_would_fail_there() -> None:
    """The outliers of these tests do matter: plain least squares is off by more than 20 %."""
    true_m = samples(1, 3000, 0)
    known_m = spoil(true_m, 0.3, 3)
    plain = np.dot(true_m, known_m) / np.dot(true_m, true_m)
    assert abs(plain - 1) > 0.2 or abs(np.mean(known_m / true_m) - 1) > 0.2


def test_order_and_holes_do_not_matter() -> None:
    rng = np.random.default_rng(4)
    true_m = samples(5, 1000, 0).reshape(20, 50)
    values = true_m * rng.uniform(0.9, 1.1, true_m.shape)
    holed, known = values.copy(), true_m.copy()
    holed[::3] = 0
    known[:, ::4] = 0
    holed[1, 1], known[1, 2] = np.nan, np.inf
    both = (holed > 0) & (known > 0) & np.isfinite(holed) & np.isfinite(known)
    found = fit(holed, known, "scale", "depth")
    assert found.scale == pytest.approx(fit(values[both][::-1], true_m[both][::-1], "scale", "depth").scale, rel=1e-6)


def test_too_little_to_tell_a_shift() -> None:
    two = np.array([2.0, 4.0]), np.array([5.0, 10.0])
    assert fit(*two, "scale-shift", "depth") == Alignment(pytest.approx(2.5), 0.0, "depth")
    same = np.full(50, 2.0), np.full(50, 5.0)
    assert fit(*same, "scale-shift", "depth") == Alignment(pytest.approx(2.5), 0.0, "depth")
    with pytest.raises(DataError, match="nothing to align to"):
        fit(np.zeros(5), np.ones(5), "scale", "depth")


def test_a_falling_line_is_refused() -> None:
    """Depth read as disparity: near would be far. Only a scale is left."""
    true_m = samples(6, 400, 0)
    assert fit(true_m, true_m, "scale-shift", "disparity").scale > 0


def test_what_is_beyond_infinity_has_no_value() -> None:
    line = Alignment(1.0, -0.1, "disparity")
    np.testing.assert_allclose(line.apply(np.array([[0.05, 0.1, 0.2, 0.0]])), [[0, 0, 10, 0]], rtol=1e-6)
    assert np.isfinite(Alignment(1e30, 0.0, "depth").apply(np.float32([[1e30, 1e-30]]))).all()
