"""Matching distributions in one pass over memory; the readable twin is nets/cost_volume.expect in plain torch."""

import math

import numpy as np

from priors.kernels.floats import Bits, exponentiate, widen
from priors.machine.compiled import FAST, compiled
from priors.types import FloatMap

STRETCH = 1024
"""Pixels that are done at a time."""


@compiled(fastmath=FAST, error_model="numpy")
def expect(
    logits: Bits, position_px: FloatMap, window: int, mean: FloatMap, sigma: FloatMap, first: int, last: int
) -> None:
    """Write mean and deviation (n,) of the distributions that logits (n, planes), in 16 or 32 bits, describe.

    position_px is (n, planes) or (1, planes). The mean is over `window` planes to each side of the likeliest, the
    deviation over all. Done are pixels first to last - 1; first is a multiple of STRETCH.
    """
    planes = logits.shape[1]
    own = position_px.shape[0] > 1
    for start in range(first, last, STRETCH):
        end = min(last, start + STRETCH)
        flat, scratch = np.empty((end - start) * planes, np.float32), np.empty((end - start) * planes, np.float32)
        widen(logits[start:end].reshape(-1), flat)
        shares = flat.reshape((end - start, planes))
        likeliest = np.empty(end - start, np.int64)
        for n in range(end - start):
            best = 0
            for k in range(1, planes):
                if shares[n, k] > shares[n, best]:
                    best = k
            most = shares[n, best]
            likeliest[n] = best
            for k in range(planes):
                shares[n, k] = max(shares[n, k] - most, np.float32(-80))
        exponentiate(flat, scratch)
        for n in range(end - start):
            position = position_px[start + n if own else 0]
            whole, part, middle = np.float32(0), np.float32(0), np.float32(0)
            for k in range(planes):
                whole += shares[n, k]
                if abs(k - likeliest[n]) <= window:
                    part += shares[n, k]
                    middle += shares[n, k] * position[k]
            middle = middle / part if whole < np.inf else whole  # a logit that is no number is one of all planes
            variance = np.float32(0)
            for k in range(planes):
                variance += shares[n, k] * (position[k] - middle) ** 2
            mean[start + n], sigma[start + n] = middle, math.sqrt(variance / whole + np.float32(1e-6))
