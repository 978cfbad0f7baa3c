"""Dense networks over many pixels equal matrix products, whatever the sizes of their layers and blocks."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from priors.kernels.dense import STRETCH, dense
from priors.types import FloatMap


def product(values: FloatMap, layers: list[tuple[FloatMap, FloatMap]]) -> FloatMap:
    """The oracle, in float64."""
    found = values.astype(np.float64)
    for number, (weight, bias) in enumerate(layers):
        found = weight.T.astype(np.float64) @ (np.maximum(found, 0) if number else found) + bias[:, None]
    return np.asarray(found, np.float32)


@settings(max_examples=30, deadline=None)
@given(
    sizes=st.lists(st.integers(1, 13), min_size=2, max_size=4),
    pixels=st.sampled_from([1, 3, STRETCH - 1, STRETCH, 2 * STRETCH + 5]),
    seed=st.integers(0, 2**32 - 1),
)
def test_it_is_the_product(sizes: list[int], pixels: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    layers = [
        (rng.uniform(-1, 1, (a, b)).astype(np.float32), rng.uniform(-1, 1, b).astype(np.float32))
        for a, b in pairwise(sizes)
    ]
    values = rng.uniform(-1, 1, (sizes[0], pixels)).astype(np.float32)
    kept = values.copy()
    # at most 14 terms a layer, each of at most 14 in the layer before: below 14**3 after three
    np.testing.assert_allclose(dense(values, layers), product(values, layers), rtol=0, atol=14**3 * 1e-6)
    assert np.array_equal(values, kept)


def test_what_is_no_number_stays_seen() -> None:
    layers = [
        (np.ones((1, 4), np.float32), np.zeros(4, np.float32)),
        (np.ones((4, 1), np.float32), np.zeros(1, np.float32)),
    ]
    found = dense(np.array([[1.0, np.nan, -np.inf, np.inf]], np.float32), layers)
    assert found[0] == pytest.approx([4, np.nan, 0, np.inf], nan_ok=True)


def test_no_pixel() -> None:
    assert dense(np.empty((3, 0), np.float32), [(np.ones((3, 2), np.float32), np.zeros(2, np.float32))]).shape == (2, 0)
