"""Matching distributions in one pass over memory; the readable twin is nets/volume.expect in plain torch."""

import math

import numpy as np
from numba import njit, prange

from priors.types import FloatMap


@njit(cache=True, nogil=True, fastmath=True, parallel=True)
def expect(logits: FloatMap, position_px: FloatMap, window: int, mean: FloatMap, sigma: FloatMap) -> None:
    """Write mean and deviation (n,) of the distributions that logits (n, planes) describe.

    position_px is (n, planes) or (1, planes). The mean is over `window` planes to each side of the likeliest, the
    deviation over all. Pixels are handed to threads in stretches.
    """
    count, planes = logits.shape
    own = position_px.shape[0] > 1
    stretches = -(-count // 1024)
    for stretch in prange(stretches):
        share = np.empty(planes, np.float32)
        for n in range(1024 * stretch, min(count, 1024 * (stretch + 1))):
            position = position_px[n if own else 0]
            best = 0
            for k in range(1, planes):
                if logits[n, k] > logits[n, best]:
                    best = k
            most = logits[n, best]
            whole, part, middle = np.float32(0), np.float32(0), np.float32(0)
            for k in range(planes):
                share[k] = math.exp(logits[n, k] - most)
                whole += share[k]
                if abs(k - best) <= window:
                    part += share[k]
                    middle += share[k] * position[k]
            middle /= part
            variance = np.float32(0)
            for k in range(planes):
                variance += share[k] * (position[k] - middle) ** 2
            mean[n], sigma[n] = middle, math.sqrt(variance / whole + np.float32(1e-6))


@njit(cache=True, nogil=True, fastmath=True, parallel=True)
def unit(features: FloatMap, groups: int, out: FloatMap) -> None:
    """Write features (rows, w, c) with every group of channels of length 1; nets/volume.unit is the twin."""
    rows, width, channels = features.shape
    size = channels // groups
    for row in prange(rows):
        for x in range(width):
            for group in range(groups):
                total = np.float32(1e-4)
                for k in range(group * size, (group + 1) * size):
                    total += features[row, x, k] * features[row, x, k]
                scale = np.float32(1) / math.sqrt(total)
                for k in range(group * size, (group + 1) * size):
                    out[row, x, k] = features[row, x, k] * scale
