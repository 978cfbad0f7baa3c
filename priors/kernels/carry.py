"""Carrying a disparity map to the next frame: each pixel's surface is moved by the camera's motion and drawn again."""

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import compiled

Map = npt.NDArray[np.float32]
NEAREST_M = 0.1
"""What comes nearer to the camera than this is not drawn."""
SAME_PX = 1.0
"""Disparities that differ by less are of one surface: there the pixel whose centre lies nearest is taken."""


@compiled
def carry(
    disparity_px: Map, trust: Map, T_now_before: npt.NDArray[np.float64], K: npt.NDArray[np.float64], fx_baseline: float
) -> tuple[Map, Map]:
    """Draw the surfaces of one frame as the next one sees them; the nearest wins.

    A pixel is a small slanted patch: its disparity goes on with the map's own slope, where that is below 1 px a pixel.
    The patch grows with the square of how much nearer it comes, as a road does: so no cracks open.

    Args:
        disparity_px: (h, w) of the frame before; 0: no value, nothing is drawn.
        trust: (h, w), moves with its disparity.
        T_now_before: (4, 4) points of the camera before in the camera now, metres.
        K: (3, 3) of both cameras, pixels.
        fx_baseline: focal length times baseline, px m: the depth of 1 px.

    Returns:
        disparity and trust (h, w) now; 0 where nothing is seen.
    """
    height, width = disparity_px.shape
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    T = T_now_before
    out, out_trust = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    far = np.full((height, width), np.inf, np.float32)
    for y in range(height):
        for x in range(width):
            here = disparity_px[y, x]
            if not (here > 0 and here < np.inf):
                continue
            z = fx_baseline / here
            X, Y = (x - cx) / fx * z, (y - cy) / fy * z
            moved_z = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * z + T[2, 3]
            if not (moved_z > NEAREST_M and moved_z < np.inf):
                continue
            u = fx * (T[0, 0] * X + T[0, 1] * Y + T[0, 2] * z + T[0, 3]) / moved_z + cx
            v = fy * (T[1, 0] * X + T[1, 1] * Y + T[1, 2] * z + T[1, 3]) / moved_z + cy
            growth = z / moved_z
            reach = 0.5 * max(growth * growth, 1.0) + 0.01
            if not (u > -reach and v > -reach and u < width - 1 + reach and v < height - 1 + reach):
                continue
            along_x, along_y = _slope(disparity_px, x, y)
            moved_px = fx_baseline / moved_z
            for row in range(max(0, int(np.ceil(v - reach))), min(height - 1, int(np.floor(v + reach))) + 1):
                for column in range(max(0, int(np.ceil(u - reach))), min(width - 1, int(np.floor(u + reach))) + 1):
                    value = np.float32(moved_px + along_x * (column - u) + along_y * (row - v))
                    away = np.float32((column - u) * (column - u) + (row - v) * (row - v))
                    there = out[row, column]
                    if value > there + SAME_PX or (value > there - SAME_PX and away < far[row, column]):
                        out[row, column] = max(value, np.float32(0))
                        out_trust[row, column] = trust[y, x]
                        far[row, column] = away
    return out, out_trust


@compiled(inline="always")
def _slope(disparity_px: Map, x: int, y: int) -> tuple[float, float]:
    """Return a map's slope at a pixel along the row and the column, px a pixel; 0 at borders and edges."""
    height, width = disparity_px.shape
    along_x, along_y = 0.0, 0.0
    if 0 < x < width - 1:
        step = 0.5 * (disparity_px[y, x + 1] - disparity_px[y, x - 1])
        along_x = step if abs(step) <= SAME_PX else 0.0
    if 0 < y < height - 1:
        step = 0.5 * (disparity_px[y + 1, x] - disparity_px[y - 1, x])
        along_y = step if abs(step) <= SAME_PX else 0.0
    return along_x, along_y
