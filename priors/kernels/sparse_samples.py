"""The samples of a sparse depth map: their list, their spacing, what the camera cannot see, local slopes.

Samples are kept in image order (row by row, left to right); `row_start` (height + 1,) names each row's first.
A window around a sample is then a few short runs, found by pointers that only move forward.
"""

from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import FAST, compiled

Ints: TypeAlias = npt.NDArray[np.int32]
Floats: TypeAlias = npt.NDArray[np.float32]
BESIDE = np.float32(1 / 3)  # how likely a sample with a nearer surface on one side is covered, at least
BESIDE_PX, BETWEEN_PX = np.float32(1), np.float32(2)  # least parallax that can cover a sample
ONE = np.float32(1)
NEAREST_M, FARTHEST_M = np.float32(1e-3), np.float32(1e4)  # their squares and inverses are far from float32's limits
MOST_NEIGHBOURS = 256


class SparseSamples(NamedTuple):
    """The n samples of a sparse depth map, in image order."""

    row_start: Ints
    """(height + 1,): the first sample of each row; the last entry is n."""
    row: Ints
    column: Ints
    inverse: Floats
    """(n,) inverse depth, 1/m."""


def list_samples(sparse_m: Floats) -> SparseSamples:
    """List the samples of a map (height, width), metres; what is not between NEAREST_M and FARTHEST_M is none."""
    height, width = sparse_m.shape
    index = np.flatnonzero(sparse_m > NEAREST_M)
    depth_m = sparse_m.ravel()[index]
    if not (depth_m < FARTHEST_M).all():
        index, depth_m = index[depth_m < FARTHEST_M], depth_m[depth_m < FARTHEST_M]
    row, column = np.divmod(index.astype(np.int32), np.int32(width))
    row_start = np.searchsorted(row, np.arange(height + 1)).astype(np.int32)
    return SparseSamples(row_start, row, column, ONE / depth_m)


@compiled
def downsample(row: Ints, column: Ints, inverse: Floats, step: int, height: int, width: int) -> Floats:
    """Return the sparse map (height, width), metres, that is step times smaller: the nearest sample of every cell."""
    sparse_m = np.zeros((height, width), np.float32)
    for i in range(len(row)):
        y, x, depth_m = row[i] // step, column[i] // step, ONE / inverse[i]
        if sparse_m[y, x] == 0 or depth_m < sparse_m[y, x]:
            sparse_m[y, x] = depth_m
    return sparse_m


@compiled
def keep(row_start: Ints, row: Ints, column: Ints, inverse: Floats, kept: npt.NDArray[np.bool_]) -> SparseSamples:
    """List the samples where kept (n,) is true."""
    count = np.zeros_like(row_start)
    for i in range(len(row)):
        count[row[i] + 1] += kept[i]
    return SparseSamples(np.cumsum(count).astype(np.int32), row[kept], column[kept], inverse[kept])


@compiled
def gaps(row_start: Ints, row: Ints, column: Ints, reach: int, step: int) -> tuple[float, float]:
    """Measure the spacing (down, across), pixels: median distance to the nearest sample in a 90 degree cone.

    Every step-th sample is asked; one that has none within reach counts as reach.
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


@compiled(fastmath=FAST, error_model="numpy")
def covered(
    row_start: Ints,
    row: Ints,
    column: Ints,
    inverse: Floats,
    pull_y: Floats,
    pull_x: Floats,
    gap_y: float,
    gap_x: float,
    reach_y: int,
    reach_x: int,
    behind: float,
    nearest: Floats,
    step: int,
) -> Floats:
    """Tell how likely (n,) it is that the camera does not see a sample, because a nearer surface covers it.

    Against the far sample i, a near one k is shifted by s = (inverse[k] - inverse[i]) * pull from the scanner's view to
    the camera's. In the scanner's view the near surface's edge lies somewhere within one gap of k, and before i; sample
    i at distance d from k (in gaps) is covered where the shifted edge passes it: 1 - d / min(1, d + s).
    A sample with near ones on opposite sides is covered for certain.

    Args:
        row_start, row, column, inverse: the samples.
        pull_y, pull_x: (n,) parallax between scanner and camera, pixels per unit of inverse depth (px m).
        gap_y, gap_x: the samples' spacing, pixels.
        reach_y, reach_x: half the window to look for nearer samples in, pixels.
        behind: ratio of inverse depths from which on a sample is nearer.
        nearest, step: largest inverse depth in the window of every cell of step pixels; most samples need no more.
    """
    likely = np.zeros(len(row), np.float32)
    pointer = np.zeros(len(row_start), np.int32)
    per_y, per_x = np.float32(1 / gap_y**2), np.float32(1 / gap_x**2)
    for i in range(len(row)):
        y, x = row[i], column[i]
        top, bottom = max(0, y - reach_y), min(len(row_start) - 1, y + reach_y + 1)
        if i == row_start[y]:
            pointer[top:bottom] = row_start[top:bottom]
        pull = abs(pull_y[i]) + abs(pull_x[i])
        nearer = max(inverse[i] * np.float32(behind), inverse[i] + BESIDE_PX / pull)
        if nearest[y // step, x // step] <= nearer:
            continue
        free, floor = ONE, np.float32(0)
        upper_left, upper_right, lower_left, lower_right = False, False, False, False
        for r in range(top, bottom):
            k, last = pointer[r], row_start[r + 1]
            while k < last and column[k] < x - reach_x:
                k += 1
            pointer[r] = k
            while k < last and column[k] <= x + reach_x:
                if inverse[k] > nearer:
                    dy, dx = np.float32(y - r), np.float32(x - column[k])
                    away = np.sqrt(dy * dy * per_y + dx * dx * per_x)
                    along = (inverse[k] - inverse[i]) * (pull_y[i] * dy + pull_x[i] * dx) / (dy * dy + dx * dx)
                    if away < ONE:
                        floor = BESIDE
                        free *= min(ONE, away / min(ONE, away * (ONE + max(along, np.float32(0)))))
                    if (inverse[k] - inverse[i]) * pull > BETWEEN_PX:
                        upper_left |= r <= y and column[k] <= x
                        upper_right |= r <= y and column[k] >= x
                        lower_left |= r >= y and column[k] <= x
                        lower_right |= r >= y and column[k] >= x
                k += 1
        between = (upper_left and lower_right) or (upper_right and lower_left)
        likely[i] = ONE if between else max(floor, ONE - free)
    return likely


@compiled(fastmath=FAST, error_model="numpy")
def fit_plane(
    value: Floats,
    below: Floats,
    right: Floats,
    weight: Floats,
    count: int,
    tolerance: float,
    ridge: float,
) -> tuple[np.float32, np.float32]:
    """Fit value ~ constant + slope_y * below + slope_x * right; values far from 0 weigh less (Geman-McClure)."""
    s = sy = sx = syy = sxy = sxx = sv = svy = svx = np.float32(0)
    per = ONE / (tolerance * tolerance)
    for j in range(count):
        v, y, x = value[j], below[j], right[j]
        w = ONE + v * v * per
        w = weight[j] / (w * w)
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


@compiled(fastmath=FAST, error_model="numpy")
def slopes(
    row_start: Ints,
    row: Ints,
    column: Ints,
    inverse: Floats,
    reach_y: int,
    reach_x: int,
    tolerance: Floats,
    ridge: float,
    share: int,
) -> tuple[Floats, Floats]:
    """Fit a plane in inverse depth around every sample: d/dy and d/dx (n,), 1/(m px).

    Weighted least squares over the window; weights fall with distance and with the difference in inverse depth, in
    units of tolerance (n,). ridge (px^2) holds at 0 a slope that no neighbour tells. Up to `share` samples in a row, of
    one surface by a quarter of the tolerance, have the first one's slope.
    """
    closeness = np.empty((2 * reach_y + 1, 2 * reach_x + 1), np.float32)
    for r in range(2 * reach_y + 1):
        for c in range(2 * reach_x + 1):
            closeness[r, c] = 1 / (1 + 4 * ((r - reach_y) / reach_y) ** 2 + 4 * ((c - reach_x) / reach_x) ** 2)
    leader = 0
    slope_y, slope_x = np.zeros(len(row), np.float32), np.zeros(len(row), np.float32)
    pointer = np.zeros(len(row_start), np.int32)
    value, below = np.empty(MOST_NEIGHBOURS, np.float32), np.empty(MOST_NEIGHBOURS, np.float32)
    right, weight = np.empty(MOST_NEIGHBOURS, np.float32), np.empty(MOST_NEIGHBOURS, np.float32)
    for i in range(len(row)):
        y, x = row[i], column[i]
        top, bottom = max(0, y - reach_y), min(len(row_start) - 1, y + reach_y + 1)
        if i == row_start[y]:
            pointer[top:bottom] = row_start[top:bottom]
        elif (
            i - leader < share
            and x - column[leader] <= reach_x
            and abs(inverse[i] - inverse[leader]) < tolerance[i] / 4
        ):
            slope_y[i], slope_x[i] = slope_y[leader], slope_x[leader]
            continue
        leader = i
        n = 0
        for r in range(top, bottom):
            k, last = pointer[r], row_start[r + 1]
            while k < last and column[k] < x - reach_x:
                k += 1
            pointer[r] = k
            while k < last and column[k] <= x + reach_x and n < MOST_NEIGHBOURS:
                value[n], below[n], right[n] = inverse[k] - inverse[i], r - y, column[k] - x
                weight[n] = closeness[r - y + reach_y, column[k] - x + reach_x]
                n += 1
                k += 1
        slope_y[i], slope_x[i] = fit_plane(value, below, right, weight, n, tolerance[i], np.float32(ridge))
    return slope_y, slope_x
