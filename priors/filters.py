"""Filters: what to leave out of a depth map before it supervises anything.

Every filter is a frozen dataclass, called with a map and its frame, and a function on arrays beside it. A filter only
takes values away (and zeroes their confidence): it never changes or adds one. `Filters` holds all of them as flags
and applies the active ones in the order in which they stand here.
"""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, Protocol, TypeAlias, get_args

import numpy as np

from priors.error_model import METRE, PIXEL, WITHIN, chance_of, spread_of
from priors.errors import LARGEST_SEED, DataError, expect, expect_between, expect_choices
from priors.geometry import convert_disparity
from priors.pairs.matching import quick_match
from priors.pairs.read import read_pair
from priors.types import Depth, FloatMap, Frame, Input

Sorts: TypeAlias = Literal["metres", "relative", "pixels"]
"""Errors that a probability may be of."""


class Filter(Protocol):
    """A filter: invalidates values of a frame's map."""

    def __call__(self, depth: Depth, frame: Frame) -> Depth:
        """Return the map with fewer values, or the same."""
        ...


def crop_rows(depth: Depth, fraction: float) -> Depth:
    """Invalidate the top rows: the first round(fraction * height) of them."""
    rows = math.floor(fraction * depth.depth_m.shape[0] + 0.5)
    mask = depth.valid
    mask[:rows] = False
    return depth.keep(mask)


def clip(depth: Depth, farthest_m: float) -> Depth:
    """Invalidate what is farther than farthest_m; a value of exactly farthest_m stays."""
    return depth.keep(depth.valid & (depth.depth_m <= np.float32(farthest_m)))


def keep_agreeing(depth: Depth, other_px: FloatMap, disparity_px: FloatMap, shift: int, most_px: float) -> Depth:
    """Keep the values whose disparity the other view confirms within most_px.

    Args:
        depth: the map to thin.
        other_px: (height, width) disparity of the other view, 0 = no value.
        disparity_px: (height, width) the map's own values as disparity, 0 = no value.
        shift: -1 where the map is the left eye's (a point lies further left in the right image), +1 where the right's.
        most_px: largest difference that still agrees.

    A value that lands outside the other image, or where the other view has no value, is not confirmed: it goes.
    """
    width = depth.depth_m.shape[1]
    columns = np.rint(np.arange(width, dtype=np.float32) + np.float32(shift) * disparity_px)
    inside = depth.valid & (disparity_px > 0) & (columns >= 0) & (columns < width)
    landed = np.take_along_axis(other_px, np.where(inside, columns, 0).astype(np.int64), axis=1)
    with np.errstate(invalid="ignore"):  # infinite disparities, of depth 0, are no match of each other
        return depth.keep(inside & (landed > 0) & (np.abs(landed - disparity_px) <= np.float32(most_px)))


def keep_confident(depth: Depth, least: float) -> Depth:
    """Keep the values whose confidence is at least `least`."""
    return depth.keep(depth.valid & (_confidence(depth) >= np.float32(least)))


def keep_best(depth: Depth, fraction: float, seed: int = 0) -> Depth:
    """Keep the most confident values: exactly round(fraction * number of values).

    Values with the same confidence at the edge of that share are drawn by seed: taking them in raster order would
    favour the top of the image.
    """
    confidence = _confidence(depth)[depth.valid]
    count = math.floor(fraction * confidence.size + 0.5)
    stays = np.zeros(confidence.size, dtype=np.bool_)
    if count > 0:
        least = np.partition(confidence, confidence.size - count)[confidence.size - count]
        stays = confidence > least
        tied = np.flatnonzero(confidence == least)
        wanted = count - np.count_nonzero(stays)
        stays[np.random.default_rng(seed).permutation(tied)[:wanted]] = True
    mask = depth.valid
    mask[mask] = stays
    return depth.keep(mask)


def keep_random(depth: Depth, fraction: float, seed: int = 0) -> Depth:
    """Keep a random share of the values: exactly round(fraction * number of values).

    Every pixel draws its number whether it has a value or not, so with the same seed a smaller fraction keeps a subset
    of what a larger one keeps.
    """
    mask = depth.valid
    drawn = np.random.default_rng(seed).random(mask.shape)[mask]
    stays = np.zeros(drawn.size, dtype=np.bool_)
    stays[np.argsort(drawn, kind="stable")[: math.floor(fraction * drawn.size + 0.5)]] = True
    mask[mask] = stays
    return depth.keep(mask)


def frame_seed(seed: int, frame_id: str) -> int:
    """Derive a frame's own seed, so that shards and single frames draw what a whole build draws."""
    return int.from_bytes(hashlib.blake2b(f"{seed}/{frame_id}".encode(), digest_size=8).digest(), "little")


def sort_by(depth: Depth, by: Sorts, frame: Frame) -> Depth:
    """Return the map with another reading as its confidence: the probability of an error within 1 m, 5 % or 1 px.

    Raises DataError where the map does not tell its relative error, and where pixels are asked of a frame without a
    pair.
    """
    if depth.within_5_percent is None:
        raise DataError(
            f"frame {frame.id}: --keep-by {by}: the map does not tell its relative error: stereo, mono, fused and "
            "mffnet do; build maps of an earlier version again, or leave --keep-by out"
        )
    if by == "relative":
        return replace(depth, confidence=depth.within_5_percent)
    if by == "pixels" and frame.baseline_m is None:
        raise DataError(f"frame {frame.id}: --keep-by pixels: it has no stereo pair: choose metres or relative")
    fx_baseline = None if frame.baseline_m is None else frame.camera.fx * frame.baseline_m
    spread = spread_of(depth.depth_m, depth.within_5_percent, WITHIN)
    chance = chance_of(depth.depth_m, spread, METRE if by == "metres" else PIXEL, fx_baseline)
    return replace(depth, confidence=np.where(depth.within_5_percent > 0, chance, np.float32(0)))


def _confidence(depth: Depth) -> FloatMap:
    if depth.confidence is None:
        raise DataError("this method has no confidence to filter by: leave out --confidence and --keep")
    return np.nan_to_num(depth.confidence, nan=0.0)


@dataclass(frozen=True)
class SkyMask:
    """Drop what priors.sky.sky_mask takes for sky in the frame's image."""

    version: int
    """Version of the mask's rule: part of the cache's key."""

    def __call__(self, depth: Depth, frame: Frame) -> Depth:
        """Invalidate the sky."""
        from priors.sky import sky_mask

        return depth.keep(depth.valid & ~sky_mask(frame.image()))


@dataclass(frozen=True)
class SkyRows:
    """Drop the top rows, as papers do: no LiDAR of KITTI's reaches above 0.32 to 0.36 of the height."""

    fraction: float
    """Share of the height, [0, 1]."""

    def __call__(self, depth: Depth, frame: Frame) -> Depth:
        """Invalidate the top rows."""
        return crop_rows(depth, self.fraction)


@dataclass(frozen=True)
class TruthMask:
    """Keep only the pixels where the frame's truth has a value."""

    def __call__(self, depth: Depth, frame: Frame) -> Depth:
        """Invalidate what has no truth."""
        return depth.keep(depth.valid & frame.truth().valid)


@dataclass(frozen=True)
class Clip:
    """Drop what is too far: it becomes invalid, it is not moved nearer."""

    farthest_m: float
    """Largest camera-z depth that stays, metres."""

    def __call__(self, depth: Depth, frame: Frame) -> Depth:
        """Invalidate what is farther."""
        return clip(depth, self.farthest_m)


@dataclass(frozen=True)
class LeftRight:
    """Keep values that the pair's other view, matched on its own, confirms; what it cannot confirm goes."""

    most_px: float
    """Largest difference of the two disparities, pixels."""

    def __call__(self, depth: Depth, frame: Frame) -> Depth:
        """Invalidate what the other view does not confirm."""
        pair = read_pair(frame)
        if frame.baseline_m is None:
            raise DataError(f"frame {frame.id}: the stereo baseline is not known: leave out --left-right")
        disparity_px = convert_disparity(depth.depth_m, frame.camera.fx, frame.baseline_m)
        shift = -1 if frame.side == "left" else +1
        return keep_agreeing(depth, pair.swapped().match(quick_match), disparity_px, shift, self.most_px)


@dataclass(frozen=True)
class Confidence:
    """Keep values that the method trusts enough."""

    least: float
    """Smallest confidence that stays, [0, 1]."""

    def __call__(self, depth: Depth, frame: Frame) -> Depth:
        """Invalidate what is less trusted."""
        return keep_confident(depth, self.least)


@dataclass(frozen=True)
class ConfidenceBy(Confidence):
    """Keep values that are right within 1 m, 5 % or 1 px with enough probability."""

    by: Sorts
    """Which error."""

    def __call__(self, depth: Depth, frame: Frame) -> Depth:
        """Invalidate what is less likely right."""
        return depth.keep(keep_confident(sort_by(depth, self.by, frame), self.least).valid)


@dataclass(frozen=True)
class Keep:
    """Keep the most confident share of the values, exactly."""

    fraction: float
    """Share of the values that stays, [0, 1]."""

    def __call__(self, depth: Depth, frame: Frame) -> Depth:
        """Invalidate the least trusted values."""
        return keep_best(depth, self.fraction, frame_seed(0, frame.id))


@dataclass(frozen=True)
class KeepBy(Keep):
    """Keep the share of the values that are most likely right within 1 m, 5 % or 1 px, exactly."""

    by: Sorts
    """Which error."""

    def __call__(self, depth: Depth, frame: Frame) -> Depth:
        """Invalidate what is least likely right."""
        kept = keep_best(sort_by(depth, self.by, frame), self.fraction, frame_seed(0, frame.id))
        return depth.keep(kept.valid)


@dataclass(frozen=True)
class Density:
    """Keep a random share of the values, exactly: what a sparser sensor would leave."""

    fraction: float
    """Share of the values that stays, [0, 1]."""
    seed: int
    """With the frame's id it decides which."""

    def __call__(self, depth: Depth, frame: Frame) -> Depth:
        """Invalidate the values that are not drawn."""
        return keep_random(depth, self.fraction, frame_seed(self.seed, frame.id))


@dataclass(frozen=True)
class Filters:
    """Filters of depth maps. All are off by default, and apply in this order. A share is of what the others left."""

    sky: Literal["off", "mask"] = "off"
    """mask: drop what looks like sky (colour, position, texture)."""
    sky_rows: float | None = None
    """Drop this share of the height from the top, as papers do: 0.32 to 0.36 on KITTI."""
    truth_mask: bool = False
    """Keep only the pixels that have a true depth."""
    clip: float | None = None
    """Drop what is farther than this, metres."""
    left_right: float | None = None
    """Keep only values that the other view confirms within this many pixels of disparity."""
    confidence: float | None = None
    """Keep only values with at least this confidence, 0 to 1."""
    keep: float | None = None
    """Keep this share of the values, the most confident ones: 0.9228 keeps 92.28 %."""
    density: float | None = None
    """Keep this share of the values, drawn at random."""
    density_seed: int = 0
    """Which values --density draws."""
    keep_by: Sorts | None = None
    """What --keep and --confidence go by: the probability of an error within 1 m, of 5 % of the depth, or of 1 px of
    disparity. Default: the method's own confidence."""

    def __post_init__(self) -> None:
        expect_choices(self, "")
        shares = {
            "--sky-rows": self.sky_rows,
            "--confidence": self.confidence,
            "--keep": self.keep,
            "--density": self.density,
        }
        for flag, share in shares.items():
            expect(share is None or 0 <= share <= 1, flag, share, "a number from 0 to 1")
        alone = self.keep_by is not None and self.keep is None and self.confidence is None
        expect(not alone, "--keep-by", self.keep_by, "--keep or --confidence beside it: it says what they go by")
        expect(self.keep_by in (None, *get_args(Sorts)), "--keep-by", self.keep_by, "metres, relative or pixels")
        for flag in ("--keep", "--density"):
            expect(shares[flag] != 0, flag, 0, "more than 0: nothing would be left")
        expect(self.clip != 0, "--clip", 0, "more than 0 m: nothing would be left")
        expect_between(0, self.density_seed, LARGEST_SEED, "--density-seed")
        for flag, most in {"--clip": self.clip, "--left-right": self.left_right}.items():
            expect(most is None or most >= 0, flag, most, "a number, 0 or more")

    def steps(self) -> Sequence[Filter]:
        """Return the active filters in the order of application."""
        from priors.sky import VERSION

        steps: list[Filter | None] = [
            SkyMask(VERSION) if self.sky == "mask" else None,
            None if self.sky_rows is None else SkyRows(float(self.sky_rows)),
            TruthMask() if self.truth_mask else None,
            None if self.clip is None else Clip(float(self.clip)),
            None if self.left_right is None else LeftRight(float(self.left_right)),
            None if self.confidence is None else self._by(Confidence, ConfidenceBy, self.confidence),
            None if self.keep is None else self._by(Keep, KeepBy, self.keep),
            None if self.density is None else Density(float(self.density), self.density_seed),
        ]
        return [step for step in steps if step is not None]

    def _by(self, own: type[Filter], other: type[Filter], share: float) -> Filter:
        """Make a filter by the method's own confidence, or by another reading."""
        given: Any = (float(share),) if self.keep_by is None else (float(share), self.keep_by)
        return (own if self.keep_by is None else other)(*given)

    def record(self) -> dict[str, Any]:
        """Return the active filters with their settings: what the cache's key and manifest hold."""
        return {type(step).__name__: asdict(step) for step in self.steps()}  # type: ignore[call-overload]

    @property
    def reads(self) -> tuple[Input, ...]:
        """Return what a frame must have for the active filters: image, truth, other."""
        needs: dict[Input, bool] = {
            "image": self.sky == "mask",
            "truth": self.truth_mask,
            "other": self.left_right is not None,
        }
        return tuple(what for what, needed in needs.items() if needed)

    def __call__(self, depth: Depth, frame: Frame) -> Depth:
        """Apply the active filters."""
        for step in self.steps():
            depth = step(depth, frame)
        return depth
