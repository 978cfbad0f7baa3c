"""Is a fused map nowhere worse than its parts? Each part against it, on the pixels where the part has a value.

    python tests/bench/bench_fused.py cache/DRIVE/fused-KEY cache/DRIVE/lidar-KEY cache/DRIVE/stereo-KEY --held-back
    python tests/bench/bench_fused.py cache/DRIVE/fused-KEY cache/DRIVE/stereo-KEY --against cache/DRIVE/lidar-KEY

AbsRel and RMSE below 80 m, mean over frames.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from priors import cache, drives
from priors.held_back import is_held_back
from priors.naming import labels
from priors.selection import select
from priors.types import FloatMap, Mask

CAP_M = 80.0


@dataclass(frozen=True)
class Arguments:
    """What to compare."""

    fused: tyro.conf.Positional[Path]
    """The folder of the fused maps."""
    parts: tyro.conf.Positional[tuple[Path, ...]]
    """The folders of its parts, or of other maps of the same frames."""
    frames: str | None = None
    """Only this range of frames, a:b."""
    held_back: bool = False
    """Only frames that no network was trained on."""
    against: Path | None = None
    """A prior in place of the drive's truth."""


def main(args: Arguments) -> None:
    """Print a row a part."""
    fused, parts = cache.only(args.fused), [cache.only(path) for path in args.parts]
    drive = drives.reopen(fused.drive)
    truth = None if args.against is None else cache.only(args.against)
    chosen = [drive.ids[index] for index in select(drive.ids, args.frames)]
    ids = [id_ for id_ in chosen if fused.has(id_) and (not args.held_back or is_held_back(drive.name, id_))]
    rows: dict[str, list[tuple[float, ...]]] = {}
    for id_ in ids:
        frame = drive[drive.ids.index(id_)]
        true_m = (frame.truth() if truth is None else truth.read(id_)).depth_m
        joined_m = fused.read(id_).depth_m
        for name, part in zip(labels([fused, *parts])[1:], parts, strict=True):
            part_m = part.read(id_).depth_m
            known = (true_m > 0) & (true_m < CAP_M) & (part_m > 0)
            rows.setdefault(name, []).append(
                (known.sum() / (true_m > 0).sum(), *errors(part_m, true_m, known), *errors(joined_m, true_m, known))
            )
    print("| part | of the truth's pixels | AbsRel: part, fused | RMSE m: part, fused |\n|---|---:|---:|---:|")
    for name, found in rows.items():
        share, part_rel, part_m, rel, m = np.mean(found, axis=0)
        print(f"| {name} | {100 * share:.1f} % | {part_rel:.4f}, {rel:.4f} | {part_m:.3f}, {m:.3f} |")
    print(f"{len(ids)} frames of {drive.name}")


def errors(found_m: FloatMap, true_m: FloatMap, known: Mask) -> tuple[float, float]:
    """Return AbsRel and RMSE, metres, of a map where it is known."""
    error_m = np.minimum(found_m[known], CAP_M) - true_m[known]
    return float(np.mean(np.abs(error_m) / true_m[known])), float(np.sqrt(np.mean(error_m**2)))


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
