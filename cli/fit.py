"""`nerf fit`: train a field and score it."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from cli.arguments import Device, DriveArguments, ThreadArguments, parse, pick_device
from cli.console import err, fit_progress, out, progress
from cli.report import LpipsArguments, print_table, report_run
from nerf import checkpoint, fields
from nerf.fit import FitConfig, fit
from nerf.losses import LossConfig
from nerf.model import ModelConfig, SamplerConfig
from nerf.run import RunConfig, claim
from priors import cache
from priors.errors import DataError
from priors.filters import Filters

EXAMPLES = """Train a field on a drive and score its held-out views (every 10th frame). Runs resume where they stopped.

examples:
  nerf fit street/ --prior cache/DRIVE/stereo-KEY --views sparse --time 60s
  nerf fit street/ --views sparse                                   colours alone
  nerf fit street/ --prior cache/DRIVE/lidar-KEY --loss kl --depth-weight 0.01
  nerf fit street/ --prior cache/DRIVE/stereo-KEY --field mip360 --steps 3000 --run runs/mip
"""
UNITS_S = {"s": 1.0, "m": 60.0, "h": 3600.0}

if TYPE_CHECKING:  # the choices are the files of a folder: known when it runs
    FieldName = str
else:
    FieldName = Literal[tuple(fields.names())]


@dataclass(frozen=True)
class FitArguments(ThreadArguments, DriveArguments):
    """Arguments of `nerf fit`."""

    prior: Path | None = None
    """A prior's folder in the cache, or a folder that holds just one; none: colours alone."""
    views: str = "dense"
    """Training views: dense (all that are not held out), sparse (every 4th of them) or a number."""
    frames: str | None = None
    """Range of frames, a:b."""
    time: str = "60s"
    """How long to train: 60s, 5m, 1h."""
    steps: int | None = None
    """Train so many steps instead: the same seed gives the same bits on a CPU."""
    rays: int = 1024
    """Rays in a step."""
    seed: int = 0
    """Decides weights, rays and sample positions."""
    width: int = 64
    """Neurons of the hidden layers."""
    device: Device = "auto"
    """Where to train and render; auto: a GPU where there is one."""
    run: Path | None = None
    """The run's folder; default: runs/<drive>-<field>-<views>-<loss>-<prior>."""
    losses: tyro.conf.OmitArgPrefixes[LossConfig] = field(default_factory=LossConfig)
    sampler: tyro.conf.OmitArgPrefixes[SamplerConfig] = field(default_factory=SamplerConfig)
    filters: tyro.conf.OmitArgPrefixes[Filters] = field(default_factory=Filters)
    lpips: tyro.conf.OmitArgPrefixes[LpipsArguments] = field(default_factory=LpipsArguments)
    field: FieldName = "ngp"
    """Family of fields."""


def run(arguments: list[str]) -> int:
    """Fit; returns the exit code."""
    args = parse(FitArguments, "nerf fit", EXAMPLES, arguments)
    with args.limited():
        return _fit(args)


def _fit(args: FitArguments) -> int:
    drive = args.open()
    prior = None if args.prior is None else cache.only(args.prior)
    config = FitConfig(
        model=ModelConfig(family=args.field, width=args.width, sampler=args.sampler),
        losses=args.losses,
        rays=args.rays,
        steps=args.steps,
        seconds=None if args.steps is not None else seconds(args.time),
        seed=args.seed,
    )
    where = None if prior is None else str(prior.folder.resolve())
    name = "-".join([drive.name, args.field, args.views, *([] if prior is None else [args.losses.loss, prior.name])])
    folder = args.run or Path("runs") / name
    made = claim(folder, RunConfig(drive.describe(), where, args.frames, args.views, args.filters, config))
    scene = made.scene(drive, progress)
    if len(scene.train) == 1:
        err.print("one training view: colours tell nothing about depth there; only a prior does")
    done = checkpoint.progress(folder)
    with fit_progress(folder.name) as on_step:
        fit(scene, config, folder, on_step, pick_device(args.device))
    if done.step == checkpoint.progress(folder).step:
        err.print(f"trained before, {done.step} steps: a longer --time or --steps goes on, another --run begins anew")
    if scene.test:
        print_table([report_run(made, args.lpips, scene, drive, device=args.device)])
    else:
        out.print(f"none of the {len(scene.ids)} frames is held out (the 10th, 20th, ... are): nothing to score")
    out.print(f"wrote {folder}")
    return 0


def seconds(text: str) -> float:
    """Turn 90s, 5m or 1h into seconds."""
    try:
        value = float(text.rstrip("smh")) * UNITS_S[text[-1:] if text[-1:] in UNITS_S else "s"]
    except ValueError as error:
        raise DataError(f"--time {text}: expected a number and s, m or h, for example 60s") from error
    if not value > 0:
        raise DataError(f"--time {text}: expected more than 0")
    return value
