"""Recalibration: the probabilities that a method states, mended by what came true on real frames.

The log-odds of a stated probability become shift + slope times themselves (Platt, 1999): two numbers for each of the
two readings. The order of the pixels stays as it was. The numbers lie in weights/confidence.json, beside the weights
that they were fitted for; priors/learn/fit_confidence.py fits them. Other weights are believed as they are.
"""

import json
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

import numpy as np

from priors.types import Depth, FloatMap

FILE = Path(__file__).resolve().parent / "weights" / "confidence.json"
CLASSICAL_STEREO = "stereo"
"""Its name in the file; a network is named as its file of weights."""
SUREST = np.float32(1e-6)
"""Log-odds are taken of probabilities that differ from 0 and 1 by this much at least."""


@dataclass(frozen=True, slots=True)
class LogOdds:
    """A rising map of probabilities: the log-odds times `slope`, plus `shift`."""

    shift: float = 0.0
    slope: float = 1.0
    """Above 0."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.shift) and 0 < self.slope < np.inf):
            raise ValueError(f"shift {self.shift}, slope {self.slope}: expected numbers, the slope above 0")

    def __call__(self, chance: FloatMap) -> FloatMap:
        """Return the mended probabilities (...); 0 stays 0: there is no value, or nothing is known of it."""
        if self == LogOdds():
            return chance
        odds = np.float32(self.shift) + np.float32(self.slope) * log_odds(chance)
        return np.where(chance > 0, 1 / (1 + np.exp(-odds)), np.float32(0)).astype(np.float32)

    def after(self, first: "LogOdds") -> "LogOdds":
        """Return the map that does `first`, then this one."""
        return LogOdds(self.shift + self.slope * first.shift, self.slope * first.slope)


@dataclass(frozen=True, slots=True)
class Recalibration:
    """What mends the two readings of a method."""

    own: LogOdds = LogOdds()
    """Of the method's own confidence (`Depth.confidence`)."""
    relative: LogOdds = LogOdds()
    """Of the probability of a relative error of 5 % (`Depth.within_5_percent`)."""

    def __call__(self, depth: Depth) -> Depth:
        """Return a map with both readings mended, those that it has."""
        own, relative = depth.confidence, depth.within_5_percent
        return replace(
            depth,
            confidence=None if own is None else self.own(own),
            within_5_percent=None if relative is None else self.relative(relative),
        )

    @classmethod
    def of(cls, name: str, digest: str | None = None) -> Self:
        """Return what was fitted for a method or for a network's weights; what believes it where there is none.

        Args:
            name: CLASSICAL_STEREO, or the name of the file of weights without its ending.
            digest: the hash of the weights; numbers of other weights are not taken.
        """
        found = read().get(name, {})
        if not found or found.get("weights") != digest:
            return cls()
        return cls(LogOdds(*found["own"]), LogOdds(*found["relative"]))

    def record(self) -> dict[str, Any]:
        """Return what the file holds."""
        pairs = {"own": self.own, "relative": self.relative}
        return {name: [round(each.shift, 4), round(each.slope, 4)] for name, each in pairs.items()}


BELIEVED = Recalibration()
"""Mends nothing."""


def log_odds(chance: FloatMap) -> FloatMap:
    """Return ln(p / (1 - p)) of probabilities (...)."""
    inside = np.clip(chance, SUREST, 1 - SUREST)
    return np.asarray(np.log(inside) - np.log1p(-inside))


@lru_cache(maxsize=1)
def read() -> dict[str, dict[str, Any]]:
    """Return what the file holds, by name."""
    held: dict[str, dict[str, Any]] = json.loads(FILE.read_text(encoding="utf-8"))
    return held
