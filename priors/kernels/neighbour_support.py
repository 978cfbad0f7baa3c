"""Support of a sparse depth map's values by their neighbours: how dense and how steady these are."""

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import compiled


@compiled
def support(depth_m: npt.NDArray[np.float32], reach: int, steady: float) -> npt.NDArray[np.float32]:
    """Return how many of the pixels around each value (height, width; inf = none) have values, less where they differ.

    The window is (2 * reach + 1) pixels square, cut at the border. The share that has values is divided by 1 +
    (spread / steady)^2, the spread being the inverse depths' standard deviation over their mean. 0 where there is none.
    """
    height, width = depth_m.shape
    out = np.zeros(depth_m.shape, dtype=np.float32)
    # Of every column's pixels in the window's rows: count, sum and sum of squares of inverse depth.
    count, total, square = np.zeros(width), np.zeros(width), np.zeros(width)
    for row in range(-reach, height):
        if row + reach < height:
            _add(depth_m[row + reach], 1.0, count, total, square)
        if row < 0:
            continue
        if row - reach - 1 >= 0:
            _add(depth_m[row - reach - 1], -1.0, count, total, square)
        rows = min(height, row + reach + 1) - max(0, row - reach)
        n, s, q = 0.0, 0.0, 0.0
        for column in range(-reach, width):
            if column + reach < width:
                n += count[column + reach]
                s += total[column + reach]
                q += square[column + reach]
            if column - reach - 1 >= 0:
                n -= count[column - reach - 1]
                s -= total[column - reach - 1]
                q -= square[column - reach - 1]
            if column >= 0 and depth_m[row, column] < np.inf:
                pixels = rows * (min(width, column + reach + 1) - max(0, column - reach))
                spread2 = max(n * q / (s * s) - 1.0, 0.0)
                out[row, column] = n / pixels / (1.0 + spread2 / (steady * steady))
    return out


@compiled(inline="always")
def _add(
    values: npt.NDArray[np.float32],
    sign: float,
    count: npt.NDArray[np.float64],
    total: npt.NDArray[np.float64],
    square: npt.NDArray[np.float64],
) -> None:
    """Add a row to the columns' sums, or with sign -1 take it out."""
    for column in range(values.shape[0]):
        inverse = 1.0 / values[column]
        count[column] += sign * (inverse > 0)
        total[column] += sign * inverse
        square[column] += sign * inverse * inverse
