"""`nerf bench`: quality against time."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from dataclasses import field as made_by
from pathlib import Path
from typing import Literal

import tyro

from cli.arguments import Device, SequenceArguments, ThreadArguments, parse
from cli.console import DATA_ERROR, err, fit_progress, out, progress
from cli.durations import seconds
from cli.nerf.eval import LpipsArguments
from cli.nerf.fit import FieldName
from cli.nerf.sources import named_priors
from eval import typeset
from eval.files import write_bytes
from nerf.bench import ablation, growth, results
from nerf.bench.ablation import ablated
from nerf.bench.curve import Curve, Entrant
from nerf.bench.marks import Mark, ascending
from nerf.bench.race import Race
from nerf.config import MOST_STEPS, FitConfig
from nerf.fields import is_trained
from nerf.guide import TRUTH
from nerf.split import HELD_OUT, check_views
from nerf.study import NONE, FitRunner, RunSpec, Study
from priors.bench import sweep
from priors.draw import lines
from priors.errors import LARGEST_SEED, UsageError, expect_between
from priors.selection import parse_range

EXAMPLES = """Fit fields side by side and score each as it trains: PSNR, SSIM, LPIPS and AbsRel against wall time.
Compiling and scoring stop the clock. Fits take turns from mark to mark. What is done is not made again.

examples:
  nerf bench street/ --priors none cache/ --views sparse
  nerf bench street/ --priors cache/DRIVE/stereo-KEY --field ngp mip360 --at 10s 30s 60s 300s --seed 0 1 2
  nerf bench street/ --priors cache/ --field mip360 --budgets            a fit of its own for each time
  nerf bench street/ --priors cache/ --field ngp --ablate --steps 100 200 400     what each switch that skips work buys
  nerf bench street/ --priors cache/ --field mip360 --sweep rays         how a step's cost grows with its rays
  nerf bench street/ --priors cache/ --ceiling                           what the held-out views could score at best
"""


@dataclass(frozen=True)
class BenchArguments(ThreadArguments, SequenceArguments):
    """Arguments of `nerf bench`."""

    priors: tuple[Path, ...] = (Path(NONE),)
    """Priors' folders, folders that hold several, truth: the drive's own maps, and none: colours alone."""
    loss: tuple[Literal["mse", "l1", "kl", "urf"], ...] = ("l1",)
    """Depth losses."""
    views: tuple[str, ...] = ("sparse",)
    """Training views: dense, sparse, shares (1/8: every 8th) or numbers."""
    field: tuple[FieldName, ...] = ("ngp", "mip360", "nerfpp", "warp")
    """Families of fields; the warp, which is not trained, takes part where there is a prior."""
    seed: tuple[int, ...] = (0,)
    """Every fit is made once a seed; the table has the means and their spread."""
    at: tuple[str, ...] = ("10s", "30s", "60s")
    """Times of training after which a fit is scored: 10s, 5m. Its learning rate falls until the last."""
    steps: tuple[int, ...] = ()
    """Numbers of steps after which it is scored instead."""
    budgets: bool = False
    """Make a fit of its own for each of them, whose learning rate falls until just then."""
    ceiling: bool = False
    """Also fit the held-out views themselves, with the first seed: what a field could show of them at best."""
    ablate: bool = False
    """Also make each fit without each switch that skips work, one by one: what the switch saves, and what it changes,
    at equal steps and at equal time."""
    sweep: Literal["rays", "samples", "table", "frames"] | None = None
    """Measure instead how a step's processor time and memory grow: with its rays, a ray's samples, the rows of the
    hash grid's tables, or the training views."""
    rays: int = 1024
    """Rays in a step."""
    frames: str | None = None
    """Range of frames, a:b."""
    device: Device = "auto"
    """Where to train and render; auto: a GPU where there is one."""
    out: Path = Path("bench")
    """The bench's folder."""
    lpips: tyro.conf.OmitArgPrefixes[LpipsArguments] = made_by(default_factory=LpipsArguments)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.marks(), self.fit()
        if self.ablate and self.budgets:
            raise UsageError("--ablate: a curve is compared at equal time too: leave out --budgets")
        if self.sweep is not None and (self.ablate or self.ceiling or self.budgets):
            raise UsageError(f"--sweep {self.sweep}: scores no views: leave out --ablate, --ceiling, --budgets")
        parse_range(self.frame_range(self.frames))
        for views in self.views:
            check_views(views)
        for seed in self.seed:
            expect_between(0, seed, LARGEST_SEED, "--seed")

    def fit(self) -> FitConfig:
        """Return what all fits have in common."""
        return FitConfig(rays=self.rays)

    def marks(self) -> tuple[Mark, ...]:
        """Return where each fit is scored."""
        for steps in self.steps:
            expect_between(1, steps, MOST_STEPS, "--steps")
        return ascending(
            [Mark(each, "steps") for each in self.steps] or [Mark(seconds(each, "--at")) for each in self.at]
        )

    def entrants(self) -> list[Entrant]:
        """List the fits that were asked for."""
        priors = named_priors(self.priors)
        grid = Study(priors, self.loss, self.views, self.field, seeds=self.seed)
        specs = grid.runs()
        if self.ceiling:
            trained = tuple(name for name in self.field if is_trained(name))
            known = tuple(name for name in priors if name != TRUTH.name) or (NONE,)  # its held-out maps are not used
            specs += Study(known, self.loss, (HELD_OUT,), trained, seeds=self.seed[:1]).runs()
        marks = self.marks()
        each = [(mark,) for mark in marks] if self.budgets else [marks]
        if self.ablate:
            return list(dict.fromkeys(one for spec in specs for own in each for one in ablated(spec, self.fit(), own)))
        return list(dict.fromkeys(Entrant.of(spec, self.fit(), own) for spec in specs for own in each))


ARGUMENTS = {"nerf bench": BenchArguments}


def run(arguments: list[str]) -> int:
    """Make the bench; returns the exit code: 1 where a fit failed."""
    args = parse(BenchArguments, "nerf bench", EXAMPLES, arguments)
    with args.limited():
        return _bench(args, shlex.join(["nerf", "bench", *arguments]))


def _bench(args: BenchArguments, command: str) -> int:
    drive, entrants = args.open(["nerf", "bench"]), args.entrants()
    runner = FitRunner(
        drive, args.fit(), args.frame_range(args.frames), args.device, args.lpips.open(), progress, fit_progress
    )
    if args.sweep is not None:
        return _sweep(args.sweep, runner, [each.spec for each in entrants], args.out)
    race = Race(runner, args.out, entrants)
    err.print(str(race.warm_up()))
    curves = race.run(_tell)
    laid = results.lay_out(curves, drive.name)
    out.print(typeset.render(laid, out.width)) if out.is_terminal else out.write(typeset.plain(laid))
    written = results.save(curves, args.out, laid, command)
    if args.ablate:
        switches = ablation.lay_out(curves, drive.name)
        out.print(typeset.render(switches, out.width)) if out.is_terminal else out.write(typeset.plain(switches))
        written.append(args.out / "ablation.md")
        write_bytes(written[-1], f"{typeset.markdown(switches)}\n```bash\n{command}\n```\n".encode())
    for path in written:
        out.print(f"wrote {path}")
    return DATA_ERROR if any(curve.error for curve in curves) else 0


def _sweep(axis: growth.Axis, runner: FitRunner, specs: Sequence[RunSpec], folder: Path) -> int:
    """Measure how a step grows; print the slopes, draw them."""
    kinds = [spec for spec in dict.fromkeys(replace(spec, seed=0) for spec in specs) if is_trained(spec.field)]
    if not kinds:
        raise UsageError(f"--sweep {axis}: no field here is trained: name one by --field")
    with progress(f"sweep of {axis}", sum(len(growth.points(axis, spec, runner.fit)) for spec in kinds)) as step:
        grown = growth.sweep(axis, runner, kinds, step)
    laid = sweep.lay_out(growth.NAMES[axis], grown, runner.drive.name)
    out.print(typeset.render(laid, out.width)) if out.is_terminal else out.write(typeset.plain(laid))
    path = folder / f"sweep-{axis}.svg"
    lines.write(path, sweep.plots(growth.NAMES[axis], grown), 2)
    out.print(f"wrote {path}")
    return 0


def _tell(curve: Curve) -> None:
    """Say what a fit scored at a mark."""
    if curve.error:
        err.complain(curve.error, curve.entrant.name)
        return
    point = curve.points[-1]
    figures = point.metrics
    err.print(
        f"{curve.entrant.name}: {figures['psnr']:.2f} dB, AbsRel {figures['abs_rel']:.4f} after {point.seconds:.1f} s"
    )
