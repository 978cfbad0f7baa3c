"""Which cells of a view Gaussians cover that were taken already, compiled: nerf/gaussians/cover.py says what for."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import compiled


class Cells(NamedTuple):
    """A view in cells of step x step pixels."""

    depth_m: npt.NDArray[np.float32]
    """(rows, columns) camera-z depth of the surface at each cell's middle, metres."""
    filled: npt.NDArray[np.uint8]
    """(rows, columns) 1 where a point lies in the cell; filled in place."""
    covered: npt.NDArray[np.uint8]
    """(rows, columns) 1 where one lies at about the surface's depth; filled in place."""


@compiled(error_model="numpy")
def cover(
    means_m: npt.NDArray[np.float32],
    projection: npt.NDArray[np.float64],
    cells: Cells,
    step: int,
    same: float,
) -> None:
    """Note points (n, 3) of the scene's frame, metres, in a view.

    Args:
        means_m: the points.
        projection: (3, 4) K [R | t]: from the scene's frame to pixels times depth.
        cells: where they are noted.
        step: side of a cell, pixels.
        same: share of the surface's depth by which a point may be off.
    """
    rows, columns = cells.depth_m.shape
    for i in range(len(means_m)):
        x, y, w = means_m[i, 0], means_m[i, 1], means_m[i, 2]
        z = projection[2, 0] * x + projection[2, 1] * y + projection[2, 2] * w + projection[2, 3]
        if z <= 0:
            continue
        u = (projection[0, 0] * x + projection[0, 1] * y + projection[0, 2] * w + projection[0, 3]) / z
        v = (projection[1, 0] * x + projection[1, 1] * y + projection[1, 2] * w + projection[1, 3]) / z
        a, b = (v + 0.5) / step, (u + 0.5) / step
        if 0 <= a < rows and 0 <= b < columns:
            row, column = int(a), int(b)
            cells.filled[row, column] = 1
            surface = cells.depth_m[row, column]
            if abs(z - surface) < same * surface:
                cells.covered[row, column] = 1
