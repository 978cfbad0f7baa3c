"""`priors bench`: run time against error of every way to make depth, on a drive of the user's."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cli.arguments import SequenceArguments, ThreadArguments, parse
from cli.console import DATA_ERROR, busy, err, out, progress
from cli.durations import duration, seconds
from eval import typeset
from eval.protocol import PRESETS, preset
from priors import cache
from priors.bench import entrants, sweep, table
from priors.bench.entrants import Entrant
from priors.bench.judge import judge
from priors.bench.race import BUSY, Race, load
from priors.bench.results import FOLDER
from priors.bench.schedule import Schedule
from priors.cache import Prior
from priors.draw import lines
from priors.errors import UsageError, expect, expect_between
from priors.held_back import held_back
from priors.selection import parse_range, select
from priors.types import Drive

EXAMPLES = """Measure every method, model, size and runtime on the same frames of a drive, in turn: time, memory, error.
Prints a table and marks what no other beats; writes cache/DRIVE/bench/, which `priors report` shows and
`priors build --budget` reads. What is measured already is not measured again.

examples:
  priors bench street/
  priors bench KITTI/2011_09_26 --drive 2011_09_26_drive_0001_sync --truth KITTI/depth
  priors bench street/ --runtimes auto --count 5 --at-most 2m         each network as this machine runs it best
  priors bench street/ --only stereo completion SGBM                  those whose names begin so
  priors bench ../data/kitti_stereo2015 --held-back --only stereo --network mine.safetensors
                                                    on frames that no network of ours was trained on
  priors bench street/ --network mine.onnx                            your own network beside ours
  priors bench street/ --sweep size --only stereo lidar               how time and memory grow with the image
  priors bench street/ --against cache/DRIVE/lidar-KEY                a prior in place of the truth
"""
MOST_FRAMES = 10_000
USUAL_COUNT = 12


@dataclass(frozen=True)
class PriorsBenchArguments(ThreadArguments, SequenceArguments):
    """Arguments of `priors bench`."""

    count: int | None = None
    """Frames, spread evenly over those with a truth; default: 12, and with --held-back all."""
    frames: str | None = None
    """Range of frames to take them from, a:b."""
    held_back: bool = False
    """Take only frames that no network of ours was trained on: docs/training.md names them."""
    protocol: Literal[*PRESETS] = "uncapped"  # type: ignore[valid-type]
    """Which pixels count and how; docs/metrics.md has the definitions."""
    against: Path | None = None
    """Score against this prior instead of the drive's truth."""
    times_only: bool = False
    """Measure times and memory alone: a drive needs no truth then."""
    only: tuple[str, ...] = ()
    """Enter those alone whose names begin so: stereo, 'stereo cfnet', SGBM."""
    runtimes: tuple[Literal["auto", "bf16", "fp32", "int8", "cuda", "onnx"], ...] | None = None
    """What runs the networks; default: each that this machine has."""
    network: tuple[Path, ...] = ()
    """Your own networks: .onnx or .safetensors files (docs/methods/mono.md)."""
    psmnet: tuple[Path, Path] | None = None
    """PSMNet as a peer: a file with its class PSMNet, and its weights."""
    at_most: str = "10m"
    """How long it may take: 90s, 10m, 1h. What is slow then makes fewer frames."""
    sweep: Literal["size", "disparity", "sweeps", "lines"] | None = None
    """Measure instead how time and memory grow: with the image's size, the disparities that stereo searches, the
    sweeps that LiDAR accumulates, or the scan lines of a sweep."""
    cache: Path = Path("cache")
    """Where results go: cache/DRIVE/bench."""

    def __post_init__(self) -> None:
        super().__post_init__()
        expect_between(1, self.count, MOST_FRAMES, "--count")
        parse_range(self.frame_range(self.frames))
        seconds(self.at_most, "--at-most")
        begins = (*entrants.kinds(), *(name for name, _ in entrants.BASELINES))
        for name in self.only:
            known = bool(name) and any(name.startswith(each) or each.startswith(name) for each in begins)
            expect(known, "--only", name or "''", f"how a name begins: {', '.join(begins)}")
        if self.times_only and self.against is not None:
            raise UsageError("--against: nothing is scored with --times-only: leave out one or the other")

    def indices(self, drive: Drive) -> list[int]:
        """Return the positions of the frames to choose from; DataError or UsageError where there are none."""
        chosen = select(drive.ids, self.frame_range(self.frames))
        if not self.held_back:
            return chosen
        left_out = set(held_back(drive))
        found = [index for index in chosen if index in left_out]
        if not found:
            raise UsageError(
                f"--frames {self.frames}: none of these frames is held back: leave out one or the other flag"
            )
        return found

    def most(self) -> int:
        """Return how many frames to take at most."""
        return self.count or (MOST_FRAMES if self.held_back else USUAL_COUNT)

    def lineup(self) -> list[Entrant]:
        """List who takes part; UsageError where --only leaves nobody."""
        every = [*entrants.baselines(), *entrants.field_size(self.runtimes)]
        chosen = [each for each in every if not self.only or each.name.startswith(self.only)]
        own = [entrants.network(file) for file in self.network]
        own += [entrants.psmnet(*self.psmnet)] if self.psmnet is not None else []
        if not chosen + own:
            names = ", ".join(each.name for each in every)
            raise UsageError(f"--only {' '.join(self.only)}: no entrant's name begins so; there are {names}")
        return chosen + own


ARGUMENTS = {"priors bench": PriorsBenchArguments}


def run(arguments: list[str]) -> int:
    """Make the bench; returns the exit code."""
    args = parse(PriorsBenchArguments, "priors bench", EXAMPLES, arguments)
    with args.limited():
        return _bench(args, shlex.join(["priors", "bench", *arguments]))


def _bench(args: PriorsBenchArguments, command: str) -> int:
    drive, lineup = args.open(["priors", "bench"]), args.lineup()
    if args.sweep is not None:
        return _sweep(args, drive, lineup)
    against = None if args.against is None else cache.only(args.against)
    lineup = [each for each in lineup if against is None or not _is_itself(each, against)]
    indices = args.indices(drive)
    chosen = judge(drive, indices, args.most(), preset(args.protocol), against, not args.times_only)
    if load() > BUSY:
        err.print("this machine is busy: compare ratios and processor time, not milliseconds")
    folder = args.cache / drive.name / FOLDER
    race = Race(chosen, lineup, folder, seconds(args.at_most), command)
    err.print(f"{len(lineup)} entrants, {len(chosen.frames)} frames: at most {duration(race.limit_s)}")
    with progress("looked at", len(lineup)) as looked:
        entered = race.enter(looked)
    err.print(_forecast(entered.plan))
    with progress("bench", max(1, sum(entered.plan.frames.values()))) as step:
        bench = race.run(entered, step)
    laid = table.lay_out(bench)
    out.print(typeset.render(laid, out.width)) if out.is_terminal else out.write(typeset.plain(laid))
    with busy("plot"):
        written = table.save(bench, folder, laid)
    for path in [folder / "bench.json", *written]:
        out.print(f"wrote {path}")
    return DATA_ERROR if not any(standing.trials for standing in bench.standings) else 0


def _sweep(args: PriorsBenchArguments, drive: Drive, lineup: list[Entrant]) -> int:
    """Measure how time and memory grow; print the slopes, draw them."""
    assert args.sweep is not None
    indices = args.indices(drive)
    frame = indices[len(indices) // 2]
    able = [each for each in lineup if each.lacks(drive[frame]) is None]
    with progress(f"sweep of {args.sweep}", len(sweep.points(args.sweep, able, drive[frame].camera.size))) as step:
        grown = sweep.sweep(args.sweep, able, drive, frame, step)
    laid = sweep.lay_out(sweep.NAMES[args.sweep], grown, f"{drive.name}, frame {drive.ids[frame]}")
    out.print(typeset.render(laid, out.width)) if out.is_terminal else out.write(typeset.plain(laid))
    path = args.cache / drive.name / FOLDER / f"sweep-{args.sweep}.svg"
    lines.write(path, sweep.plots(sweep.NAMES[args.sweep], grown), 2)
    out.print(f"wrote {path}")
    return 0


def _is_itself(entrant: Entrant, against: Prior) -> bool:
    """Tell whether an entrant makes the very maps that it would be scored against."""
    model = against.manifest.get("config", {}).get("model")
    return entrant.method.name == against.method and getattr(entrant.method, "model", None) == model


def _forecast(plan: Schedule) -> str:
    """Say what the bench will take."""
    if not plan.frames:
        return "all is measured already"
    maps = sum(plan.frames.values())
    fewer = f"; fewer frames of {', '.join(plan.shortened)}, which are slow" if plan.shortened else ""
    return f"{maps} maps by {len(plan.frames)} entrants: about {duration(plan.seconds)}{fewer}"
