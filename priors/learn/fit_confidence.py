"""Fit of weights/confidence.json: what mends the probabilities that stereo and mono state.

    priors build ../shared/data/kitti_stereo2015/training --method stereo      # and --stereo.model cfnet, pcwnet; mono
    priors build street103 --method stereo                                     # streets of seeds that no training saw
    python -m priors.learn.fit_confidence cache/

It reads the maps of a cache and their truth, all but the frames that are held back (priors/held_back.py), and fits a
line to the log-odds of each reading by logistic regression: each frame counts alike. What maps were made with is taken
into account, so a second fit starts where the first one ended. It prints the calibration error of each drive, before
and after; that of the held-back frames says how well the fit holds.
"""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import tyro

from eval.calibration import Tolerance, calibration_error
from eval.files import write_bytes
from priors import cache, drives, recalibration
from priors.cache import Prior
from priors.error_model import METRE, PIXEL, WITHIN
from priors.errors import DataError
from priors.held_back import is_held_back
from priors.nets import weights
from priors.recalibration import CLASSICAL_STEREO, LogOdds, Recalibration, log_odds
from priors.score import fx_baseline_of

PER_FRAME = 4000
"""Pixels drawn of each frame."""
RIDGE = 1e-4
ROUNDS = 25
LEAST_SLOPE = 0.05
"""A reading that says nothing becomes nearly one probability; it does not turn round."""
HELD_BACK = "held back"
Flat = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Stated:
    """A probability that was stated for n pixels, and what came true."""

    chance: Flat
    right: npt.NDArray[np.bool_]

    @property
    def error(self) -> float:
        """Return the expected calibration error."""
        return calibration_error(self.chance, self.right)


@dataclass
class Pixels:
    """What one method stated, by drive; the frames that are held back stand apart."""

    within: Tolerance
    """What its own confidence is the probability of."""
    digest: str | None
    """Of its weights."""
    own: dict[str, list[Stated]] = field(default_factory=dict)
    relative: dict[str, list[Stated]] = field(default_factory=dict)


@dataclass(frozen=True)
class ConfidenceFit:
    """Fit weights/confidence.json to the maps of caches."""

    caches: tyro.conf.Positional[tuple[Path, ...]] = (Path("cache"),)
    """Caches with maps of drives that have a truth."""
    out: Path = recalibration.FILE
    """Where the numbers go; those of methods without maps stay."""
    seed: int = 0
    """Decides which pixels are drawn."""


def main(arguments: list[str] | None = None) -> None:
    """Fit, write, and print how each drive fares; takes the command line's arguments."""
    config = tyro.cli(ConfidenceFit, args=arguments, description=__doc__)
    held = dict(recalibration.read())
    for name, pixels in collect((p for path in config.caches for p in cache.find(path)), config.seed).items():
        now = Recalibration.of(name, pixels.digest)
        own, relative = fit_reading(pixels.own), fit_reading(pixels.relative)
        for reading, parts, found in ((str(pixels.within), pixels.own, own), ("5 %", pixels.relative, relative)):
            for line in report(parts, found):
                print(f"{name}, within {reading}: {line}")
        fitted = Recalibration(own.after(now.own), relative.after(now.relative))
        held[name] = fitted.record() | ({} if pixels.digest is None else {"weights": pixels.digest})
        print(f"{name}: {fitted.record()}")
    write_bytes(config.out, (json.dumps(held, indent=1, sort_keys=True) + "\n").encode())
    print(f"wrote {config.out}")


def collect(priors: Iterable[Prior], seed: int) -> dict[str, Pixels]:
    """Draw pixels of the maps of stereo and mono whose drives have a truth, by the names of the file."""
    found: dict[str, Pixels] = {}
    for prior in priors:
        name = name_of(prior)
        if name is None:
            continue
        digest = None if name == CLASSICAL_STEREO else weights.digest(weights.FOLDER / f"{name}.safetensors")
        within = METRE if prior.method == "mono" or digest is None else PIXEL
        pixels = found.setdefault(name, Pixels(within, digest))
        for drive, own, relative in draw(prior, within, np.random.default_rng(seed)):
            pixels.own.setdefault(drive, []).append(own)
            pixels.relative.setdefault(drive, []).append(relative)
    return found


def name_of(prior: Prior) -> str | None:
    """Return a prior's name in the file; None where it is of another method, or of the user's weights."""
    config = prior.manifest.get("config", {})
    if prior.method not in ("stereo", "mono") or config.get("weights") is not None or prior.manifest.get("filters"):
        return None
    if prior.method == "mono":
        return None if config.get("adapt", "none") != "none" else f"bts-{config['size']}"
    return CLASSICAL_STEREO if config["model"] == "classical" else f"{config['model']}-{config['size']}"


def draw(prior: Prior, within: Tolerance, rng: np.random.Generator) -> Iterator[tuple[str, Stated, Stated]]:
    """Draw pixels of each frame of a prior that has a truth: the drive's name, and what both readings stated."""
    drive = drives.reopen(prior.drive)
    places = {frame_id: index for index, frame_id in enumerate(drive.ids)}
    for frame_id in prior.ids():
        frame = drive[places[frame_id]]
        if not frame.has("truth"):
            continue
        depth, truth = prior.read(frame_id), frame.truth()
        if depth.confidence is None or depth.within_5_percent is None:
            raise DataError(f"{prior.folder}: frame {frame_id} does not tell both probabilities: build it again")
        known = depth.valid & truth.valid & (depth.confidence > 0)
        drawn = rng.permutation(np.flatnonzero(known))[:PER_FRAME]
        found_m, true_m = (values.ravel()[drawn].astype(np.float64) for values in (depth.depth_m, truth.depth_m))
        own, relative = (
            Stated(chance.ravel()[drawn].astype(np.float64), each.within(found_m, true_m, fx_baseline_of(frame)))
            for chance, each in ((depth.confidence, within), (depth.within_5_percent, WITHIN))
        )
        apart = f"{drive.name}, {HELD_BACK}" if is_held_back(drive.name, frame_id) else drive.name
        yield apart, own, relative


def fit_reading(parts: dict[str, list[Stated]]) -> LogOdds:
    """Fit a reading's line to all frames but those that are held back; as it is where there are none."""
    frames = [
        frame for name, part in parts.items() if not name.endswith(HELD_BACK) for frame in part if frame.chance.size
    ]
    together = join(frames)
    if not together.chance.size:
        return LogOdds()
    return regress(together, np.concatenate([np.full(frame.chance.size, 1 / frame.chance.size) for frame in frames]))


def regress(stated: Stated, weight: Flat) -> LogOdds:
    """Return the line on the log-odds that makes what came true most likely: Newton's steps, with a small ridge.

    Args:
        stated: n pixels.
        weight: (n,) how much each counts.
    """
    odds = log_odds(stated.chance.astype(np.float32)).astype(np.float64)
    A, line = np.stack([np.ones_like(odds), odds], axis=1), np.array([0.0, 1.0])
    start = line.copy()
    for _ in range(ROUNDS):
        chance = 1 / (1 + np.exp(-np.clip(A @ line, -30, 30)))
        curve = A * (weight * chance * (1 - chance))[:, None]
        slope = A.T @ (weight * (chance - stated.right)) + RIDGE * (line - start)
        line = line - np.linalg.solve(A.T @ curve + RIDGE * np.eye(2), slope)
    return LogOdds(float(line[0]), max(float(line[1]), LEAST_SLOPE))


def report(parts: dict[str, list[Stated]], line: LogOdds) -> Iterator[str]:
    """Say of each drive what was stated and is right, and the calibration error, before and after."""
    for drive, frames in parts.items():
        before = join(frames)
        after = replace(before, chance=line(before.chance.astype(np.float32)).astype(np.float64))
        yield (
            f"{drive} ({len(frames)} frames): says {before.chance.mean():.3f}, then {after.chance.mean():.3f}, "
            f"is {before.right.mean():.3f}; calibration error {before.error:.3f}, then {after.error:.3f}"
        )


def join(frames: list[Stated]) -> Stated:
    """Put the pixels of frames together."""
    chance = np.concatenate([np.zeros(0), *(frame.chance for frame in frames)])
    right = np.concatenate([np.zeros(0, np.bool_), *(frame.right for frame in frames)])
    return Stated(chance, right)


if __name__ == "__main__":
    main()
