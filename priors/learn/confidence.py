"""Calibrate a stereo network's confidence on pairs that it was not trained on.

    python -m priors.learn.confidence priors/weights/cfnet-m.safetensors --street samples/

Runs the network on varied crops of the street's validation worlds, fits the score and the table of nets/confidence.py
on every second item, prints how well they hold on the others, and writes them into the header of the weights.

How much distance counts (see nets/confidence.fit) is chosen so that the worse of two ratios is best on the fitted half:
the area under the sparsification curve against that of dropping the farthest first, in relative error and in D1.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from tyro.conf import Positional

from priors.learn.pair import Item, from_street, to_item
from priors.learn.scans import Streets
from priors.learn.vary import vary
from priors.nets import runtime, weights
from priors.nets.confidence import TERMS, Calibration, evidence, fit, miscalibration
from priors.nets.runtime import Ready, as_map
from priors.types import FloatMap, Mask

LARGEST_PX = 192
PER_ITEM = 6000
"""Pixels drawn of each item."""
CROP = (256, 512)
FAR = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0)
"""Weights of distance that are tried."""
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


def validation_items(street: Path, count: int, seed: int = 0) -> list[Item]:
    """Return varied crops of worlds that training never draws from."""
    paths = Streets(street).validation
    rng = np.random.default_rng(seed)
    chosen = paths[:: max(1, len(paths) // count)][:count]
    return [to_item(vary(from_street(path), rng, CROP)) for path in chosen]


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


def calibrate(seen: Seen) -> Calibration:
    """Fit a calibration whose order of the pixels is good for both relative error and D1."""
    return min((fit(seen.terms, seen.within, far) for far in FAR), key=lambda made: max(ratios(made, seen)))


def ratios(calibration: Calibration, seen: Seen) -> tuple[float, float]:
    """Return the area under the sparsification curve against farthest first's: of relative error, and of D1.

    The pixels are sorted by the score: a table has steps.
    """
    relative = np.abs(seen.truth_px / seen.disparity_px - 1).astype(np.float64)
    error_px = np.abs(seen.disparity_px - seen.truth_px)
    outlier = ((error_px > 3) & (error_px > 0.05 * seen.truth_px)).astype(np.float64)
    score, distance = calibration.score(seen.terms), -seen.disparity_px
    first, second = (
        area(error, score) / max(area(error, distance), 1e-12) for error in (np.minimum(relative, 1.0), outlier)
    )
    return first, second


def area(error: Flat, score: FloatMap) -> float:
    """Return the mean over all kept shares of the mean error of the share with the lowest scores."""
    sorted_error = error[np.argsort(score, kind="stable")]
    return float(np.mean(np.cumsum(sorted_error) / np.arange(1, error.size + 1))) if error.size else 0.0


def report(name: str, calibration: Calibration, seen: Seen) -> str:
    """Say how well a calibration holds."""
    confidence = calibration.probability(calibration.score(seen.terms))
    relative, outlier = ratios(calibration, seen)
    return (
        f"{name}: says {confidence.mean():.3f}, is {seen.within.mean():.3f}; calibration error "
        f"{miscalibration(confidence, seen.within):.4f}; area against farthest first: AbsRel {relative:.2f}, "
        f"D1 {outlier:.2f}"
    )


def run(file: Positional[Path], street: Path, count: int = 120) -> None:
    """Calibrate a file of weights.

    Args:
        file: the weights; their header is rewritten.
        street: folder of rendered samples (`priors train render`).
        count: crops to look at.
    """
    about = weights.read_about(file)
    ready = runtime.open_net(about["net"], about["size"], runtime.choose("auto"), file)
    items = validation_items(street, count)
    seen = [look(ready, items[start::2], seed=start) for start in (0, 1)]
    made = calibrate(seen[0])
    print(report("as trained, the other half", Calibration.trusting(), seen[1]))
    print(report("calibrated, the other half", made, seen[1]))
    print("weights: " + ", ".join(f"{name} {value:.2f}" for name, value in zip(TERMS, made.weights, strict=True)))
    weights.rewrite_about(file, calibration=made.record())


if __name__ == "__main__":
    import tyro

    tyro.cli(run, description=__doc__)
