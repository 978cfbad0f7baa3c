"""Depth metrics: sums over pixels first, figures from the sums.

p is the prediction, t the truth, g = ln p - ln t, n the number of scored pixels (both have a value).

| key           | formula                                  | unit  |
|---------------|------------------------------------------|-------|
| delta_1, 2, 3 | share with max(p/t, t/p) < 1.25^k        |       |
| abs_rel       | mean |p - t| / t                         |       |
| sq_rel        | mean (p - t)^2 / t                       | m     |
| rmse          | sqrt mean (p - t)^2                      | m     |
| rmse_log      | sqrt mean g^2                            |       |
| silog         | 100 sqrt(mean g^2 - (mean g)^2)          |       |
| log10         | mean |log10 p - log10 t|                 |       |
| mae           | mean |p - t|                             | m     |
| irmse, imae   | as rmse and mae, of 1/p and 1/t          | 1/km  |
| density       | share of the truth's pixels the prediction has a value for |  |
| density_image | share of all pixels the prediction has a value for |  |

Eigen et al., NeurIPS 2014 (delta to rmse_log, silog's core); Uhrig et al., 3DV 2017 (irmse, imae).

A value is a finite number above 0 that float32 can hold (denormals included); 0, negative, NaN and inf are no value.
A figure over no pixels is NaN.
"""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from eval.sums import Sums, ratio_of

FloatArray = npt.NDArray[np.floating]
Mask = npt.NDArray[np.bool_]

SMALLEST_VALUE = float(np.finfo(np.float32).smallest_subnormal)
LARGEST_VALUE = float(np.finfo(np.float32).max)


def has_value(depth_m: npt.NDArray[Any]) -> Mask:
    """Tell where a map (any shape) has a value."""
    wide = depth_m.astype(np.float64, copy=False)  # a float16 map is not compared against an overflowed bound
    return (wide >= SMALLEST_VALUE) & (wide <= LARGEST_VALUE)


@dataclass(frozen=True, slots=True)
class DepthSums(Sums):
    """What the depth metrics need to know about any number of pixels."""

    pixels: int = 0
    """All pixels looked at."""
    values: int = 0
    """Of them, those with a prediction."""
    truth: int = 0
    """Of all pixels, those with a truth."""
    covered: int = 0
    """Of the truth's pixels, those with a prediction of their own."""
    count: int = 0
    """Scored pixels: covered, plus what the protocol filled."""
    within_1: int = 0
    within_2: int = 0
    within_3: int = 0
    abs_rel: float = 0.0
    sq_rel_m: float = 0.0
    sq_m2: float = 0.0
    abs_m: float = 0.0
    abs_log10: float = 0.0
    inverse_sq: float = 0.0
    """Sum of (1/p - 1/t)^2, 1/m^2."""
    inverse_abs: float = 0.0
    """Sum of |1/p - 1/t|, 1/m."""
    log_mean: float = 0.0
    """Mean of g: with log_spread it stays exact where mean g^2 - (mean g)^2 would cancel."""
    log_spread: float = 0.0
    """Sum of (g - log_mean)^2."""

    def __add__(self, other: Self) -> Self:
        """Join two sets of pixels; mean and spread of g by Chan et al., 1979."""
        joined = Sums.__add__(self, other)  # super() does not know a class that slots made anew
        if not joined.count:
            return joined
        share = other.count / joined.count
        gap = other.log_mean - self.log_mean
        spread = joined.log_spread + gap * gap * self.count * share
        return replace(joined, log_mean=self.log_mean + gap * share, log_spread=spread)

    @classmethod
    def over(cls, prediction_m: FloatArray, truth_m: FloatArray, own: Mask | None = None) -> Self:
        """Sum over two maps of one shape.

        Args:
            prediction_m: metres.
            truth_m: metres.
            own: True where the prediction is the method's own and not filled in for it; None: wherever it has a value.
        """
        valued, true = has_value(prediction_m), has_value(truth_m)
        own = valued if own is None else own
        scored = valued & true
        p, t = prediction_m[scored].astype(np.float64), truth_m[scored].astype(np.float64)
        error, ratio, g = np.abs(p - t), np.maximum(p / t, t / p), np.log(p) - np.log(t)
        inverse = np.abs(1 / p - 1 / t)
        log_mean = float(g.mean()) if g.size else 0.0
        return cls(
            pixels=prediction_m.size,
            values=int(np.count_nonzero(own)),
            truth=int(np.count_nonzero(true)),
            covered=int(np.count_nonzero(own & true)),
            count=g.size,
            within_1=int(np.count_nonzero(ratio < 1.25)),
            within_2=int(np.count_nonzero(ratio < 1.25**2)),
            within_3=int(np.count_nonzero(ratio < 1.25**3)),
            abs_rel=float(np.sum(error / t)),
            sq_rel_m=float(np.sum(error**2 / t)),
            sq_m2=float(np.sum(error**2)),
            abs_m=float(np.sum(error)),
            abs_log10=float(np.sum(np.abs(g)) / np.log(10)),
            inverse_sq=float(np.sum(inverse**2)),
            inverse_abs=float(np.sum(inverse)),
            log_mean=log_mean,
            log_spread=float(np.sum((g - log_mean) ** 2)),
        )

    def finish(self) -> dict[str, float]:
        """Turn the sums into the metrics of the table above."""
        n = self.count
        return {
            "delta_1": ratio_of(self.within_1, n),
            "delta_2": ratio_of(self.within_2, n),
            "delta_3": ratio_of(self.within_3, n),
            "abs_rel": ratio_of(self.abs_rel, n),
            "sq_rel": ratio_of(self.sq_rel_m, n),
            "rmse": ratio_of(self.sq_m2, n) ** 0.5,
            "rmse_log": (ratio_of(self.log_spread, n) + self.log_mean**2) ** 0.5,
            "silog": 100 * ratio_of(self.log_spread, n) ** 0.5,
            "log10": ratio_of(self.abs_log10, n),
            "mae": ratio_of(self.abs_m, n),
            "irmse": 1000 * ratio_of(self.inverse_sq, n) ** 0.5,
            "imae": 1000 * ratio_of(self.inverse_abs, n),
            "density": ratio_of(self.covered, self.truth),
            "density_image": ratio_of(self.values, self.pixels),
        }
