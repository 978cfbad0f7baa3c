"""The maps of several sensors of one frame joined to one: each pixel has one surface, that of the most credible part.

1. Every part says by its confidence which relative error to expect. What was inferred from one image counts with 1.5
   times that error: it is wrong by whole objects, which no pixel's confidence tells.
2. A pixel's surface is that of the part with the least error to expect. Parts that agree with it within their errors
   are averaged, each by its 1 / error^2; others are of another surface, or wrong, and are left out. Nothing is averaged
   from pixel to pixel, so edges stay.
3. A pixel that was measured (LiDAR) keeps its value, unless a part that is surer there clearly says another.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from priors.error_model import MOST, WITHIN, chance_of, relative_spread
from priors.errors import DataError
from priors.types import Depth, FloatMap, Mask

VERSION = 2
"""Of how parts are joined: part of the cache's key."""
USUAL_SPREAD = 0.02
"""Mean relative error to expect of a map that does not tell its own."""
INFERRED = 1.5
"""Errors of an inferred part count so many times: chosen on drives and streets, see docs/methods/fused.md."""
AGREE_SPREADS = 1.0
"""Two parts agree where they differ by no more than so many of their spreads."""
ONE_SURFACE = 0.1
"""The logarithm of two values of one surface never differs by more."""
CONTRADICTS_SPREADS = 2.0
"""A surer part contradicts a measured value where they differ by more than so many of their spreads."""
NO_VALUE = np.float32(1e3)
"""Spread where a part has no value."""
Kind = Literal["measured", "matched", "inferred"]
Stack = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Part:
    """One sensor's map of a frame."""

    depth: Depth
    kind: Kind
    """measured: range along rays (LiDAR); matched: from two views, or filled from measured points; inferred: from one
    image."""


def join_parts(parts: Mapping[str, Part]) -> Depth:
    """Return one map of several, with the probability of an error within 5 % as both of its confidences.

    Args:
        parts: by their names; at least one, all of one frame and camera.

    Raises DataError where their sizes differ: they are of different cameras.
    """
    _expect_one_size(parts)
    depth_m = np.stack([part.depth.depth_m for part in parts.values()])
    spread = np.stack([_spread(part) for part in parts.values()])
    log_m = np.log(np.where(depth_m > 0, depth_m, 1), dtype=np.float32)
    joined, least = _join(log_m, spread)
    for number, part in enumerate(parts.values()):
        if part.kind == "measured":
            stays = (depth_m[number] > 0) & ~_contradicted(log_m, spread, number)
            joined, least = np.where(stays, log_m[number], joined), np.where(stays, spread[number], least)
    valued = (depth_m > 0).any(axis=0)
    joined_m = np.where(valued, np.exp(joined), 0).astype(np.float32)
    chance = np.where(least < MOST, chance_of(joined_m, least, WITHIN), np.float32(0))
    return Depth(joined_m, chance, within_5_percent=chance)


def _expect_one_size(parts: Mapping[str, Part]) -> None:
    sizes = {name: part.depth.depth_m.shape for name, part in parts.items()}
    if len(set(sizes.values())) > 1:
        told = ", ".join(f"{name} {size[1]}x{size[0]}" for name, size in sizes.items())
        raise DataError(f"parts of different cameras: {told}: join maps of one camera")


def _spread(part: Part) -> FloatMap:
    """Return the mean relative error to expect (height, width), as it counts."""
    spread = relative_spread(part.depth, USUAL_SPREAD)
    if part.kind == "inferred":
        spread = np.minimum(spread * np.float32(INFERRED), np.float32(MOST))
    return np.where(part.depth.valid, spread, NO_VALUE)


def _join(log_m: Stack, spread: Stack) -> tuple[FloatMap, FloatMap]:
    """Return the logarithm of the depth, and its spread: the surest part's, averaged with those that agree with it."""
    surest = np.argmin(spread, axis=0)[None]
    best, least = (np.take_along_axis(values, surest, axis=0) for values in (log_m, spread))
    apart = np.abs(log_m - best)
    agrees = (apart <= AGREE_SPREADS * np.hypot(spread, least)) & (apart <= ONE_SURFACE) & (spread < NO_VALUE)
    weight = np.where(agrees, np.square(1 / spread), 0)
    total = np.sum(weight, axis=0)
    mean = np.divide(np.sum(weight * log_m, axis=0), total, out=np.zeros_like(total), where=total > 0)
    return mean, least[0]


def _contradicted(log_m: Stack, spread: Stack, number: int) -> Mask:
    """Tell where a part that is surer than one clearly says another depth (height, width)."""
    clearly = np.abs(log_m - log_m[number]) > CONTRADICTS_SPREADS * np.hypot(spread, spread[number])
    return np.asarray((clearly & (spread < spread[number])).any(axis=0))
