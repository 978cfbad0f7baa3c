"""Sure neighbours: against a walk to each side, pixel by pixel."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from priors.nets.sure_neighbours import NONE_AWAY, SIDES, find_sure
from priors.types import FloatMap, Mask

STEPS = (0, -1), (0, 1), (-1, 0), (1, 0)
"""Rows and columns of a step to the left, to the right, up and down."""


def walk(disparity_px: FloatMap, sure: Mask, place: tuple[int, int], step: tuple[int, int]) -> tuple[float, float]:
    """Return the first sure disparity from a pixel on, and how many steps it is away."""
    (row, column), away = place, 0
    while 0 <= row < sure.shape[0] and 0 <= column < sure.shape[1]:
        if sure[row, column]:
            return float(disparity_px[row, column]), away
        row, column, away = row + step[0], column + step[1], away + 1
    return float(disparity_px[place]), NONE_AWAY


@given(st.tuples(st.integers(1, 12), st.integers(1, 14)), st.integers(0, 10**6))
@settings(deadline=None, max_examples=30)
def test_neighbours_are_those_that_a_walk_meets_first(size: tuple[int, int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    disparity_px = np.exp(rng.uniform(-3, 5, size)).astype(np.float32)
    sure = rng.random(size) < 0.2
    at = np.sort(rng.permutation(disparity_px.size)[: 1 + disparity_px.size // 2])
    offered_px, clues = find_sure(disparity_px, sure, at)
    for n, index in enumerate(at):
        place = divmod(int(index), size[1])
        met = [walk(disparity_px, sure, place, step) for step in STEPS]
        assert offered_px[:, n].tolist() == [value_px for value_px, _ in met]
        own = np.log(max(float(disparity_px[place]), 1))
        assert np.allclose(clues[:SIDES, n], [np.log(max(value_px, 0.5)) - own for value_px, _ in met], atol=1e-5)
        assert np.allclose(clues[SIDES:, n], [np.log(away + 1) for _, away in met], atol=1e-5)
