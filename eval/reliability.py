"""Reliability diagrams: the share of values that is right, for each stated probability (Niculescu-Mizil, ICML 2005).

Probabilities are cut into ten bins of equal width, as such diagrams are: calibration_error has bins of equal count, so
a diagram shows where the gaps are, and the error how much they weigh.
"""

from dataclasses import dataclass

import numpy as np

from eval.calibration import Tolerance, calibration_error
from eval.curves import Flat
from eval.depth import Mask

BINS = 10
LEAST_SHARE = 0.002
"""A bin with fewer of the values has no point: its share of right values is chance."""


@dataclass(frozen=True, slots=True)
class Reliability:
    """How what was stated compares with what came true; arrays are (BINS,)."""

    within: Tolerance
    """What was stated is the probability of."""
    stated: Flat
    """Mean stated probability of each bin; NaN where it has too few values."""
    right: Flat
    """Share of right values in it; NaN as well."""
    share: Flat
    """Share of all values that lie in it."""
    error: float
    """Expected calibration error."""

    @property
    def says(self) -> float:
        """Return the mean stated probability, of the bins that have a point."""
        return float(np.nansum(self.stated * self.share) / max(self.share[np.isfinite(self.stated)].sum(), 1e-12))

    @property
    def is_right(self) -> float:
        """Return the share of right values, of the bins that have a point."""
        return float(np.nansum(self.right * self.share) / max(self.share[np.isfinite(self.right)].sum(), 1e-12))


def reliability(confidence: Flat, right: Mask, within: Tolerance) -> Reliability:
    """Compare what was stated of n values with what came true.

    Args:
        confidence: (n,) probabilities; values of 0 or NaN are left out: nothing is stated of them.
        right: (n,) which values are right.
        within: what the confidence is the probability of.
    """
    given = confidence > 0
    chance, right = np.clip(confidence[given], 0, 1), right[given]
    place = np.minimum((chance * BINS).astype(np.int64), BINS - 1)
    counts = np.bincount(place, minlength=BINS)
    share = counts / max(chance.size, 1)
    enough = share >= LEAST_SHARE
    stated, true = (
        np.where(enough, np.bincount(place, weights=values, minlength=BINS) / np.maximum(counts, 1), np.nan)
        for values in (chance, right.astype(np.float64))
    )
    return Reliability(within, stated, true, share, calibration_error(chance, right))
