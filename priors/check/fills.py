"""Fill values: numbers in a depth map that stand for 'none' there, and are read as metres."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from priors.check.finding import Finding
from priors.check.sample import Sample
from priors.types import FloatMap, Mask

LARGEST_M = np.float32(65535 / 256)
"""What 65535 is read as, metres."""
MANY = 0.005
"""Share of a map's values that must be 65535."""
OFTEN, ALIKE, FEW = 0.05, 0.005, 0.2
"""Share of a map's values that must be one and the same other number. It is no surface's where values that are alike,
to that share of the depth, are few: this share of its own."""
BEYOND = 1.5
"""A fill value is so many times as far as nearly all others, or so far from what stereo or LiDAR see there."""
SEEN = 50
"""Pixels of the fill value at which stereo or LiDAR must see something."""


@dataclass(frozen=True)
class Fill:
    """A number that stands for 'none'."""

    value_m: float
    share: float
    """Of the maps' values."""


def find_fill(sampled: Sequence[Sample], what: str) -> Fill | None:
    """Find the number that stands for 'none' in most of the maps of a kind; None where none does."""
    maps = [(sample, sample.depths[what]) for sample in sampled if what in sample.depths]
    if not maps:
        return None
    full = float(np.mean(np.concatenate([map_m[map_m > 0] == LARGEST_M for _, map_m in maps])))
    if full > MANY:
        return Fill(float(LARGEST_M), full)
    fills = [fill for sample, map_m in maps if (fill := _fill(sample, map_m)) is not None]
    if 2 * len(fills) <= len(maps):
        return None
    return Fill(float(np.median([f.value_m for f in fills])), float(np.median([f.share for f in fills])))


def judge_fill(what: str, fill: Fill | None) -> Iterator[Finding]:
    """Tell of a fill value."""
    if fill is not None:
        number = "65535 (256 m)" if fill.value_m == LARGEST_M else f"exactly {fill.value_m:g} m"
        text = f"{fill.share:.0%} of its values are {number}: do they stand for none, or for farther? write 0"
        yield Finding("warning", what, text)


def _fill(sample: Sample, map_m: FloatMap) -> Fill | None:
    """Return the number that fills a map; None where none does."""
    values_m = map_m[map_m > 0]
    numbers, counts = np.unique(values_m, return_counts=True)
    often = int(np.argmax(counts))
    share = float(counts[often] / values_m.size)
    if share < OFTEN:
        return None
    fill = Fill(float(numbers[often]), share)
    alike = np.abs(numbers / numbers[often] - 1) < ALIKE
    alone = counts[alike].sum() - counts[often] < FEW * counts[often]
    found = alone or _stands_out(values_m, fill.value_m) or _is_denied(sample, map_m == numbers[often], fill.value_m)
    return fill if found else None


def _stands_out(values_m: FloatMap, value_m: float) -> bool:
    """Tell whether a number is far beyond, or far below, nearly all others."""
    others_m = values_m[values_m != np.float32(value_m)]
    if others_m.size == 0:
        return True
    low_m, high_m = np.quantile(others_m, (0.01, 0.99))
    return bool(value_m > BEYOND * high_m or value_m * BEYOND < low_m)


def _is_denied(sample: Sample, there: Mask, value_m: float) -> bool:
    """Tell whether stereo or LiDAR see many depths, and others, where a map has one number."""
    for name in ("stereo", "LiDAR"):
        reference_m = sample.depths.get(name)
        if reference_m is None:
            continue
        seen_m = reference_m[there & (reference_m > 0)]
        if seen_m.size >= SEEN:
            off = np.abs(np.log(seen_m / value_m))
            return bool(np.median(off) > np.log(BEYOND) and np.ptp(np.quantile(np.log(seen_m), (0.1, 0.9))) > 0.5)
    return False
