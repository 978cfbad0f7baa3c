"""Calibrate a stereo network's confidence on pairs that it was not trained on.

    priors train calibrate priors/weights/cfnet-s.safetensors --street samples/ --real DATA

Runs the network on varied crops of what training held back (street worlds, and labelled odometry frames where there are
any), fits the score and the table of nets/confidence.py on every second frame, prints how well they hold on the others,
and writes them into the header of the weights.

How much distance counts (see nets/confidence.fit) is the least that makes the area under the sparsification curve
clearly smaller than that of dropping the farthest first, in relative error, in D1 and in squared metres, on each
source's fitted half: the more it counts, the more the probabilities depend on how far away things are in the data at
hand.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from priors.learn import pseudo
from priors.learn.stereo_augment import vary
from priors.learn.stereo_data import find
from priors.learn.stereo_pair import Item, Pair, from_street, to_item
from priors.nets import runtime, weights
from priors.nets.confidence import TERMS, ConfidenceCalibration, evidence, fit, miscalibration
from priors.nets.runtime import Ready, as_map
from priors.types import FloatMap, Mask

LARGEST_PX = 192
PER_ITEM = 6000
"""Pixels drawn of each item."""
CROP = (256, 512)
FAR = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0)
"""Weights of distance that are tried."""
CLEARLY = 0.7
"""Ratio of areas."""
FARTHEST_PX = 4.5
"""Least disparity whose squared error in metres counts: 86 m for KITTI, whose scores end there."""
LARGEST = 1.0
"""What a relative error counts at most."""
Flat = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Seen:
    """Pixels of any number of items, n in all."""

    terms: FloatMap
    """(5, n) evidence."""
    disparity_px: FloatMap
    """(n,) what the network found."""
    truth_px: FloatMap
    """(n,)."""

    @property
    def within(self) -> Mask:
        """Tell which are right within 1 px."""
        return np.abs(self.disparity_px - self.truth_px) <= 1


def crops(paths: Sequence[Path], read: Callable[[Path], Pair], count: int, seed: int = 0) -> list[Item]:
    """Return varied crops of pairs, evenly spread over the files."""
    rng = np.random.default_rng(seed)
    chosen = [paths[index] for index in np.linspace(0, len(paths) - 1, count).round().astype(int)] if paths else []
    return [to_item(vary(read(path), rng, CROP)) for path in chosen]


def look(ready: Ready, items: Sequence[Item], seed: int = 0) -> Seen:
    """Run the network on items and keep some pixels of each whose truth is known and not the sky."""
    rng = np.random.default_rng(seed)
    parts = []
    for item in items:
        views = [torch.from_numpy(np.ascontiguousarray(item[side]))[None] for side in ("left", "right")]
        found = ready(*views, largest_px=LARGEST_PX)
        maps = [as_map(map_) for map_ in (found.disparity_px, found.sigma_px, found.doubt)]
        truth_px = item["disparity_px"]
        sure = item["known"] & (item["weight"] > 0.5) & (truth_px > 0.5) & (truth_px < LARGEST_PX - 1)
        drawn = rng.permutation(np.flatnonzero(sure))[:PER_ITEM]
        terms = evidence(*maps).reshape(5, -1)[:, drawn]
        parts.append((terms, maps[0].ravel()[drawn], truth_px.ravel()[drawn]))
    terms, found_px, true_px = (np.concatenate(column, axis=-1) for column in zip(*parts, strict=True))
    return Seen(terms, np.maximum(found_px, np.float32(1e-3)), true_px)


def join(parts: Iterable[Seen]) -> Seen:
    """Return the pixels of all parts."""
    columns = zip(*((part.terms, part.disparity_px, part.truth_px) for part in parts), strict=True)
    return Seen(*(np.concatenate(column, axis=-1) for column in columns))


def calibrate(parts: Sequence[Seen]) -> ConfidenceCalibration:
    """Fit a calibration to all parts whose order of the pixels beats farthest first in each, in every error.

    With the least weight of distance that does it clearly, or else the one that comes nearest to it.
    """
    seen = join(parts)
    tried = [fit(seen.terms, seen.within, far) for far in FAR]
    worst = [max(max(ratios(made, part)) for part in parts) for made in tried]
    clear = [made for made, ratio in zip(tried, worst, strict=True) if ratio < CLEARLY]
    return clear[0] if clear else tried[int(np.argmin(worst))]


def ratios(calibration: ConfidenceCalibration, seen: Seen) -> tuple[float, float, float]:
    """Return areas under the sparsification curve against farthest first's: of relative error, D1 and squared metres.

    The pixels are sorted by the score: a table has steps. The baseline cancels out.
    """
    relative = np.minimum(np.abs(seen.truth_px / seen.disparity_px - 1), LARGEST)
    error_px = np.abs(seen.disparity_px - seen.truth_px)
    outlier = (error_px > 3) & (error_px > 0.05 * seen.truth_px)
    squared = np.where(seen.truth_px > FARTHEST_PX, np.square(relative / seen.truth_px), 0)
    score, distance = calibration.score(seen.terms), -seen.disparity_px
    first, second, third = (
        area(error.astype(np.float64), score) / max(area(error.astype(np.float64), distance), 1e-12)
        for error in (relative, outlier, squared)
    )
    return first, second, third


def area(error: Flat, score: FloatMap) -> float:
    """Return the mean over all kept shares of the mean error of the share with the lowest scores."""
    sorted_error = error[np.argsort(score, kind="stable")]
    return float(np.mean(np.cumsum(sorted_error) / np.arange(1, error.size + 1))) if error.size else 0.0


def report(name: str, calibration: ConfidenceCalibration, seen: Seen) -> str:
    """Say how well a calibration holds."""
    confidence = calibration.probability(calibration.score(seen.terms))
    relative, outlier, squared = ratios(calibration, seen)
    return (
        f"{name}: says {confidence.mean():.3f}, is {seen.within.mean():.3f}; calibration error "
        f"{miscalibration(confidence, seen.within):.4f}; area against farthest first: AbsRel {relative:.2f}, "
        f"D1 {outlier:.2f}, m² {squared:.2f}"
    )


def calibrate_file(
    file: Path, street: Path, real: Path | None = None, cache: Path | None = None, count: int = 60
) -> list[str]:
    """Calibrate a file of weights, rewriting its header.

    Args:
        file: the weights.
        street: folder of rendered samples (`priors train samples`).
        real: folder with kitti_odometry; what was prepared of it for training is used again.
        cache: where that is.
        count: crops of each source in each half.

    Returns:
        lines that say how well it holds on the half that it was not fitted to.
    """
    about = weights.read_about(file)
    ready = runtime.open_net(about["net"], about["size"], runtime.choose("auto"), file)
    _, held = find(street, real, cache)
    frames = [path for path in held.odometry if not path.stem.endswith("_right")]
    halves = []
    for start in (0, 1):
        parts = {
            "street": crops(held.street[start::2], from_street, count, start),
            "odometry": crops(frames[start::2], pseudo.read, count, start),
        }
        halves.append({name: look(ready, items, start) for name, items in parts.items() if items})
    made = calibrate(list(halves[0].values()))
    lines = []
    for name, seen in halves[1].items():
        lines.append(report(f"{name}, as trained", ConfidenceCalibration.trusting(), seen))
        lines.append(report(f"{name}, calibrated", made, seen))
    lines.append(
        "weights: " + ", ".join(f"{name} {value:.2f}" for name, value in zip(TERMS, made.weights, strict=True))
    )
    weights.rewrite_about(file, calibration=made.record())
    return lines
