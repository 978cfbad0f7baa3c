"""The error model: from the probability of one error to that of another.

A method says how likely a value is right within 1 m, within 1 px of disparity, or within a share of the depth. Here the
relative error has a Laplace distribution, P(|error| <= a) = 1 - exp(-a / spread): one number, the spread, then answers
all three. The spread is the mean relative error to expect.
"""

import numpy as np

from eval.calibration import Tolerance
from priors.types import Depth, FloatMap

WITHIN = Tolerance(0.05, "share")
"""What `Depth.within_5_percent` is the probability of."""
METRE, PIXEL = Tolerance(1.0, "m"), Tolerance(1.0, "px")
LEAST, MOST = 1e-3, 1.0
"""Bounds of the spread: no sensor is surer, and beyond it nothing is known."""
SUREST = np.float32(1 - 1e-6)


def share_allowed(depth_m: FloatMap, within: Tolerance, fx_baseline: float | None = None) -> FloatMap | np.float32:
    """Return a tolerance as a share of the depth (height, width); 0 where there is no value.

    Args:
        depth_m: (height, width) metres.
        within: the tolerance.
        fx_baseline: focal length times baseline, px m, for a tolerance in pixels.

    Raises:
        ValueError: the tolerance is in pixels, and fx_baseline is not known.
    """
    amount = np.float32(within.amount)
    if within.unit == "share":
        return amount
    if within.unit == "px":
        if fx_baseline is None:
            raise ValueError("a tolerance in pixels: pass fx_baseline, px m")
        return np.asarray(depth_m * (amount / np.float32(fx_baseline)), np.float32)
    return np.divide(amount, depth_m, out=np.zeros_like(depth_m), where=depth_m > 0)


def spread_of(depth_m: FloatMap, chance: FloatMap, within: Tolerance, fx_baseline: float | None = None) -> FloatMap:
    """Return the mean relative error (height, width) to expect where `chance` is the probability of `within`.

    It is MOST where there is no value, or the chance is 0.
    """
    allowed = share_allowed(depth_m, within, fx_baseline)
    rate = -np.log1p(-np.clip(chance, np.float32(0), SUREST))
    spread = np.divide(allowed, rate, out=np.full_like(rate, MOST), where=(rate > 0) & (depth_m > 0))
    return np.clip(spread, np.float32(LEAST), np.float32(MOST), out=spread)


def chance_of(depth_m: FloatMap, spread: FloatMap, within: Tolerance, fx_baseline: float | None = None) -> FloatMap:
    """Return the probability (height, width) of a relative error within a tolerance; 0 where there is no value."""
    allowed = share_allowed(depth_m, within, fx_baseline)
    chance = -np.expm1(-allowed / np.maximum(spread, np.float32(LEAST)))
    return np.where(depth_m > 0, chance, np.float32(0)).astype(np.float32)


def within_5_percent(depth: Depth, within: Tolerance, fx_baseline: float | None = None) -> FloatMap:
    """Return the probability (height, width) of a relative error of 5 % or less, by a map's own confidence.

    Args:
        depth: a map with a confidence; DataError where it has none.
        within: what the confidence is the probability of.
        fx_baseline: focal length times baseline, px m, for a tolerance in pixels.
    """
    trust = depth.trust()
    chance = chance_of(depth.depth_m, spread_of(depth.depth_m, trust, within, fx_baseline), WITHIN)
    return np.where(trust > 0, chance, np.float32(0)).astype(np.float32)


def relative_spread(depth: Depth, usual: float) -> FloatMap:
    """Return the mean relative error to expect of a map (height, width): by `within_5_percent`, else the usual one."""
    if depth.within_5_percent is None:
        return np.where(depth.valid, np.float32(usual), np.float32(MOST)).astype(np.float32)
    return spread_of(depth.depth_m, depth.within_5_percent, WITHIN)
