"""Belief: what is held of turn, delay and place at once, a Gaussian, and how it changes with what is told.

The calibration is where it starts. Unknowns that look alike stay correlated: a delay and a LiDAR that stands farther
ahead, yaw and one that stands aside. So the error of each holds that the others are not known.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from priors.extrinsics.correction import Correction

Floats = npt.NDArray[np.float64]

UNKNOWNS = ("pitch", "yaw", "roll", "delay", "aside", "down", "ahead")
"""Of the LiDAR: degrees, seconds, metres."""
PLACE_M, AHEAD_M = 0.01, 0.02
"""How well a calibration knows where the LiDAR is (standard deviation): sideways and upwards; forward. Metres."""
PRIOR = np.array([2.0, 2.0, 2.0, 0.05, PLACE_M, PLACE_M, AHEAD_M])
"""Standard deviations of the unknowns before anything is told: those of turn and delay say nothing."""


class Told(NamedTuple):
    """What one source tells: some sums of the unknowns."""

    factors: Floats
    """(n, len(UNKNOWNS)) which sums."""
    values: Floats
    """(n,)."""
    covariance: Floats
    """(n, n) of the values' errors."""


@dataclass(frozen=True)
class Belief:
    """A mean and a covariance of all unknowns."""

    mean: Floats
    """(len(UNKNOWNS),)."""
    covariance: Floats
    """(len(UNKNOWNS), len(UNKNOWNS))."""

    @classmethod
    def of_calibration(cls) -> "Belief":
        """Return what is held before anything is told."""
        return cls(np.zeros(len(UNKNOWNS)), np.diag(np.square(PRIOR)))

    @property
    def errors(self) -> Floats:
        """Return the standard errors (len(UNKNOWNS),)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correction(self) -> Correction:
        """Return the mean as a correction."""
        pitch, yaw, roll, delay_s, right, down, forward = self.mean.tolist()
        return Correction((pitch, yaw, roll), delay_s, (right, down, forward))

    def less_sure(self, name: str, error: float) -> "Belief":
        """Return the belief in which one unknown has an error more (standard deviation)."""
        more = np.zeros(len(UNKNOWNS))
        more[UNKNOWNS.index(name)] = error**2
        return Belief(self.mean, self.covariance + np.diag(more))

    def after(self, told: Told) -> "Belief":
        """Return the belief beside what an independent source tells (Kalman's update)."""
        away = told.values - told.factors @ self.mean
        spread = told.factors @ self.covariance @ told.factors.T + told.covariance
        gain = np.linalg.solve(spread, told.factors @ self.covariance).T
        covariance = self.covariance - gain @ told.factors @ self.covariance
        return Belief(self.mean + gain @ away, (covariance + covariance.T) / 2)
