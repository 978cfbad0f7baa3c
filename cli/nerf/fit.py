"""`nerf fit`: train a field and score it."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from cli.arguments import Device, SequenceArguments, ThreadArguments, parse
from cli.console import busy, err, fit_progress, out, progress
from cli.durations import seconds
from cli.engine import EngineArguments
from cli.nerf.eval import LpipsArguments, print_tables
from cli.nerf.sources import open_sources
from cli.nerf.together import together
from nerf import checkpoint, fields
from nerf.asked import RunConfig
from nerf.checkpoint import Spent
from nerf.choice import AUTO, by_settings
from nerf.config import Align, FitConfig, ModelConfig
from nerf.gaussians.config import GaussianConfig
from nerf.guide import Guide
from nerf.losses import LossConfig
from nerf.prepare import SceneConfig, disk_told
from nerf.quality import BEST, SECONDS, Quality
from nerf.rate import Rate
from nerf.run import RUNS, SCENES, Run, begin, choose, open_run
from nerf.sample import SamplerConfig
from nerf.scene import Scene
from nerf.split import SPARSE_STEP
from nerf.world import here, leader_first
from priors import origin
from priors.errors import UsageError
from priors.filters import Filters
from priors.machine.device import pick_device
from priors.selection import select
from priors.types import Drive

EXAMPLES = """Train a field on a drive and score its held-out views (every 10th frame). Runs resume where they stopped.

examples:
  nerf fit --prior cache/                                           the drive and the prior that the cache has
  nerf fit street/ --prior cache/DRIVE/stereo-KEY --views sparse --quality high
  nerf fit street/ --views sparse                                   colours alone
  nerf fit street/ --prior cache/DRIVE/lidar-KEY --loss kl --depth-weight 0.01
  nerf fit street/ --prior cache/DRIVE/stereo-KEY --field nerfpp --steps 3000 --run runs/npp
  nerf fit kitti/ --drive 2011_09_26_drive_0009_sync --blocks 60                     a field every 60 m
  nerf fit kitti/ --drive 2011_09_26_drive_0009_sync --blocks 60 --engine ray        blocks on a Ray cluster
  torchrun --nproc-per-node 4 -m cli.nerf -- fit street/ --prior cache/ --rays 256   four processes, one field
"""

if TYPE_CHECKING:  # the choices are the files of a folder: known when it runs
    FieldName = str
else:
    FieldName = Literal[tuple(fields.names())]


@dataclass(frozen=True)
class FitArguments(ThreadArguments, SequenceArguments):
    """Arguments of `nerf fit`."""

    prior: Path | None = None
    """A prior's folder in the cache, or a folder that holds several: the one that suits best is taken, and said.
    auto: cache/. truth: the drive's own true depth, but of held-out frames. Default: colours alone."""
    views: str = "dense"
    """Training views: dense (all that are not held out), sparse (2.5 Hz: every 4th of them where the drive has 10),
    a share (1/8: every 8th) or a number."""
    frames: str | None = None
    """Range of frames, a:b."""
    quality: Quality = "default"
    """How long to train: fast 10 s, default 60 s, high 5 min."""
    time: str | None = None
    """Train so long instead: 60s, 5m, 1h."""
    steps: int | None = None
    """Train so many steps instead: the same seed gives the same bits on a CPU."""
    rays: int = 1024
    """Rays in a step when the fit begins."""
    rays_growth: float | None = None
    """How many times as many rays a step has when the fit ends; 1: always as many. Default: ngp and nerfpp with a
    prior 4, else 1."""
    seed: int = 0
    """Decides weights, rays and sample positions."""
    align: Align = "auto"
    """auto: check the prior against the posed images, bring it to their scale, and leave out what they contradict;
    learn: the same, and a scale and a shift a frame are learned with the field; none: take it as it is."""
    width: int = 64
    """Neurons of the hidden layers."""
    blocks: float | None = None
    """Cut a long drive into blocks of about so many metres of its path: a field each, with the whole budget each, which
    views blend."""
    engine: tyro.conf.OmitArgPrefixes[EngineArguments] = field(default_factory=EngineArguments)
    device: Device = "auto"
    """Where to train and render; auto: a GPU where there is one."""
    run: Path | None = None
    """The run's folder; default: runs/<drive or sequence>-<field>-<views>-<loss>-<prior>."""
    losses: tyro.conf.OmitArgPrefixes[LossConfig] = field(default_factory=LossConfig)
    sampler: tyro.conf.OmitArgPrefixes[SamplerConfig] = field(default_factory=SamplerConfig)
    gaussians: tyro.conf.OmitArgPrefixes[GaussianConfig] = field(default_factory=GaussianConfig)
    filters: tyro.conf.OmitArgPrefixes[Filters] = field(default_factory=Filters)
    lpips: tyro.conf.OmitArgPrefixes[LpipsArguments] = field(default_factory=LpipsArguments)
    field: FieldName | Literal["auto"] = AUTO
    """Family of fields; auto: Gaussians (splat) where a prior is dense and right, else mip360."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.config(), self.scene()
        if self.engine.engine == "ray" and self.blocks is None:
            raise UsageError("--engine ray: gives out the blocks of a drive: add --blocks 60, or leave this out")

    def scene(self) -> SceneConfig:
        """Return which frames are used, and what of the prior."""
        return SceneConfig(self.views, self.frame_range(self.frames), self.filters)

    def config(self, family: str | None = None) -> FitConfig:
        """Return what decides the fit's outcome; `family`: what stands for auto."""
        asked = SECONDS[self.quality] if self.time is None else seconds(self.time)
        timed = None if self.steps is not None else asked
        named = BEST if self.field == AUTO else self.field
        model = ModelConfig(family or named, width=self.width, sampler=self.sampler, gaussians=self.gaussians)
        made = FitConfig(model, self.losses, rays=self.rays, steps=self.steps, seconds=timed, seed=self.seed)
        return replace(made, align=self.align, blocks_m=self.blocks, rays_growth=self.rays_growth)


ARGUMENTS = {"nerf fit": FitArguments}


def run(arguments: list[str]) -> int:
    """Fit; returns the exit code."""
    args = parse(FitArguments, "nerf fit", EXAMPLES, arguments)
    with args.limited(), together():
        return _fit(args, ["nerf", "fit", *arguments])


def _fit(args: FitArguments, typed: list[str]) -> int:
    if args.prior is None and args.field != AUTO and not fields.is_trained(args.field):
        raise UsageError(f"--field {args.field}: shows the training frames by a prior's depth: add --prior cache/")
    if args.engine.engine == "ray" and here().size > 1:
        raise UsageError("--engine ray: starts its own processes: leave torchrun out, or this")
    config = args.config()
    if args.field != AUTO:
        _refuse_unread(config)
    with busy("looking at the drive and its priors"):
        drive, prior = open_sources(args, args.prior, typed)
    scene, folder = args.scene(), args.run
    if args.field == AUTO:
        with leader_first():
            config = args.config(_family(args, drive, prior))
        _refuse_unread(config, " is what --field auto took here: it")
    if folder is None and args.sequence is not None:  # sequences of one drive are told apart
        folder = RUNS / f"{args.sequence}-{RunConfig.of(drive, prior, scene, config).title}"
    with leader_first():  # it makes the folder and the scene's arrays, which the others find
        this_run = begin(drive, prior, scene, config, folder, progress)
        if (line := this_run.disk_told) is not None:
            err.print(line)
        _ = this_run.scene
    with this_run.held():
        return _fit_and_score(args, this_run)


def _refuse_unread(config: FitConfig, how: str = "") -> None:
    """Refuse flags that the family does not read; `how`: more words about the family."""
    for setting, value in fields.unread(config).items():
        flag = f"{setting} {value}".strip()
        raise UsageError(f"{flag}: --field {config.model.family}{how} does not read it: leave it out")


def _family(args: FitArguments, drive: Drive, prior: Guide | None) -> str:
    """Choose the family, and say why; a run that has begun keeps its own."""
    if args.run is not None and checkpoint.has_begun(args.run):
        return open_run(args.run).config.fit.model.family
    runs = RUNS if args.run is None else args.run.parent
    scene, config = args.scene(), args.config()
    chosen = by_settings(config, pick_device(args.device))
    if chosen is None:
        if (line := disk_told(drive, prior, scene, runs / SCENES)) is not None:
            err.print(line)
        chosen = choose(drive, prior, scene, config, runs, progress)
    err.print(f"--field auto: {chosen.family}: {chosen.why}")
    return chosen.family


def _fit_and_score(args: FitArguments, this_run: Run) -> int:
    err.print(f"run: {this_run.folder}")
    scene, before = this_run.scene, checkpoint.spent(this_run.folder)
    _tell(scene, this_run, before)
    finding = this_run.checked.finding
    prior = this_run.config.prior
    for line in [] if finding is None else finding.told(None if prior is None else Path(prior).name):
        err.print(line)
    with args.engine.elsewhere() as elsewhere, fit_progress("training") as on_step:
        this_run.fit(args.device, on_step, elsewhere)
    if fields.is_trained(this_run.config.fit.model.family) and before.step == checkpoint.spent(this_run.folder).step:
        err.print(f"trained before, {before.step} steps: a longer --time or --steps goes on, another --run begins anew")
    if not here().leads:
        return 0
    if scene.test:
        print_tables([this_run], [this_run.report(args.device, args.lpips.open())])
    else:
        out.print(f"none of the {len(scene.ids)} frames is held out (the 10th, 20th, ... are): nothing to score")
    out.print(f"wrote {this_run.folder}")
    return 0


def _tell(scene: Scene, run: Run, before: Spent) -> None:
    """Say what is about to be trained: on what, by what, for how long."""
    drive, config = run.drive, run.config
    height, width = scene.camera.size
    views = f"{len(scene.train)} of {len(scene.ids)} frames train, {len(scene.test)} are held out"
    err.print(f"views: {scene.name}, {width}x{height}: {views}{_pace(drive, config)}")
    if scene.origin_m != origin.NONE:
        err.print(f"origin: {origin.told(scene.origin_m)} m is taken off, and put back on what is written")
    err.print(f"field: {config.fit.model.family}, {_guide(config)}; {_budget(config.fit, before)}")
    if len(scene.train) == 1:
        err.print("one training view: colours tell nothing about depth there; only a prior does")


def _pace(drive: Drive, config: RunConfig) -> str:
    """Say what sparse views are here; nothing of others."""
    if config.views != "sparse":
        return ""
    rate = Rate.of(drive, select(drive.ids, config.frames))
    return f" (sparse: step {config.sparse_step or SPARSE_STEP} at {rate})"


def _guide(config: RunConfig) -> str:
    """Say what tells the field of depth."""
    if config.prior is None:
        return "colours alone"
    if not fields.is_trained(config.fit.model.family):
        return f"drawn by the depth of {Path(config.prior).name}"
    loss = config.fit.losses.loss
    return f"guided by {Path(config.prior).name}, {'no depth loss' if loss == 'none' else f'loss {loss}'}"


def _budget(fit: FitConfig, before: Spent) -> str:
    """Say how long it trains, and from where."""
    if not fields.is_trained(fit.model.family):
        return "it is not trained"
    budget = f"{fit.steps} steps" if fit.steps is not None else f"{fit.seconds:g} s"
    left = before.step and fit.progress(before.step, before.elapsed_s) < 1
    return budget + (f", goes on from step {before.step}, {before.elapsed_s:.0f} s" if left else "")
