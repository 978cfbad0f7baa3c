"""Fill values: numbers in a depth map that stand for 'none' there, and are read as metres."""

from collections.abc import Iterator, Sequence

import numpy as np

from priors.check.finding import Finding
from priors.check.sample import Sample
from priors.types import FloatMap

LARGEST_M = 255.99
"""What 65535 is read as, in metres, less a little."""
MANY = 0.005
"""Share of a map's values that must be 65535."""
OFTEN = 0.05
"""Share of a map's values that must be one and the same number."""
BEYOND = 1.5
"""A fill value is so many times as far as nearly all others, or so far from what stereo or LiDAR see there."""


def judge_fills(what: str, maps: Sequence[tuple[Sample, FloatMap]]) -> Iterator[Finding]:
    """Find values of truth or sparse maps that stand for 'none'."""
    values = np.concatenate([map_m[map_m > 0] for _, map_m in maps])
    largest = float(np.mean((values >= LARGEST_M) & (values < 256)))
    if largest > MANY:
        text = f"{largest:.0%} of its values are 65535, read as 256 m: do they stand for none? write 0 there"
        yield Finding("warning", what, text)
        return
    by_frame = [fill for sample, map_m in maps if (fill := _fill(sample, map_m)) is not None]
    if 2 * len(by_frame) > len(maps):
        value_m, share = (float(np.median(numbers)) for numbers in zip(*by_frame, strict=True))
        text = f"{share:.0%} of its values are exactly {value_m:g} m: do they stand for none? write 0 there"
        yield Finding("warning", what, text)


def _fill(sample: Sample, map_m: FloatMap) -> tuple[float, float] | None:
    """Return the number that fills a map, metres, and its share of the values; None where none does."""
    values_m = map_m[map_m > 0]
    numbers, counts = np.unique(values_m, return_counts=True)
    often = int(np.argmax(counts))
    value_m, share = float(numbers[often]), float(counts[often] / values_m.size)
    if share < OFTEN or not (_stands_out(values_m, value_m) or _is_denied(sample, map_m == numbers[often], value_m)):
        return None
    return value_m, share


def _stands_out(values_m: FloatMap, value_m: float) -> bool:
    """Tell whether a number is far beyond, or far below, nearly all others."""
    others_m = values_m[values_m != np.float32(value_m)]
    if others_m.size == 0:
        return True
    low_m, high_m = np.quantile(others_m, (0.01, 0.99))
    return bool(value_m > BEYOND * high_m or value_m * BEYOND < low_m)


def _is_denied(sample: Sample, there: np.ndarray, value_m: float) -> bool:
    """Tell whether stereo or LiDAR see another depth where a map has one number."""
    for name in ("stereo", "LiDAR"):
        reference_m = sample.depths.get(name)
        if reference_m is None:
            continue
        seen_m = reference_m[there & (reference_m > 0)]
        if seen_m.size >= 50:
            off = np.abs(np.log(seen_m / value_m))
            # A map of another scale is wrong everywhere, by one factor; a fill value is so by many.
            return bool(np.median(off) > np.log(BEYOND) and np.ptp(np.quantile(np.log(seen_m), (0.1, 0.9))) > 0.5)
    return False


def without_fill(map_m: FloatMap) -> FloatMap:
    """Return a map (height, width) without its largest code: 65535 is never a distance."""
    return np.where((map_m >= LARGEST_M) & (map_m < 256), np.float32(0), map_m)
