"""Probability distributions of augmentation parameters."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

Values = npt.NDArray[np.float64]


class Distribution(Protocol):
    """What a parameter is drawn from."""

    def draw(self, rng: np.random.Generator, count: int = 1) -> Values:
        """Draw independent values (count,)."""
        ...


@dataclass(frozen=True)
class Uniform:
    """Every value between two bounds is equally likely."""

    low: float
    high: float

    def __post_init__(self) -> None:
        if not -np.inf < self.low <= self.high < np.inf:
            raise ValueError(f"uniform distribution: expected finite low <= high, found {self.low} and {self.high}")

    def draw(self, rng: np.random.Generator, count: int = 1) -> Values:
        """Draw values (count,)."""
        return rng.uniform(self.low, self.high, count)


@dataclass(frozen=True)
class LogUniform:
    """The logarithm is uniform: halving is as likely as doubling."""

    low: float
    high: float

    def __post_init__(self) -> None:
        if not 0 < self.low <= self.high < np.inf:
            raise ValueError(f"log-uniform distribution: expected 0 < low <= high, found {self.low} and {self.high}")

    def draw(self, rng: np.random.Generator, count: int = 1) -> Values:
        """Draw values (count,)."""
        return np.exp(rng.uniform(np.log(self.low), np.log(self.high), count))


@dataclass(frozen=True)
class Normal:
    """A Gaussian."""

    mean: float
    deviation: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.mean) and 0 <= self.deviation < np.inf):
            raise ValueError(f"normal distribution: expected deviation >= 0, found {self.mean} +- {self.deviation}")

    def draw(self, rng: np.random.Generator, count: int = 1) -> Values:
        """Draw values (count,)."""
        return self.mean + rng.normal(0, self.deviation, count)


@dataclass(frozen=True)
class LogNormal:
    """The logarithm is Gaussian; `deviation` is the logarithm's."""

    median: float
    deviation: float

    def __post_init__(self) -> None:
        if not (0 < self.median < np.inf and 0 <= self.deviation < np.inf):
            given = f"{self.median} and {self.deviation}"
            raise ValueError(f"log-normal distribution: expected median > 0 and deviation >= 0, found {given}")

    def draw(self, rng: np.random.Generator, count: int = 1) -> Values:
        """Draw values (count,)."""
        return self.median * np.exp(rng.normal(0, self.deviation, count))


@dataclass(frozen=True)
class Effect:
    """An effect that some images have: its probability, and its strength where it is there."""

    probability: float
    strength: Distribution

    def __post_init__(self) -> None:
        if not 0 <= self.probability <= 1:
            raise ValueError(f"effect: expected a probability from 0 to 1, found {self.probability}")

    def draw(self, rng: np.random.Generator) -> float:
        """Draw the strength; 0 where the effect is not there."""
        there = self.probability == 1 or rng.random() < self.probability
        return float(self.strength.draw(rng)[0]) if there else 0.0
