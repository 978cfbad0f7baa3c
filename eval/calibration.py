"""Calibration: does a confidence of 0.9 mean that nine of ten values are right?

A method says what its confidence is the probability of: an error within a Tolerance. The expected calibration error
(Guo et al., ICML 2017) is the mean gap between what was said and what came true.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from eval.depth import FloatArray, Mask

BINS = 15
"""Of equal count, as Guo et al. have 15 of equal width: no bin is empty."""


@dataclass(frozen=True, slots=True)
class Tolerance:
    """The error up to which a value counts as right."""

    amount: float
    unit: Literal["m", "px", "share"]
    """Metres of depth, pixels of disparity, or a share of the true depth."""

    def __str__(self) -> str:
        return f"{100 * self.amount:g} %" if self.unit == "share" else f"{self.amount:g} {self.unit}"

    def within(self, prediction_m: FloatArray, truth_m: FloatArray, fx_baseline: float | None = None) -> Mask:
        """Tell which of the values (n,), metres, are right.

        Args:
            prediction_m: above 0.
            truth_m: above 0.
            fx_baseline: focal length times baseline, px m, for a tolerance in pixels.

        Raises:
            ValueError: the tolerance is in pixels, and fx_baseline is not known.
        """
        if self.unit == "share":
            error = np.abs(prediction_m - truth_m) / truth_m
        elif self.unit == "m":
            error = np.abs(prediction_m - truth_m)
        elif fx_baseline is None:
            raise ValueError("a tolerance in pixels: pass fx_baseline, px m")
        else:
            error = np.abs(fx_baseline / prediction_m - fx_baseline / truth_m)
        return np.asarray(error <= self.amount)


def calibration_error(confidence: FloatArray, right: npt.NDArray[np.bool_], bins: int = BINS) -> float:
    """Return the expected calibration error of n values: the mean gap of confidence and share that is right.

    Values of one confidence count as right by their common share, so that their order changes nothing.

    Args:
        confidence: (n,) stated probabilities.
        right: (n,) whether each value is within the tolerance.
        bins: groups of equal count, by confidence, over each of which both are averaged.

    Returns:
        In [0, 1]; NaN without values.
    """
    if not confidence.size:
        return float("nan")
    stated, place, counts = np.unique(confidence, return_inverse=True, return_counts=True)
    share = np.bincount(place, weights=right) / counts
    gaps = np.repeat(stated.astype(np.float64) - share, counts)
    parts = np.array_split(gaps, min(bins, gaps.size))
    return sum(abs(float(part.sum())) for part in parts) / gaps.size
