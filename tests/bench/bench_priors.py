"""Every kind of prior on the same frames: error and time, in one interleaved run, and the error-time plot.

    python tests/bench/bench_priors.py --data DRIVE --truth KITTI/depth
    python tests/bench/bench_priors.py ... --adapt lidar stereo     # mono fine-tuned on the drive first, 75 s a fold

Times are of the method alone, images in memory, contestants in turn. Errors are against the drive's truth, uncapped,
mean over images, over the pixels that have a value. Stereo's offset is that of the first frame's sweep. Adapted mono is
scored in two folds: every second frame is held out (image, sweep and all) while the others teach, then the other way
round.
"""

import argparse
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np
from bench_completion import recipe
from bench_networks import DRIVE, in_memory
from scatter import Dot, write_scatter

from eval.protocol import preset
from eval.result import Result, score
from priors.drives import DriveOptions, open_drive
from priors.errors import DataError
from priors.methods.completion import Completion
from priors.methods.lidar import Lidar
from priors.methods.mono import Mono
from priors.methods.stereo import Stereo
from priors.types import Depth, Drive, Frame, Method

PLOT = Path(__file__).resolve().parents[2] / "docs/images/priors_error_time.png"
Make = Callable[[Frame], Depth]
Supervision = Literal["lidar", "stereo", "video"]


@dataclass(frozen=True)
class Contestant:
    """A method, and the colour of its family."""

    name: str
    make: Make
    family: int


def contestants(frame: Frame) -> Iterable[Contestant]:
    """List every method and preset that has weights, resolved on a frame."""
    yield Contestant("recipe (IP-Basic)", lambda frame: recipe(frame.sparse().depth_m), 0)
    methods: list[tuple[str, Method, int]] = [
        ("lidar, 11 sweeps", Lidar(), 1),
        ("completion", Completion(), 2),
        ("completion mffnet-s", Completion(model="mffnet"), 2),
        ("stereo", Stereo(), 3),
        ("stereo cfnet-s", Stereo(model="cfnet"), 3),
        ("stereo pcwnet-s", Stereo(model="pcwnet"), 3),
        ("mono", Mono(), 4),
    ]
    for name, method, family in methods:
        try:
            resolved = method.resolve(frame)
            resolved(frame)
        except DataError as error:
            print(f"without {name}: {error}")
        else:
            yield Contestant(name, resolved, family)


def measure(everyone: list[Contestant], frames: list[Frame], rounds: int) -> dict[str, float]:
    """Return each one's median milliseconds, contestants in turn, after one run that is not counted."""
    spent: dict[str, list[float]] = {contestant.name: [] for contestant in everyone}
    for count in range(rounds + 1):
        for contestant in everyone:
            start = time.perf_counter()
            contestant.make(frames[count % len(frames)])
            spent[contestant.name] += [1e3 * (time.perf_counter() - start)] if count else []
    return {name: float(np.median(values)) for name, values in spent.items()}


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
        return evaluate(f"mono, adapted by {how}", pairs)


def row(result: Result, milliseconds: float | None) -> str:
    """Return a line of the table."""
    found = result.metrics("image")
    cells = ["" if milliseconds is None else f"{milliseconds:.0f}", f"{found['density']:.1%}"]
    kinds = {"abs_rel": ".4f", "sq_rel": ".3f", "rmse": ".3f", "rmse_log": ".4f", "mae": ".3f", "delta_1": ".4f"}
    cells += [format(found[name], kind) for name, kind in kinds.items()]
    return f"| {result.info['prior']} | " + " | ".join(cells) + " |"


def main() -> None:
    """Print the table, write the plot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DRIVE)
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--rounds", type=int, default=12, help="timings of each")
    parser.add_argument("--adapt", nargs="*", default=[], choices=["lidar", "stereo", "video"])
    parser.add_argument("--adapt-s", type=float, default=75.0)
    parser.add_argument("--plot", type=Path, default=PLOT)
    options = parser.parse_args()
    drive = open_drive(options.data, options=DriveOptions(truth=options.truth))
    every = (drive[index] for index in range(len(drive)))
    frames = [in_memory(frame) for frame in every if frame.has("truth") and frame.has("other")]
    everyone = list(contestants(frames[0]))
    spent = measure(everyone, frames, options.rounds)
    print("| prior | ms | density | AbsRel | SqRel m | RMSE m | RMSElog | MAE m | δ<1.25 |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    dots = []
    for contestant in everyone:
        result = evaluate(contestant.name, ((contestant.make, frame) for frame in frames))
        print(row(result, spent[contestant.name]), flush=True)
        error = result.metrics("image")["abs_rel"]
        dots.append(Dot(contestant.name, spent[contestant.name], error, contestant.family))
    for how in options.adapt:
        result = adapted(drive, frames, how, options.adapt_s)
        print(row(result, spent.get("mono")), flush=True)
        if "mono" in spent:
            dots.append(Dot(str(result.info["prior"]), spent["mono"], result.metrics("image")["abs_rel"], 4))
    write_scatter(options.plot, dots, "AbsRel", f"{drive.name}, {len(frames)} frames")
    print(f"\nwrote {options.plot}")


if __name__ == "__main__":
    main()
