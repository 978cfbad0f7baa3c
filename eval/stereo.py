"""Disparity metrics: sums over pixels first, figures from the sums.

| key             | formula                                                        | unit |
|-----------------|----------------------------------------------------------------|------|
| epe             | mean |p - t|, the end-point error                              | px   |
| d1              | share with |p - t| > 3 px and |p - t| > 5 % of the truth       | %    |
| bad_1, 2, 3     | share with |p - t| > 1, 2, 3 px                                | %    |

d1: Menze and Geiger, CVPR 2015; bad-n: Scharstein and Szeliski, IJCV 2002.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from eval.depth import FloatArray, has_value
from eval.sums import Sums, ratio_of

D1_PX, D1_SHARE = 3.0, 0.05


@dataclass(frozen=True, slots=True)
class DisparitySums(Sums):
    """What the disparity metrics need to know about any number of pixels."""

    count: int = 0
    abs_px: float = 0.0
    bad_1: int = 0
    bad_2: int = 0
    bad_3: int = 0
    d1: int = 0

    @classmethod
    def over(cls, prediction_px: FloatArray, truth_px: FloatArray) -> Self:
        """Sum over two disparity maps of one shape, px; what counts as a value is as for depth."""
        scored = has_value(prediction_px) & has_value(truth_px)
        return cls._of(prediction_px[scored].astype(np.float64), truth_px[scored].astype(np.float64))

    @classmethod
    def over_depths(cls, prediction_m: FloatArray, truth_m: FloatArray, fx_baseline: float) -> Self:
        """Sum over two depth maps of one shape, metres, seen as disparities of a rig with fx * baseline, px m."""
        scored = has_value(prediction_m) & has_value(truth_m)
        return cls._of(
            fx_baseline / prediction_m[scored].astype(np.float64), fx_baseline / truth_m[scored].astype(np.float64)
        )

    @classmethod
    def _of(cls, p: FloatArray, t: FloatArray) -> Self:
        error = np.abs(p - t)
        return cls(
            count=error.size,
            abs_px=float(np.sum(error)),
            bad_1=int(np.count_nonzero(error > 1)),
            bad_2=int(np.count_nonzero(error > 2)),
            bad_3=int(np.count_nonzero(error > 3)),
            d1=int(np.count_nonzero(is_d1(error, t))),
        )

    def finish(self) -> dict[str, float]:
        """Turn the sums into the metrics of the table above."""
        return {
            "epe": ratio_of(self.abs_px, self.count),
            "d1": 100 * ratio_of(self.d1, self.count),
            "bad_1": 100 * ratio_of(self.bad_1, self.count),
            "bad_2": 100 * ratio_of(self.bad_2, self.count),
            "bad_3": 100 * ratio_of(self.bad_3, self.count),
        }


def is_d1(error_px: FloatArray, truth_px: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Tell which disparity errors are KITTI 2015 outliers: over 3 px and over 5 % of the truth."""
    return (error_px > D1_PX) & (error_px > D1_SHARE * truth_px)
