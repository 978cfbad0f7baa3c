"""Planes continued: against least squares written out, on planes, and at sizes that hold next to nothing."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from priors.nets import surface_planes
from priors.nets.surface_planes import (
    CELL,
    CLUES_EACH,
    LEAST_COUNT,
    LEAST_SPREAD,
    LEAST_SPREAD_PX,
    REACHES,
    continue_planes,
)
from priors.types import FloatMap

SIZES = st.tuples(st.integers(1, 30), st.integers(1, 40))


def slow_plane(
    disparity_px: FloatMap, confidence: FloatMap, reach: int, place: tuple[int, int]
) -> tuple[float, float, float, float]:
    """Return the plane at a pixel, the deviation, the mean and the mean weight of the cells around, by lstsq."""
    half = round(reach / CELL)
    row, column = place[0] // CELL, place[1] // CELL
    rows, columns = -(-disparity_px.shape[0] // CELL), -(-disparity_px.shape[1] // CELL)
    found: list[tuple[float, float, float, float]] = []  # x, y, disparity, weight of each pixel, at its cell's middle
    for y in range(max(0, row - half), min(rows, row + half + 1)):
        for x in range(max(0, column - half), min(columns, column + half + 1)):
            cell = slice(CELL * y, CELL * y + CELL), slice(CELL * x, CELL * x + CELL)
            for value, sure in zip(disparity_px[cell].ravel(), confidence[cell].ravel(), strict=True):
                found.append((x, y, float(value), float(sure) ** 4))
    x_, y_, value_, weight = np.array(found).T
    mean = np.average(np.array([x_, y_, value_]), axis=1, weights=weight)
    x_, y_, value_ = x_ - mean[0], y_ - mean[1], value_ - mean[2]
    spread = np.sqrt(LEAST_SPREAD * weight.sum()) * (2 * half + 1) / 2  # the ridge: two more rows
    A = np.concatenate([np.sqrt(weight)[:, None] * np.stack([x_, y_], 1), spread * np.eye(2)])
    slopes = np.linalg.lstsq(A, np.concatenate([np.sqrt(weight) * value_, [0, 0]]), rcond=None)[0]
    at = np.array([place[1], place[0]]) / CELL + 0.5 / CELL - 0.5
    # what the plane leaves of the variance, the ridge's part apart
    left = (weight * value_ * (value_ - slopes @ np.stack([x_, y_]))).sum() / weight.sum()
    count = weight.sum() / (CELL * (2 * half + 1)) ** 2
    return mean[2] + slopes @ (at - mean[:2]), np.sqrt(max(left, 0)), mean[2], count


@given(SIZES, st.integers(0, 10**6))
@settings(deadline=None, max_examples=15)
def test_planes_are_least_squares_of_the_window(size: tuple[int, int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    disparity_px = rng.uniform(20, 60, size).astype(np.float32)
    confidence = rng.uniform(0.2, 1, size).astype(np.float32)
    at = np.sort(rng.permutation(disparity_px.size)[:6])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(surface_planes, "REACHES", (8, 24))
        planes_px, clues = continue_planes(disparity_px, confidence, at)
    for number, reach in enumerate((8, 24)):
        for n, index in enumerate(at):
            place = divmod(int(index), size[1])
            plane, spread, mean, count = slow_plane(disparity_px, confidence, reach, place)
            own = np.log(disparity_px[place])
            found = clues[CLUES_EACH * number : CLUES_EACH * (number + 1), n]
            expected = [np.log(plane) - own, np.log(mean) - own, np.log(count + LEAST_COUNT)]
            assert planes_px[number, n] == pytest.approx(plane, rel=1e-3)
            assert np.allclose(found[[0, 2, 3]], expected, atol=5e-3)
            variance = (np.exp(found[1]) - LEAST_SPREAD_PX) ** 2  # a difference of float32 squares of up to 60 px
            assert variance == pytest.approx(spread**2, rel=1e-2, abs=1e-6 * 60**2)


def test_a_plane_goes_on_where_nothing_was_seen() -> None:
    """A wall that comes nearer to the left; the first 40 columns were filled from their right, and say so."""
    truth_px = np.broadcast_to(60 - 0.2 * np.arange(200, dtype=np.float32), (120, 200)).copy()
    seen_px, confidence = truth_px.copy(), np.full((120, 200), 0.95, np.float32)
    seen_px[:, :40], confidence[:, :40] = truth_px[:, 40:41], 0.2
    at = np.flatnonzero(np.arange(200 * 120) % 200 < 40)
    planes_px, _ = continue_planes(seen_px, confidence, at)
    flat, *planes = (np.abs(found - truth_px.reshape(-1)[at]).mean() for found in (seen_px.reshape(-1)[at], *planes_px))
    assert max(planes) < 0.4 * flat


@given(SIZES, st.integers(0, 10**6))
@settings(deadline=None, max_examples=20)
def test_any_map_has_finite_planes(size: tuple[int, int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    disparity_px = np.exp(rng.uniform(-12, 8, size)).astype(np.float32)
    confidence = (rng.uniform(0, 1, size) * rng.integers(0, 2, size)).astype(np.float32)
    planes_px, clues = continue_planes(disparity_px, confidence, np.arange(disparity_px.size))
    assert planes_px.shape == (len(REACHES), disparity_px.size) and (planes_px > 0).all()
    assert clues.shape == (CLUES_EACH * len(REACHES), disparity_px.size)
    assert np.isfinite(planes_px).all() and np.isfinite(clues).all()
