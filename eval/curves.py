"""Sparsification: how the error falls as the least trusted pixels are dropped.

A curve gives the error of the kept pixels for every kept share. A confidence is worth something where its curve
lies below that of the trivial one, "drop the farthest first", and near the oracle's, which drops the largest errors
first. Pixels of one confidence are dropped in random order: the curve is the expectation of that, so it depends on
neither the pixels' order nor a seed.

Curves over a drive sort the pixels of all frames together, since a threshold on the confidence does so too. The AUSE
in a result file is of each frame alone, averaged over frames.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from eval.depth import DepthSums, FloatArray, has_value
from eval.protocol import Prepared
from eval.stereo import DisparitySums, is_d1

Flat = npt.NDArray[np.float64]
Metric = Literal["abs_rel", "rmse", "d1"]
KEPT_SHARES = np.linspace(1.0, 0.02, 50)
"""Kept shares of a curve: all pixels down to 2 %, in steps of 2 %."""


@dataclass(frozen=True, slots=True)
class ScoredPixels:
    """The scored pixels of any number of frames, flat; 24 bytes a pixel."""

    prediction_m: Flat
    """(n,) metres."""
    truth_m: Flat
    """(n,) metres."""
    confidence: Flat
    """(n,) higher is more trusted; NaN counts as the least."""


@dataclass(frozen=True, slots=True)
class Curves:
    """One metric's error at every kept share; all arrays are (m,)."""

    metric: Metric
    kept: Flat
    """Kept shares, falling from 1."""
    by_confidence: Flat
    oracle: Flat
    farthest_first: Flat

    @property
    def ause(self) -> float:
        """Area between the confidence's curve and the oracle's over the dropped share, the metric's unit.

        Ilg et al., ECCV 2018, not normalised. 0 is a perfect order.
        """
        return _area(self.by_confidence - self.oracle, self.kept)

    @property
    def ause_farthest_first(self) -> float:
        """The same area for the trivial confidence: what a real one must beat."""
        return _area(self.farthest_first - self.oracle, self.kept)


def join(parts: Sequence[ScoredPixels]) -> ScoredPixels:
    """Put the scored pixels of frames together; none at all is no pixel."""
    columns = (
        [part.prediction_m for part in parts],
        [part.truth_m for part in parts],
        [part.confidence for part in parts],
    )
    return ScoredPixels(*(np.concatenate([np.zeros(0), *column]) for column in columns))


def scored_pixels(ready: Prepared, confidence: FloatArray | None) -> ScoredPixels:
    """Return one frame's scored pixels; confidence is of the whole image.

    Pixels the protocol filled are left out: nobody stated a confidence for them. Without a confidence all are alike.
    """
    scored = ready.own & has_value(ready.truth_m)
    trust = np.ones(scored.shape) if confidence is None else ready.cut(confidence)
    return ScoredPixels(ready.prediction_m[scored], ready.truth_m[scored], trust[scored].astype(np.float64))


def curves(pixels: ScoredPixels, metric: Metric, fx_baseline: float | None = None, kept: Flat = KEPT_SHARES) -> Curves:
    """Make the three curves of a metric; d1 is in percent and needs fx * baseline, px m."""
    error = _error(pixels, metric, fx_baseline)
    orders = pixels.confidence, -error, -pixels.prediction_m
    heights = [sparsify(error, order, kept) for order in orders]
    if metric == "rmse":
        heights = [np.sqrt(height) for height in heights]
    return Curves(metric, kept, *heights)


def sparsify(error: Flat, confidence: Flat, kept: Flat = KEPT_SHARES) -> Flat:
    """Return the mean error (m,) of each kept share (m,) of the pixels (n,), most confident first.

    Where a share ends within a group of equal confidence, it holds that part of the group's sum. NaN without pixels.
    """
    if not error.size:
        return np.full(len(kept), np.nan)
    trust, group = np.unique(-np.nan_to_num(confidence, nan=-np.inf), return_inverse=True)
    counts = np.concatenate([[0], np.cumsum(np.bincount(group, minlength=trust.size))])
    sums = np.concatenate([[0], np.cumsum(np.bincount(group, weights=error, minlength=trust.size))])
    wanted = np.asarray(kept) * error.size
    return np.interp(wanted, counts, sums) / wanted


def best(pixels: ScoredPixels, share: float, seed: int = 0, fx_baseline: float | None = None) -> dict[str, float]:
    """Score the most confident share of the pixels by every depth metric; equals are drawn by the seed.

    With fx * baseline, px m, by every disparity metric as well.
    """
    n = round(share * pixels.truth_m.size)
    shuffled = np.random.default_rng(seed).permutation(pixels.truth_m.size)
    order = np.argsort(-np.nan_to_num(pixels.confidence[shuffled], nan=-np.inf), kind="stable")
    kept = np.zeros_like(pixels.prediction_m)
    chosen = shuffled[order[:n]]
    kept[chosen] = pixels.prediction_m[chosen]
    figures = DepthSums.over(kept, pixels.truth_m).finish()
    if fx_baseline is not None:
        figures.update(DisparitySums.over_depths(kept, pixels.truth_m, fx_baseline).finish())
    return figures


def _error(pixels: ScoredPixels, metric: Metric, fx_baseline: float | None) -> Flat:
    """Return each pixel's part in the metric; what is averaged, before any root."""
    p, t = pixels.prediction_m, pixels.truth_m
    if metric == "abs_rel":
        return np.abs(p - t) / t
    if metric == "rmse":
        return (p - t) ** 2
    if fx_baseline is None:
        raise ValueError("d1 is an error of disparity: pass fx_baseline, px m")
    return np.where(is_d1(np.abs(fx_baseline / p - fx_baseline / t), fx_baseline / t), 100.0, 0.0)


def _area(height: Flat, kept: Flat) -> float:
    """Integrate over the dropped share by trapezia."""
    return float(np.sum((height[1:] + height[:-1]) / 2 * (kept[:-1] - kept[1:])))
