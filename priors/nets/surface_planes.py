"""Planes continued: the disparity that a pixel has if it lies on the plane of what is trusted around it.

A strip on the left that the other eye does not see, a clipped white wall, a plain road: nothing was matched there, and
what is filled in is flat, or the background. Walls and roads are planes, and a plane of the world is one of disparity.
Each plane is fitted by least squares to a window, from sums over cells of 4 x 4 pixels.
"""

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from priors.types import FloatMap

REACHES = (48, 160)
"""Columns and rows from a pixel to the border of the windows that planes are fitted to."""
CLUES_EACH = 4
"""Of a plane: itself and the window's mean against the pixel's own disparity, the deviation, the window's weight."""
CELL = 4
"""Side of a cell, pixels."""
LEAST_SPREAD = 0.004
"""Added to the positions' variance, in half windows squared: what lies all on one side makes no steep slope."""
LEAST_PX, LEAST_PLANE_PX, LARGEST_PLANE_PX, LEAST_SPREAD_PX = 1.0, 0.5, 1000.0, 0.1
"""What a disparity, a plane and a deviation are at least, and a plane at most."""
LEAST_COUNT = 1e-6
Sums = npt.NDArray[np.float64]


def continue_planes(
    disparity_px: FloatMap, confidence: FloatMap, at: npt.NDArray[np.intp]
) -> tuple[FloatMap, FloatMap]:
    """Return what planes say of pixels, (REACHES, n) px, and what a rule looks at of them (CLUES_EACH * REACHES, n).

    Args:
        disparity_px: (height, width).
        confidence: (height, width) in [0, 1]: a pixel counts by its fourth power, for what was filled in says little.
        at: (n,) indices of pixels.
    """
    width = disparity_px.shape[1]
    weight = np.square(np.square(confidence))
    sums = [_pool(map_) for map_ in (weight, weight * disparity_px, weight * disparity_px * disparity_px)]
    row, column = at // width, at % width
    cell = row // CELL * sums[0].shape[1] + column // CELL
    across, down = (
        ((along % CELL).astype(np.float32) + np.float32(0.5)) / np.float32(CELL) - np.float32(0.5)
        for along in (column, row)
    )
    own = np.log(np.maximum(disparity_px.reshape(-1)[at], np.float32(LEAST_PX)))
    planes_px, clues = [], []
    for reach in REACHES:
        middle, slope_x, slope_y, spread, mean, count = (map_.reshape(-1).take(cell) for map_ in _fit(sums, reach))
        plane_px = np.clip(middle + slope_x * across + slope_y * down, LEAST_PLANE_PX, LARGEST_PLANE_PX)
        planes_px.append(plane_px)
        clues += [np.log(plane_px) - own, spread, mean - own, count]
    return np.stack(planes_px), np.stack(clues)


def _pool(map_: FloatMap) -> Sums:
    """Return the means of cells, of (height / CELL, width / CELL), rounded up; beyond the border lies 0."""
    height, width = map_.shape
    rows, columns = -(-height // CELL), -(-width // CELL)
    whole = cv2.copyMakeBorder(map_, 0, rows * CELL - height, 0, columns * CELL - width, cv2.BORDER_CONSTANT)
    return np.asarray(cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA), np.float64)


def _fit(sums: Sequence[Sums], reach: int) -> list[FloatMap]:
    """Fit a plane to the window around each cell.

    Args:
        sums: the weight, and weighted disparity and its square, of each cell.
        reach: columns and rows from a pixel to the window's border.

    Returns:
        Maps of the cells: the plane at the cell's middle and its slopes along x and y, px and px a cell; the logarithms
        of the deviation from it, px, of the window's mean, px, and of its mean weight.
    """
    side = 2 * round(reach / CELL) + 1
    y, x = np.mgrid[: sums[0].shape[0], : sums[0].shape[1]].astype(np.float64)

    def mean(map_: Sums) -> Sums:
        return np.asarray(cv2.blur(map_, (side, side), borderType=cv2.BORDER_CONSTANT), np.float64)

    weight, value, square = sums
    count = np.maximum(mean(weight), LEAST_COUNT)
    mx, my, mv = mean(weight * x) / count, mean(weight * y) / count, mean(value) / count
    least = LEAST_SPREAD * (side / 2) ** 2
    xx, yy = mean(weight * x * x) / count - mx * mx + least, mean(weight * y * y) / count - my * my + least
    xy = mean(weight * x * y) / count - mx * my
    xv, yv = mean(value * x) / count - mx * mv, mean(value * y) / count - my * mv
    slope_x, slope_y = (yy * xv - xy * yv) / (xx * yy - xy * xy), (xx * yv - xy * xv) / (xx * yy - xy * xy)
    spread = np.sqrt(np.maximum(mean(square) / count - mv * mv - slope_x * xv - slope_y * yv, 0))
    middle = mv + slope_x * (x - mx) + slope_y * (y - my)
    logs = np.log(spread + LEAST_SPREAD_PX), np.log(np.maximum(mv, LEAST_PLANE_PX)), np.log(count + LEAST_COUNT)
    return [map_.astype(np.float32) for map_ in (middle, slope_x, slope_y, *logs)]
