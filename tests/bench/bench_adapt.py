"""Mono that was adapted to the drive, by what teaches it: error on frames that were held out.

    python tests/bench/bench_adapt.py --truth KITTI/depth --adapt lidar stereo video     # 75 s a fold

Two folds: every second frame is held out (image, sweep and all) while the others teach, then the other way round.
Errors are against the drive's truth, uncapped, mean over images. `priors bench` has every other method.
"""

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from eval.protocol import preset
from eval.result import Result, score
from eval.table import show
from priors.drives import DriveOptions, open_drive
from priors.methods.mono import Mono
from priors.types import Depth, Drive, Frame

SHARED = Path(__file__).resolve().parents[3] / "shared"
DRIVE = SHARED / "data/kitti_raw/2011_09_26/2011_09_26_drive_0001_sync"
Make = Callable[[Frame], Depth]
Supervision = Literal["none", "lidar", "stereo", "video"]


def evaluate(name: str, pairs: Iterable[tuple[Make, Frame]]) -> Result:
    """Score the maps that each frame's method makes."""
    maps = ((f.id, (depth := make(f)).depth_m, depth.confidence, f.truth().depth_m) for make, f in pairs)
    return score(maps, preset("uncapped"), info={"prior": name})


def adapted(drive: Drive, frames: list[Frame], how: Supervision, seconds: float) -> Result:
    """Score mono adapted to the drive, each frame by the fold in which it was held out."""
    first = drive.ids.index(frames[0].id)
    pairs: list[tuple[Make, Frame]] = []
    with TemporaryDirectory() as folder:
        for fold in (0, 1):
            method = Mono(
                adapt=how, adapt_s=seconds, hold_out=f"{fold}::2", frames=f"{first}:{first + len(frames)}"
            ).resolve(frames[0])
            make = method.prepare(drive, Path(folder))
            pairs += [(make, frame) for frame in frames[fold::2]]
        return evaluate("mono" if how == "none" else f"mono, adapted by {how}", pairs)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DRIVE)
    parser.add_argument("--truth", type=Path)
    parser.add_argument(
        "--adapt", nargs="*", default=["lidar", "stereo", "video"], choices=["lidar", "stereo", "video"]
    )
    parser.add_argument("--adapt-s", type=float, default=75.0)
    options = parser.parse_args()
    drive = open_drive(options.data, options=DriveOptions(truth=options.truth))
    every = (drive[index] for index in range(len(drive)))
    frames = [frame for frame in every if frame.has("truth") and frame.has("other")]
    show([adapted(drive, frames, how, options.adapt_s) for how in ("none", *options.adapt)])


if __name__ == "__main__":
    main()
