"""Convex upsampling in one pass over memory; the readable twin is nets/upsample.py in plain torch."""

import numpy as np

from priors.kernels.floats import Bits, exponentiate, widen
from priors.machine.compiled import FAST, compiled
from priors.types import FloatMap


@compiled(fastmath=FAST, error_model="numpy")
def upsample(values: FloatMap, logits: Bits, factor: int, largest: float, out: FloatMap, first: int, last: int) -> None:
    """Write averages of values (b, c, h, w) by softmax(logits (b, h, w, factor^2 * 9)): (b, c, h * factor, ...).

    Logits are stored in 16 or 32 bits, and held between -largest and largest. Done are lines first to last - 1 of
    the b * h there are.
    """
    _, channels, height, width = values.shape
    for row in range(first, last):
        b, y = row // height, row % height
        above, below = max(y - 1, 0), min(y + 1, height - 1)
        around = np.empty((channels, 9), np.float32)
        share, scratch = np.empty(logits[b, y].size, np.float32), np.empty(logits[b, y].size, np.float32)
        widen(logits[b, y].reshape(-1), share)
        for k in range(share.size):
            share[k] = min(max(share[k], np.float32(-largest)), np.float32(largest)) - np.float32(largest / 2)
        exponentiate(share, scratch)
        shares = share.reshape((width, factor * factor, 9))
        for x in range(width):
            left, right = max(x - 1, 0), min(x + 1, width - 1)
            for c in range(channels):
                line = values[b, c]
                around[c, 0], around[c, 1], around[c, 2] = line[above, left], line[above, x], line[above, right]
                around[c, 3], around[c, 4], around[c, 5] = line[y, left], line[y, x], line[y, right]
                around[c, 6], around[c, 7], around[c, 8] = line[below, left], line[below, x], line[below, right]
            for part in range(factor * factor):
                weights = shares[x, part]
                total = np.float32(0)
                for k in range(9):
                    total += weights[k]
                scale = np.float32(1) / total
                for c in range(channels):
                    average = np.float32(0)
                    for k in range(9):
                        average += weights[k] * around[c, k]
                    out[b, c, factor * y + part // factor, factor * x + part % factor] = average * scale
