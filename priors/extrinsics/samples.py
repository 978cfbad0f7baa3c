"""Mean and covariance of a likelihood that is no Gaussian, by samples of it (adaptive importance sampling).

Cappe et al., "Population Monte Carlo" (2004): samples of one round tell where the next are drawn.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

COUNT, ROUNDS = 384, 4
WIDER = 1.4
"""Samples are drawn so much wider than what the round before found: tails are seen."""
LEAST_SHARE = 0.02
"""Of the first spread's variance: what few samples found is no narrower."""


def weigh(nats: Callable[[Floats], Floats], mean: Floats, spread: Floats) -> tuple[Floats, Floats]:
    """Return mean (n,) and covariance (n, n) of a likelihood.

    Args:
        nats: the log likelihood (samples,) of samples (samples, n).
        mean: (n,) near its peak.
        spread: (n,) how far around it to look at first (standard deviations).
    """
    half = np.random.default_rng(0).standard_normal((COUNT // 2, len(mean)))
    draws = np.concatenate([half, -half])
    least = np.diag(LEAST_SHARE * np.square(spread))
    root = np.diag(spread)
    covariance = np.diag(np.square(spread))
    for _ in range(ROUNDS):
        samples = mean + draws @ root.T
        logs = nats(samples) + np.square(draws).sum(axis=1) / 2
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        mean = weights @ samples
        apart = samples - mean
        covariance = (weights[:, None] * apart).T @ apart
        root = WIDER * np.linalg.cholesky(covariance + least)
    return mean, covariance
