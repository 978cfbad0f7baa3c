"""A network's confidence in two passes over memory; the slow twins are in tests/test_nets_confidence.py."""

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from priors.types import FloatMap


@njit(cache=True, nogil=True, parallel=True)
def find_hidden(disparity_px: FloatMap, margin_px: float, hidden: npt.NDArray[np.bool_]) -> None:
    """Tell which pixels of a left view (height, width) the right one cannot see; see nets/confidence.is_hidden."""
    height, width = disparity_px.shape
    for row in prange(height):
        nearest = np.float32(np.inf)
        for x in range(width - 1, -1, -1):
            lands = np.float32(x) - disparity_px[row, x]
            hidden[row, x] = lands < 0 or nearest <= lands - margin_px
            nearest = min(nearest, lands)


@njit(cache=True, nogil=True, parallel=True)
def interpolate(values: FloatMap, knots: FloatMap, heights: FloatMap, out: FloatMap) -> None:
    """Write a table's value for each of values (n,): linear between rising knots (k,), the last one's beyond."""
    last = knots.shape[0] - 1
    for index in prange(values.shape[0]):
        value = values[index]
        low, high = 0, last
        while high - low > 1:
            middle = (low + high) // 2
            if knots[middle] <= value:
                low = middle
            else:
                high = middle
        width = knots[high] - knots[low]
        share = min(max((value - knots[low]) / width if width > 0 else np.float32(1), np.float32(0)), np.float32(1))
        out[index] = heights[low] + share * (heights[high] - heights[low])
