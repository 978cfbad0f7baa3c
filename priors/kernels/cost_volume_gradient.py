"""Cost volumes with gradients, forward and backward: fetch, interpolate, multiply and sum in one pass over memory.

The readable twin is nets/cost_volume.py in plain torch, which takes a dozen passes. Rows are independent, so threads
share nothing. Without gradients, kernels/cost_volume.py does more at once.
"""

import numpy as np

from priors.machine.compiled import FAST, compiled
from priors.types import FloatMap


@compiled(fastmath=FAST, error_model="numpy")
def match(
    left: FloatMap, right: FloatMap, disparity_px: FloatMap, groups: int, out: FloatMap, first: int, last: int
) -> None:
    """Write the products of left (rows, w, c) and right at disparities (rows, w, planes): (rows, w, planes, groups).

    Done are rows first to last - 1.
    """
    _, width, channels = left.shape
    planes = disparity_px.shape[2]
    size = channels // groups
    product = np.empty(channels, np.float32)  # all channels first: a group is too short for the vector unit
    for row in range(first, last):
        for x in range(width):
            mine = left[row, x]
            for plane in range(planes):
                column = x - disparity_px[row, x, plane]
                if not (column >= 0 and column <= width - 1):
                    out[row, x, plane, :] = 0
                    continue
                x0 = min(int(column), max(0, width - 2))
                near, far = right[row, x0], right[row, min(x0 + 1, width - 1)]
                share = np.float32(column - x0)
                for k in range(channels):
                    product[k] = mine[k] * (near[k] + share * (far[k] - near[k]))
                for group in range(groups):
                    total = np.float32(0)
                    for k in range(group * size, (group + 1) * size):
                        total += product[k]
                    out[row, x, plane, group] = total


@compiled(fastmath=FAST, error_model="numpy")
def match_backward(
    left: FloatMap,
    right: FloatMap,
    disparity_px: FloatMap,
    d_out: FloatMap,
    d_left: FloatMap,
    d_right: FloatMap,
    d_disparity: FloatMap,
    first: int,
    last: int,
) -> None:
    """Add the gradients of `match` to d_left and d_right (both zero before), and write d_disparity; rows as there."""
    _, width, channels = left.shape
    planes, groups = d_out.shape[2], d_out.shape[3]
    size = channels // groups
    for row in range(first, last):
        for x in range(width):
            for plane in range(planes):
                d_disparity[row, x, plane] = 0
                column = x - disparity_px[row, x, plane]
                if not (column >= 0 and column <= width - 1):
                    continue
                x0 = min(int(column), max(0, width - 2))
                x1 = min(x0 + 1, width - 1)
                share = np.float32(column - x0)
                slope = np.float32(0)
                for group in range(groups):
                    d = d_out[row, x, plane, group]
                    d0, d1 = d * (np.float32(1) - share), d * share
                    near, far = np.float32(0), np.float32(0)
                    for k in range(group * size, (group + 1) * size):
                        a, r0, r1 = left[row, x, k], right[row, x0, k], right[row, x1, k]
                        near += a * r0
                        far += a * r1
                        d_left[row, x, k] += d0 * r0 + d1 * r1
                        d_right[row, x0, k] += d0 * a
                        d_right[row, x1, k] += d1 * a
                    slope += d * (far - near)
                d_disparity[row, x, plane] = -slope
