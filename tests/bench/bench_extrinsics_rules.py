"""False alarms and misses of the extrinsics by threshold, on streets whose calibration is made wrong, and on others.

python tests/bench/bench_extrinsics_rules.py street/street/* corner/street/*       streets: the truth is known
    python tests/bench/bench_extrinsics_rules.py DRIVE --as-it-is                  a real drive, taken for right

On each drive: as it is; with the LiDAR 1 cm aside, 1 cm up and 2 cm ahead (standard deviations, drawn); and beside that
turned by 0.15, 0.2 and 0.3 degrees about one axis, 20 ms late, 10 ms early.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from priors.drives import open_drive
from priors.extrinsics import surfaces
from priors.extrinsics.correction import NONE, Correction
from priors.extrinsics.measure import measure, spread_frames
from priors.extrinsics.measured import LATE_S, TURNED_DEG, Measured, is_sure
from priors.types import Camera, Frame, Image

TURNS_DEG = (0.15, -0.2, 0.3)
PLACE_M = (0.01, 0.01, 0.02)
RULES = ((2.5, 0.0), (2.0, 0.0), (1.0, 2.5), (1.0, 3.0), (0.0, 3.0))
"""A turn is told where so many errors less are above TURNED_DEG, and where it has so many errors."""
ANGLES = (1.0, 2.0, 2.5, 3.0)


@dataclass(frozen=True)
class Trial:
    """One measurement."""

    made: Correction
    """What was done to the calibration: what is found should be its opposite."""
    found: Measured

    @property
    def found_deg(self) -> np.ndarray:
        """Return what was found (3,)."""
        return np.array(self.found.correction.turn_deg)

    @property
    def off_deg(self) -> np.ndarray:
        """Return what was found, less what is right (3,)."""
        return self.found_deg + np.array(self.made.turn_deg)

    @property
    def errors_deg(self) -> np.ndarray:
        """Return the standard errors (3,)."""
        return np.array(self.found.errors_deg)


def cases(seed: int) -> Iterator[Correction]:
    """Make calibrations wrong."""
    rng = np.random.default_rng(seed + 7)
    yield NONE
    late = [(0.0, 0.0)] + [(turn, 0.0) for turn in TURNS_DEG] + [(0.0, 0.02), (0.0, -0.01)]
    for number, (turn, delay_s) in enumerate(late):
        turned, place = np.roll([turn, 0.0, 0.0], seed + number - 1), rng.normal(0, PLACE_M).round(4)
        pitch, yaw, roll = (float(each) for each in turned)
        right, down, forward = (float(each) for each in place)
        yield Correction((pitch, yaw, roll), -delay_s, (right, down, forward))


def trials(frames: Sequence[Frame], made: Sequence[Correction]) -> Iterator[Trial]:
    """Measure a drive whose calibration is made wrong in each way."""
    for wrong in made:
        off = [wrong.frame(frame) for frame in frames]
        trial = Trial(wrong, measure(off))
        print(f"  {wrong}\n    {trial.found}", flush=True)
        yield trial


def table(found: Sequence[Trial]) -> Iterator[str]:
    """Say how right the errors are, and what each threshold gets wrong."""
    off, errors = (np.array([getattr(t, name) for t in found]) for name in ("off_deg", "errors_deg"))
    yield f"{len(found)} trials; off by {_rms(off)} degrees, {_rms(off / errors)} standard errors (rms)"
    right, turned = ([t for t in found if (t.made.size_deg > 0) == is_turned] for is_turned in (False, True))
    for rule in RULES:
        false = sum(_told(t, rule) for t in right)
        yield f"told from {rule} errors on: {false} of {len(right)} false; missed: {_missed(turned, rule)}"
    right, late = ([t for t in found if (t.made.delay_s != 0) == is_late] for is_late in (False, True))
    false = sum(t.found.has_delay for t in right)
    yield f"a delay: {false} of {len(right)} false, {sum(not t.found.has_delay for t in late)} of {len(late)} missed"
    false, told = (
        sum(is_sure(t.found.correction.delay_s, t.found.delay_error_s, LATE_S) for t in some) for some in (right, late)
    )
    yield f"warned of: {false} of {len(right)} false, {len(late) - told} of {len(late)} missed"
    for sure in ANGLES:
        left = [np.where(np.abs(t.found_deg) < sure * t.errors_deg, t.made.turn_deg, t.off_deg) for t in found]
        yield f"angles applied from {sure} errors on: left off by {np.sqrt(np.mean(np.square(left))):.3f} degrees (rms)"


def _rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(np.square(values), axis=0)).round(3)


def _told(trial: Trial, rule: tuple[float, float]) -> bool:
    size, error = trial.found.correction.size_deg, trial.found.error_deg
    return size - rule[0] * error > TURNED_DEG and size >= rule[1] * error


def _missed(turned: Sequence[Trial], rule: tuple[float, float]) -> str:
    sizes = sorted({round(t.made.size_deg, 2) for t in turned})
    some = {size: [t for t in turned if round(t.made.size_deg, 2) == size] for size in sizes}
    return ", ".join(f"{sum(not _told(t, rule) for t in ts)} of {len(ts)} at {size}" for size, ts in some.items())


def main() -> None:
    """Print the trials, then the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drives", type=Path, nargs="+", help="the drives' folders")
    parser.add_argument("--as-it-is", action="store_true", help="make nothing wrong")
    args = parser.parse_args()
    found: list[Trial] = []
    surfaces.match_small = _once(surfaces.match_small)
    for path in args.drives:
        drive = open_drive(path)
        frames = [_in_memory(drive[place]) for place in spread_frames(drive)]
        print(path, flush=True)
        number = int("0" + "".join(filter(str.isdigit, path.name)))  # street_0301_sync: the street's seed
        found += trials(frames, [NONE] if args.as_it_is else list(cases(number)))
    print("\n".join(table(found)))


def _once(match: Callable[..., Any]) -> Callable[..., Any]:
    """Return a matcher that matches a pair once: it is the same however the LiDAR is placed."""
    kept: dict[int, Any] = {}

    def matched(left: Image, right: Image, camera: Camera) -> Any:
        key = hash((left.tobytes(), right.tobytes()))
        if key not in kept:
            kept[key] = match(left, right, camera)
        return kept[key]

    return matched


def _in_memory(frame: Frame) -> Frame:
    read = {what: frame.read(what) for what in ("image", "other", "sweep") if frame.has(what)}  # type: ignore[arg-type]
    return replace(frame, readers={what: lambda offset=0, found=found: found for what, found in read.items()})


if __name__ == "__main__":
    main()
