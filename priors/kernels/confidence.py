"""Confidence of a stereo network in two passes over memory; the slow twins are in tests/test_nets_confidence.py."""

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import FAST, compiled
from priors.types import FloatMap

STRETCH = 256
"""Values that are compared at a time."""


@compiled(error_model="numpy")
def find_hidden(disparity_px: FloatMap, margin_px: float, hidden: npt.NDArray[np.bool_], first: int, last: int) -> None:
    """Tell which pixels of a left view (height, width) the right one cannot see, in rows first to last - 1.

    See nets/confidence.is_hidden.
    """
    width = disparity_px.shape[1]
    for row in range(first, last):
        nearest = np.float32(np.inf)
        for x in range(width - 1, -1, -1):
            lands = np.float32(x) - disparity_px[row, x]
            hidden[row, x] = lands < 0 or nearest <= lands - margin_px
            nearest = min(nearest, lands)


@compiled(fastmath=FAST, error_model="numpy")
def interpolate(values: FloatMap, knots: FloatMap, heights: FloatMap, out: FloatMap) -> None:
    """Write a table's value for each of values (n,): linear between rising knots (k,), the last one's beyond.

    Values are compared with all knots, in order and in stretches: dozens of comparisons at once are quicker than a
    search that a processor cannot foresee.
    """
    last = knots.shape[0] - 1
    below = np.empty(STRETCH, np.int32)
    slope = np.zeros(last + 1, np.float32)
    for k in range(last):
        width = knots[k + 1] - knots[k]
        slope[k] = (heights[k + 1] - heights[k]) / width if width > 0 else np.float32(0)
    for start in range(0, values.shape[0], STRETCH):
        end = min(values.shape[0], start + STRETCH)
        part, written = values[start:end], out[start:end]
        below[:] = 0
        for k in range(1, last + 1):
            knot = knots[k]
            for n in range(part.size):
                below[n] += np.int32(part[n] >= knot)
        for n in range(part.size):
            k = below[n]
            written[n] = heights[k] + slope[k] * (min(max(part[n], knots[0]), knots[last]) - knots[k])
