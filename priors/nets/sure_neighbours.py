"""Sure neighbours: the first pixel to the left, to the right, above and below whose disparity is sure.

Inside a hole nothing around is right. What was matched at its rim may be, on one side or on another.
"""

import numpy as np
import numpy.typing as npt

from priors.types import FloatMap, Mask

SIDES = 4
"""Left, right, above, below."""
CLUES_EACH = 2
"""Of a neighbour: its disparity against the pixel's own, and its distance."""
NONE_AWAY = 400
"""Distance of a neighbour that is not there, pixels; its disparity is the pixel's own."""
LEAST_PX, LEAST_OFFERED_PX = 1.0, 0.5
"""What a pixel's own disparity and a neighbour's are at least, before their logarithm is taken."""


def find_sure(disparity_px: FloatMap, sure: Mask, at: npt.NDArray[np.intp]) -> tuple[FloatMap, FloatMap]:
    """Return sure neighbours' disparities (SIDES, n), px, and what a rule looks at of them (CLUES_EACH * SIDES, n).

    Args:
        disparity_px: (height, width).
        sure: (height, width), True where the disparity is.
        at: (n,) indices of pixels.
    """
    from priors.kernels.nearest_sure import find_nearest

    width = disparity_px.shape[1]
    nearest = np.empty((SIDES, *sure.shape), np.int32)
    find_nearest(np.ascontiguousarray(sure), nearest)
    row, column = at // width, at % width
    flat = disparity_px.reshape(-1)
    own = flat.take(at)
    offered_px, far = np.empty((2, SIDES, at.size), np.float32)
    for side, map_ in enumerate(nearest):
        place = map_.reshape(-1).take(at)
        there = row * width + place if side < SIDES // 2 else place * width + column
        offered_px[side] = np.where(place < 0, own, flat.take(np.maximum(there, 0)))
        far[side] = np.where(place < 0, NONE_AWAY, np.abs(place - (column if side < SIDES // 2 else row)))
    logs = np.log(np.maximum(offered_px, np.float32(LEAST_OFFERED_PX)))
    logs -= np.log(np.maximum(own, np.float32(LEAST_PX)))
    return offered_px, np.concatenate([logs, np.log1p(far)])
