"""Kernels on the samples of a sparse depth map: list, spacing, what is seen through, local slopes.

Samples are kept in image order (row by row, left to right); `row_start` (height + 1,) names each row's first.
A window around a sample is then a few short runs, found by pointers that only move forward.
"""

import numpy as np
from numba import njit

MOST_NEIGHBOURS = 256


@njit(cache=True, nogil=True)
def gather(sparse_m):
    """List the samples of a map (height, width): row_start (height + 1,), row, column, inverse depth (n,)."""
    height, width = sparse_m.shape
    row_start = np.zeros(height + 1, np.int32)
    count = 0
    for y in range(height):
        for x in range(width):
            if sparse_m[y, x] > 0:
                count += 1
        row_start[y + 1] = count
    row, column, inverse = np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count, np.float32)
    i = 0
    for y in range(height):
        for x in range(width):
            if sparse_m[y, x] > 0:
                row[i], column[i], inverse[i] = y, x, np.float32(1) / sparse_m[y, x]
                i += 1
    return row_start, row, column, inverse


@njit(cache=True, nogil=True)
def keep(row_start, row, column, inverse, kept):
    """List the samples where kept (n,) is true, as gather does."""
    starts = np.zeros_like(row_start)
    for i in range(len(row)):
        starts[row[i] + 1] += kept[i]
    return np.cumsum(starts).astype(np.int32), row[kept], column[kept], inverse[kept]


@njit(cache=True, nogil=True)
def gaps(row_start, row, column, reach, step):
    """Measure the spacing (down, across), pixels: median distance to the nearest sample in a 90 degree cone.

    Every step-th sample is asked; `reach` stands for the distance where there is none within reach.
    """
    height = len(row_start) - 1
    asked = (len(row) + step - 1) // step
    down, across = np.full(asked, reach, np.int32), np.full(asked, reach, np.int32)
    for j in range(asked):
        y, x = row[j * step], column[j * step]
        for dy in range(min(reach, height - y)):
            if dy >= across[j] and down[j] < reach:
                break
            last = row_start[y + dy + 1]
            k = row_start[y + dy] + np.searchsorted(column[row_start[y + dy] : last], x - dy)
            while k < last and column[k] - x <= dy:
                if dy > 0:
                    down[j] = min(down[j], dy)
                k += 1
            if k < last:
                across[j] = min(across[j], column[k] - x)
    return np.median(down), np.median(across)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def seen_through(row_start, row, column, inverse, pull, reach_y, reach_x, behind, least_px):
    """Mark the samples (n,) that the camera cannot see: a nearer surface lies on opposite sides of them.

    A scanner beside the camera looks past a near edge at what the camera sees covered. In the image such a sample lies
    among those of the near surface. It can be there only if scanner and camera see the two depths far enough apart:
    `pull` (n,) is that parallax in pixels per unit of inverse depth, and it must reach `least_px`.
    """
    hidden = np.zeros(len(row), np.bool_)
    height = len(row_start) - 1
    pointer = np.zeros(height, np.int32)
    for i in range(len(row)):
        y, x = row[i], column[i]
        top, bottom = max(0, y - reach_y), min(height, y + reach_y + 1)
        if i == row_start[y]:
            pointer[top:bottom] = row_start[top:bottom]
        nearer = max(inverse[i] * (1 + behind), inverse[i] + least_px / pull[i])
        upper_left, upper_right, lower_left, lower_right = False, False, False, False
        for r in range(top, bottom):
            last = row_start[r + 1]
            k = pointer[r]
            while k < last and column[k] < x - reach_x:
                k += 1
            pointer[r] = k
            while k < last and column[k] <= x + reach_x:
                if inverse[k] > nearer:
                    upper_left |= r <= y and column[k] <= x
                    upper_right |= r <= y and column[k] >= x
                    lower_left |= r >= y and column[k] <= x
                    lower_right |= r >= y and column[k] >= x
                k += 1
        hidden[i] = (upper_left and lower_right) or (upper_right and lower_left)
    return hidden


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def fit_plane(value, below, right, weight, slope_y, slope_x, tolerance, ridge):
    """Fit value ~ constant + slope_y * below + slope_x * right once, weighing by the residuals to the slopes given."""
    s = sy = sx = syy = sxy = sxx = sv = svy = svx = np.float32(0)
    for j in range(len(value)):
        v, y, x = value[j], below[j], right[j]
        off = (v - slope_y * y - slope_x * x) / tolerance
        w = weight[j] / ((1 + off * off) * (1 + off * off))
        s += w
        sy += w * y
        sx += w * x
        syy += w * y * y
        sxy += w * x * y
        sxx += w * x * x
        sv += w * v
        svy += w * v * y
        svx += w * v * x
    y, x, v = sy / s, sx / s, sv / s
    yy, xx, xy = syy / s - y * y + ridge, sxx / s - x * x + ridge, sxy / s - x * y
    vy, vx = svy / s - v * y, svx / s - v * x
    det = yy * xx - xy * xy
    return (vy * xx - vx * xy) / det, (vx * yy - vy * xy) / det


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def slopes(row_start, row, column, inverse, reach_y, reach_x, tolerance, ridge):
    """Fit a plane in inverse depth around every sample: d/dy and d/dx (n,), 1/(m px).

    Two rounds of weighted least squares; weights fall with distance and, in units of tolerance (n,), with the residual
    (Geman-McClure). ridge (px^2) holds at 0 a slope that no sample tells.
    """
    height = len(row_start) - 1
    closeness = np.empty((2 * reach_y + 1, 2 * reach_x + 1), np.float32)
    for r in range(2 * reach_y + 1):
        for c in range(2 * reach_x + 1):
            closeness[r, c] = 1 / (1 + 4 * ((r - reach_y) / reach_y) ** 2 + 4 * ((c - reach_x) / reach_x) ** 2)
    slope_y, slope_x = np.zeros(len(row), np.float32), np.zeros(len(row), np.float32)
    pointer = np.zeros(height, np.int32)
    value, below = np.empty(MOST_NEIGHBOURS, np.float32), np.empty(MOST_NEIGHBOURS, np.float32)
    right, weight = np.empty(MOST_NEIGHBOURS, np.float32), np.empty(MOST_NEIGHBOURS, np.float32)
    for i in range(len(row)):
        y, x = row[i], column[i]
        top, bottom = max(0, y - reach_y), min(height, y + reach_y + 1)
        if i == row_start[y]:
            pointer[top:bottom] = row_start[top:bottom]
        n = 0
        for r in range(top, bottom):
            last = row_start[r + 1]
            k = pointer[r]
            while k < last and column[k] < x - reach_x:
                k += 1
            pointer[r] = k
            while k < last and column[k] <= x + reach_x and n < MOST_NEIGHBOURS:
                value[n], below[n], right[n] = inverse[k] - inverse[i], r - y, column[k] - x
                weight[n] = closeness[r - y + reach_y, column[k] - x + reach_x]
                n += 1
                k += 1
        dy, dx = np.float32(0), np.float32(0)
        for shrink in (np.float32(1), np.float32(0.5)):
            dy, dx = fit_plane(value[:n], below[:n], right[:n], weight[:n], dy, dx, shrink * tolerance[i], ridge)
        slope_y[i], slope_x[i] = dy, dx
    return slope_y, slope_x
