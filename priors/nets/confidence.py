"""Confidence of a stereo network: the probability that its disparity is within 1 px.

A network returns the spread of its matching distribution (sigma) and a logit of being wrong (doubt), both learned on
its training data. How they relate to its errors is measured on data that it never saw
(priors/learn/confidence_calibration.py). The header of the weights keeps the result: a score, which is a weighted sum
of the two and of cheap evidence, and a falling table from score to probability.
"""

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from typing import Any, Self

import cv2
import numpy as np
import numpy.typing as npt

from priors.machine import threads
from priors.types import FloatMap

SMALLEST_PX = 0.02
"""What sigma and the disparity are at least, before their logarithm is taken."""
STEEP = 3.0
"""px per px: a steeper disparity counts as this steep."""
HIDDEN_PX = np.float32(0.5)
"""How far left of a pixel something nearer must land in the right view to hide it."""
RIDGE = 1.0
TILT = 2e-4
"""Least fall of the table from knot to knot."""
TERMS = ("doubt", "log_sigma", "distance", "slope", "hidden")
"""What the score is made of, see `evidence`."""


@dataclass(frozen=True)
class ConfidenceCalibration:
    """A score from evidence, and what share of pixels with that score was within 1 px."""

    weights: tuple[float, ...]
    """One per term."""
    scores: tuple[float, ...]
    """Rising knots."""
    probabilities: tuple[float, ...]
    """Falling, one a knot; linear in between, the last beyond."""

    @classmethod
    def read(cls, about: dict[str, Any]) -> Self:
        """Take the calibration from the header of weights; where there is none the network is believed."""
        table = about.get("calibration")
        if table is None:
            return cls.trusting()
        return cls(*(tuple(map(float, table[name])) for name in ("weights", "scores", "probabilities")))

    @classmethod
    def trusting(cls) -> Self:
        """Return the calibration that believes the network: its doubt is the logit of an error above 1 px."""
        scores = np.linspace(-12.0, 12.0, 97)
        return cls((1.0, 0.0, 0.0, 0.0, 0.0), tuple(scores.tolist()), tuple((1 / (1 + np.exp(scores))).tolist()))

    def record(self) -> dict[str, Any]:
        """Return what the header of the weights holds."""
        return {name: [round(value, 5) for value in values] for name, values in asdict(self).items()}

    def __call__(self, disparity_px: FloatMap, sigma_px: FloatMap, doubt: FloatMap) -> FloatMap:
        """Return the probability (height, width) in [0, 1] that a left view's disparity is within 1 px."""
        return self.probability(self.score(_terms(disparity_px, sigma_px, doubt)))

    def score(self, terms: Iterable[FloatMap]) -> FloatMap:
        """Return the score (...): higher is worse; terms are five of (...)."""
        # One term after the other: a matrix product would wake threads.
        parts = (
            np.multiply(term, np.float32(w), dtype=np.float32) for w, term in zip(self.weights, terms, strict=True)
        )
        total = next(parts)
        for part in parts:
            np.add(total, part, out=total)
        return total

    def probability(self, score: FloatMap) -> FloatMap:
        """Return the probability of a score."""
        from priors.kernels import confidence as kernels

        values = np.ascontiguousarray(score, np.float32)
        chance = np.empty(values.shape, np.float32)
        table = np.array(self.scores, np.float32), np.array(self.probabilities, np.float32)
        flat, out = values.reshape(-1), chance.reshape(-1)
        block = threads.worth(0.2 * len(self.scores))
        threads.over(
            flat.size, lambda first, last: kernels.interpolate(flat[first:last], *table, out[first:last]), block
        )
        return chance


def evidence(disparity_px: FloatMap, sigma_px: FloatMap, doubt: FloatMap) -> FloatMap:
    """Return the terms of the score (5, height, width) for a left view's maps (height, width).

    doubt: the network's logit of an error above 1 px; log_sigma: natural logarithm of sigma, px; distance: minus the
    logarithm of the disparity, px; slope: horizontal step of the disparity, px per px, at most 3; hidden: 1 where the
    right view does not reach, or something nearer stands before it there.
    """
    return np.stack([np.asarray(term, np.float32) for term in _terms(disparity_px, sigma_px, doubt)])


def _terms(disparity_px: FloatMap, sigma_px: FloatMap, doubt: FloatMap) -> Iterator[FloatMap]:
    """Make the terms one after the other: together they do not fit into a cache."""
    least = np.float32(SMALLEST_PX)
    yield doubt
    yield np.log(np.maximum(sigma_px, least))
    yield -np.log(np.maximum(disparity_px, least))
    slope = np.asarray(cv2.Sobel(disparity_px, cv2.CV_32F, 1, 0, scale=1 / 8), np.float32)
    yield np.minimum(np.abs(slope, out=slope), np.float32(STEEP), out=slope)
    yield is_hidden(disparity_px).astype(np.float32)


def is_hidden(disparity_px: FloatMap) -> npt.NDArray[np.bool_]:
    """Tell which pixels of a left view the right one cannot see: beyond its edge, or behind a nearer surface.

    A surface to the right of a pixel hides it where it lands left of it in the right view, by half a pixel or more.
    """
    from priors.kernels import confidence as kernels

    hidden = np.empty(disparity_px.shape, np.bool_)
    given = np.ascontiguousarray(disparity_px, np.float32)
    work = partial(kernels.find_hidden, given, HIDDEN_PX, hidden)
    threads.over(len(given), work, threads.worth(2 * given.shape[1]))
    return hidden


def fit(terms: FloatMap, within: npt.NDArray[np.bool_], far: float = 0.0, knots: int = 40) -> ConfidenceCalibration:
    """Fit a calibration: logistic regression for the score, then an isotonic table.

    Args:
        terms: (5, n) from `evidence`.
        within: (n,) True where the error is at most 1 px.
        far: weight of the distance, logits per factor e: how much a far pixel is to rank below a near one that is as
            likely to be within 1 px. The probabilities are calibrated for any choice.
        knots: entries of the table.
    """
    weights = _regress(terms, ~within, far)
    score = np.tensordot(weights, terms, axes=1)
    order = np.argsort(score)
    bins = list(pairwise(np.unique(np.linspace(0, score.size, knots + 1).astype(int))))
    shares = falling(np.array([within[order[a:b]].mean() for a, b in bins]), np.array([b - a for a, b in bins]))
    middles = [score[order[a:b]].mean() for a, b in bins]
    ends = score[order[0]] - 1e-3, score[order[-1]] + 1e-3
    table = _tilt(np.concatenate([shares[:1], shares, shares[-1:]]))
    return ConfidenceCalibration(*(tuple(map(float, part)) for part in (weights, [ends[0], *middles, ends[1]], table)))


def _tilt(shares: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Let a falling table fall everywhere, by a little: pixels of different scores never get the same probability."""
    below = np.arange(shares.size)[::-1]
    return shares * (1 - TILT * (shares.size - 1)) + TILT * below


def falling(values: npt.NDArray[np.float64], counts: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Return the falling sequence nearest to values, weighted by counts (pool adjacent violators)."""
    pools: list[list[float]] = []  # mean, weight, length
    for value, count in zip(values, counts, strict=True):
        pools.append([float(value), float(count), 1])
        while len(pools) > 1 and pools[-2][0] < pools[-1][0]:
            mean, weight, length = pools.pop()
            last = pools[-1]
            last[0] = (last[0] * last[1] + mean * weight) / (last[1] + weight)
            last[1] += weight
            last[2] += length
    return np.concatenate([np.full(int(length), mean) for mean, _, length in pools])


def _regress(terms: FloatMap, wrong: npt.NDArray[np.bool_], far: float, rounds: int = 25) -> FloatMap:
    """Return the terms' weights, in logits: Newton's steps of a logistic regression with a small ridge."""
    used = [index for index, name in enumerate(TERMS) if name != "distance"]
    A = np.stack([*(terms[index].astype(np.float64) for index in used), np.ones(terms.shape[1])], axis=1)
    w = np.zeros(A.shape[1])
    for _ in range(rounds):
        chance = 1 / (1 + np.exp(-np.clip(A @ w, -30, 30)))
        curve = A * (chance * (1 - chance))[:, None]
        w -= np.linalg.solve(A.T @ curve + RIDGE * np.eye(A.shape[1]), A.T @ (chance - wrong) + RIDGE * w)
    weights = np.full(len(TERMS), far, np.float32)
    weights[used] = w[:-1]
    return weights
