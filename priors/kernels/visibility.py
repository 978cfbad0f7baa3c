"""Visibility of LiDAR points: past free space, not behind a nearer surface, not where stereo sees another.

Fused loops: over whole images, numpy's temporary arrays cost more than the arithmetic.
"""

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import compiled


@compiled
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


@compiled
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
    nearer_share = np.float32(1.0 - share)
    for row in range(height):
        for column in range(width):
            limit = depth_m[row, column] * nearer_share
            above = max(nearest_m[row, column], nearest_m[row, column + columns])
            below = max(nearest_m[row + rows, column], nearest_m[row + rows, column + columns])
            hidden[row, column] |= (max(above, below) < limit) & (limit < np.inf)  # no branch: it vectorises


@compiled
def free_until(nearest_m: npt.NDArray[np.float32], height: int, share: float) -> npt.NDArray[np.float32]:
    """Return the depth (height, width) up to which space is free, where there are samples both above and below; else 0.

    nearest_m (height + rows, width) holds the nearest depth of every window that ends at a row and is centred on a
    column, inf where it has none. Free space ends by the share before the nearest sample.
    """
    width = nearest_m.shape[1]
    rows = nearest_m.shape[0] - height
    nearer_share = np.float32(1.0 - share)
    free_m = np.zeros((height, width), dtype=np.float32)
    for row in range(height):
        for column in range(width):
            above, below = nearest_m[row, column], nearest_m[row + rows, column]
            if max(above, below) < np.inf:
                free_m[row, column] = min(above, below) * nearer_share
    return free_m
