"""Confidence calibration of a stereo network, on pairs that it was not trained on.

    priors train calibrate priors/weights/cfnet-s.safetensors --street samples/ --real DATA

It runs the network on augmented crops of what training held back: street worlds, and labelled odometry frames and
pairs with truth (KITTI 2015) where there are any. It fits the score and the table of nets/confidence.py on every second
frame, prints how well they hold on the others, and writes them into the header of the weights.

How much distance counts (see nets/confidence.fit) is the least that makes the area under the sparsification curve
clearly smaller than that of dropping the farthest first, in relative error, in D1 and in squared metres, on each
source's fitted half: the more it counts, the more the probabilities depend on how far away things are in the data at
hand.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eval.calibration import calibration_error
from priors.adapt.views import to_tensor
from priors.learn import pair_file
from priors.learn.eye_views import RIGHT
from priors.learn.real_truth import KITTI2015
from priors.learn.stereo_augment import augment
from priors.learn.stereo_data import Folders, find_sources
from priors.learn.stereo_pair import StereoPair
from priors.nets import runtime, weights
from priors.nets.confidence import TERMS, ConfidenceCalibration, evidence, fit
from priors.nets.runtime import Ready, as_map
from priors.types import FloatMap, Mask

LARGEST_PX = 192
PER_PAIR = 6000
"""Pixels drawn of each pair."""
SURE = 0.5
"""Labels count where their weight is above this."""
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
class CalibrationPixels:
    """Pixels of any number of pairs, n in all."""

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


def draw_crops(paths: Sequence[Path], count: int, seed: int = 0) -> list[StereoPair]:
    """Return `count` augmented crops of pairs, evenly spread over the files."""
    rng = np.random.default_rng(seed)
    indices = np.linspace(0, len(paths) - 1, count).round().astype(int) if paths else ()
    return [augment(pair_file.read(paths[index]), rng, CROP) for index in indices]


def collect(ready: Ready, pairs: Sequence[StereoPair], seed: int = 0) -> CalibrationPixels:
    """Run the network on pairs and keep some pixels of each whose truth is known and not the sky."""
    rng = np.random.default_rng(seed)
    parts = []
    for pair in pairs:
        out = ready(to_tensor([pair.left]), to_tensor([pair.right]), largest_px=LARGEST_PX)
        maps = [as_map(map_) for map_ in (out.disparity_px, out.sigma_px, out.doubt)]
        truth_px = pair.disparity_px
        sure = (pair.weight > SURE) & (truth_px > 0.5) & (truth_px < LARGEST_PX - 1)
        drawn = rng.permutation(np.flatnonzero(sure))[:PER_PAIR]
        terms = evidence(*maps).reshape(len(TERMS), -1)[:, drawn]
        parts.append((terms, maps[0].ravel()[drawn], truth_px.ravel()[drawn]))
    terms, disparity_px, true_px = (np.concatenate(column, axis=-1) for column in zip(*parts, strict=True))
    return CalibrationPixels(terms, np.maximum(disparity_px, np.float32(1e-3)), true_px)


def join(parts: Iterable[CalibrationPixels]) -> CalibrationPixels:
    """Return the pixels of all parts."""
    columns = zip(*((part.terms, part.disparity_px, part.truth_px) for part in parts), strict=True)
    return CalibrationPixels(*(np.concatenate(column, axis=-1) for column in columns))


def calibrate(parts: Sequence[CalibrationPixels]) -> ConfidenceCalibration:
    """Fit a calibration to all parts whose order of the pixels beats farthest first in each, in every error.

    With the least weight of distance that does it clearly, or else the one that comes nearest to it.
    """
    pixels = join(parts)
    tried = [fit(pixels.terms, pixels.within, far) for far in FAR]
    worst = [max(max(ratios(one, part)) for part in parts) for one in tried]
    clear = [one for one, ratio in zip(tried, worst, strict=True) if ratio < CLEARLY]
    return clear[0] if clear else tried[int(np.argmin(worst))]


def ratios(calibration: ConfidenceCalibration, pixels: CalibrationPixels) -> tuple[float, float, float]:
    """Return areas under the sparsification curve against farthest first's: of relative error, D1 and squared metres.

    The pixels are sorted by the score: a table has steps. The baseline cancels out.
    """
    relative = np.minimum(np.abs(pixels.truth_px / pixels.disparity_px - 1), LARGEST)
    error_px = np.abs(pixels.disparity_px - pixels.truth_px)
    outlier = (error_px > 3) & (error_px > 0.05 * pixels.truth_px)
    squared = np.where(pixels.truth_px > FARTHEST_PX, np.square(relative / pixels.truth_px), 0)
    score, distance = calibration.score(pixels.terms), -pixels.disparity_px
    first, second, third = (
        area(error.astype(np.float64), score) / max(area(error.astype(np.float64), distance), 1e-12)
        for error in (relative, outlier, squared)
    )
    return first, second, third


def area(error: Flat, score: FloatMap) -> float:
    """Return the mean over all kept shares of the mean error of the share with the lowest scores."""
    sorted_error = error[np.argsort(score, kind="stable")]
    return float(np.mean(np.cumsum(sorted_error) / np.arange(1, error.size + 1))) if error.size else 0.0


def report(name: str, calibration: ConfidenceCalibration, pixels: CalibrationPixels) -> str:
    """Say how well a calibration holds."""
    confidence = calibration.probability(calibration.score(pixels.terms))
    relative, outlier, squared = ratios(calibration, pixels)
    return (
        f"{name}: says {confidence.mean():.3f}, is {pixels.within.mean():.3f}; calibration error "
        f"{calibration_error(confidence, pixels.within):.4f}; area against farthest first: AbsRel {relative:.2f}, "
        f"D1 {outlier:.2f}, m² {squared:.2f}"
    )


def calibrate_file(file: Path, folders: Folders, count: int = 60) -> list[str]:
    """Calibrate a file of weights, rewriting its header.

    Args:
        file: the weights.
        folders: the data of the training; what was prepared for that is used again.
        count: crops of each source in each half.

    Returns:
        Lines that say how well it holds on the half that it was not fitted to.
    """
    about = weights.read_about(file)
    ready = runtime.open_net(about["net"], about["size"], runtime.choose("auto"), file)
    _, held = find_sources(folders)
    frames = [path for path in held.odometry if not path.stem.endswith(RIGHT)]
    halves = []
    for start in (0, 1):
        parts = {
            "street": draw_crops(held.street[start::2], count, start),
            "odometry": draw_crops(frames[start::2], count, start),
            KITTI2015: draw_crops(held.kitti2015[start::2], count, start),
        }
        halves.append({name: collect(ready, pairs, start) for name, pairs in parts.items() if pairs})
    calibration = calibrate(list(halves[0].values()))
    lines = []
    for name, pixels in halves[1].items():
        lines.append(report(f"{name}, as trained", ConfidenceCalibration.trusting(), pixels))
        lines.append(report(f"{name}, calibrated", calibration, pixels))
    lines.append(
        "weights: " + ", ".join(f"{name} {value:.2f}" for name, value in zip(TERMS, calibration.weights, strict=True))
    )
    weights.rewrite_about(file, calibration=calibration.record())
    return lines
