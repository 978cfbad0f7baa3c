"""Convex upsampling in one pass over memory; the readable twin is nets/upsample.py in plain torch."""

import numpy as np
from numba import njit, prange

from priors.types import FloatMap


@njit(cache=True, nogil=True, fastmath=True, parallel=True)
def upsample(values: FloatMap, share: FloatMap, factor: int, out: FloatMap) -> None:
    """Write averages of values (b, c, h, w) by positive shares (b, h, w, factor^2 * 9): (b, c, h * factor, ...)."""
    batch, channels, height, width = values.shape
    for row in prange(batch * height):
        b, y = row // height, row % height
        above, below = max(y - 1, 0), min(y + 1, height - 1)
        around = np.empty((channels, 9), np.float32)
        for x in range(width):
            left, right = max(x - 1, 0), min(x + 1, width - 1)
            for c in range(channels):
                line = values[b, c]
                around[c, 0], around[c, 1], around[c, 2] = line[above, left], line[above, x], line[above, right]
                around[c, 3], around[c, 4], around[c, 5] = line[y, left], line[y, x], line[y, right]
                around[c, 6], around[c, 7], around[c, 8] = line[below, left], line[below, x], line[below, right]
            for part in range(factor * factor):
                weights = share[b, y, x, 9 * part : 9 * part + 9]
                total = np.float32(0)
                for k in range(9):
                    total += weights[k]
                scale = np.float32(1) / total
                for c in range(channels):
                    found = np.float32(0)
                    for k in range(9):
                        found += weights[k] * around[c, k]
                    out[b, c, factor * y + part // factor, factor * x + part % factor] = found * scale
