"""Compare a depth map with a stereo match, and with what lies around."""

import numpy as np
import numpy.typing as npt
from numba import njit


@njit(cache=True, nogil=True)
def deny(
    depth_m: npt.NDArray[np.float32],
    matched_px: npt.NDArray[np.float32],
    focal_baseline: float,
    slack_px: float,
    slack: float,
) -> npt.NDArray[np.bool_]:
    """Tell which depths (height, width; inf = none) lie outside what a match says, where it says something (> 0).

    A depth agrees where its disparity lies among those matched in the 3x3 pixels around, give or take slack_px and the
    share `slack` of its own.
    """
    height, width = depth_m.shape
    denied = np.zeros(depth_m.shape, dtype=np.bool_)
    for row in range(height):
        for column in range(width):
            matched = matched_px[row, column]
            if not (matched > 0 and depth_m[row, column] < np.inf):
                continue
            disparity = focal_baseline / depth_m[row, column]
            tolerance = slack_px + slack * disparity
            if abs(disparity - matched) <= tolerance:
                continue  # nearly all: the neighbours need no look
            low, high = matched, matched
            for y in range(max(0, row - 1), min(height, row + 2)):
                for x in range(max(0, column - 1), min(width, column + 2)):
                    if matched_px[y, x] > 0:
                        low, high = min(low, matched_px[y, x]), max(high, matched_px[y, x])
            denied[row, column] = disparity < low - tolerance or disparity > high + tolerance
    return denied


@njit(cache=True, nogil=True)
def hide(
    depth_m: npt.NDArray[np.float32],
    nearest_m: npt.NDArray[np.float32],
    share: float,
    hidden: npt.NDArray[np.bool_],
) -> None:
    """Mark in hidden, in place, the depths (height, width; inf = none) with nearer ones in all four quadrants around.

    nearest_m (height + rows, width + columns) holds the nearest depth of every window that ends at a row and column;
    nearer is by the share of the depth.
    """
    height, width = depth_m.shape
    rows, columns = nearest_m.shape[0] - height, nearest_m.shape[1] - width
    kept = np.float32(1.0 - share)
    for row in range(height):
        for column in range(width):
            limit = depth_m[row, column] * kept
            above = max(nearest_m[row, column], nearest_m[row, column + columns])
            below = max(nearest_m[row + rows, column], nearest_m[row + rows, column + columns])
            hidden[row, column] |= (max(above, below) < limit) & (limit < np.inf)  # no branch: it vectorises
