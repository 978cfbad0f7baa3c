"""Run: a folder with what was asked for, and everything that came of it; fitted and scored from Python in a line.

runs/<name>/config.json              drive, prior, frames, views and every setting
           /cameras.json             nerf.cameras
           /checkpoint.safetensors   nerf.checkpoint
           /metrics.jsonl            a line every LOG_EVERY steps: step, seconds, losses, PSNR of the batch
           /metrics.json, renders/   nerf.report
"""

import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

from eval.lpips import Lpips
from nerf import blocks, cameras, checkpoint, fields, journal
from nerf.asked import CONFIG, RunConfig, comparable, read, write
from nerf.config import FitConfig
from nerf.evidence.check import Checked, check
from nerf.evidence.lidar import sweeps_of
from nerf.fit import OnStep, fit
from nerf.guide import Guide, open_guide
from nerf.model import Model, ShowsScene
from nerf.naming import labels
from nerf.pictures import save_view
from nerf.placed import PlacedModel
from nerf.prepare import ProgressBar, SceneConfig, disk_told, is_prepared, open_scene, silent
from nerf.report import Report, Scoring, Subject, report
from nerf.scene import Scene
from nerf.truths import Truths
from nerf.viewpoints import Viewpoints, along
from priors import origin
from priors.drive_around import Stretch
from priors.drives import poses_remark, reopen
from priors.errors import DataError, expect
from priors.machine import threads
from priors.machine.device import pick_device
from priors.owner.claim import Claim, hold, owner_of
from priors.records import earlier
from priors.selection import select
from priors.types import Drive

RUNS = Path("runs")
"""Where runs are kept unless a folder is named."""
KEY = re.compile("-[0-9a-f]{10}$")
"""What tells a prior from others of its method, at the end of its folder's name."""
OWNER = ".owner"
"""File in a run's folder that says which process fits it (priors/owner)."""
SCENES = ".scenes"
"""Folder beside the runs that holds their prepared arrays, shared by all of them."""


@dataclass(frozen=True)
class Run:
    """A run: `begin` or `open_run` makes one; `fit` trains it, `report` scores it, `render` shows it."""

    folder: Path
    config: RunConfig
    progress: ProgressBar = field(default=silent, compare=False, repr=False)
    """Shows what is prepared and rendered."""
    source: Drive | None = field(default=None, compare=False, repr=False)
    """The drive where it is open already; None: opened as the config describes it."""

    @property
    def name(self) -> str:
        """The folder's name."""
        return labels([self.folder])[0]

    @cached_property
    def drive(self) -> Drive:
        """The run's drive."""
        return self.source or reopen(self.config.drive)

    @property
    def scene(self) -> Scene:
        """The run's scene, its prior as the check leaves it; what was prepared already is used again."""
        return self.checked.scene

    @property
    def disk_told(self) -> str | None:
        """The line that says what disk the scene is going to take; None where that is little."""
        prior = None if self.config.prior is None else open_guide(self.config.prior)
        return disk_told(self.drive, prior, self.config.scene, self.folder.parent / SCENES)

    @cached_property
    def checked(self) -> Checked:
        """The run's scene, and what was found of its prior."""
        prior = None if self.config.prior is None else open_guide(self.config.prior)
        with threads.limited(None):
            home = self.folder.parent / SCENES
            before = checkpoint.origin_of(self.folder)
            scene = open_scene(self.drive, prior, self.config.scene, home, self.progress, before)
        if self.config.fit.align == "none":
            return Checked(scene, None)
        needed = not fields.is_trained(self.config.fit.model.family)
        return check(scene, needed, sweeps_of(self.drive, scene.ids))

    def fit(
        self, device: str = "auto", on_step: OnStep = lambda status: None, elsewhere: "FitElsewhere | None" = None
    ) -> Model:
        """Train until the budget is spent, or go on where the run was left; see nerf.fit.fit.

        Args:
            device: cpu, cuda, or auto: a GPU where there is one.
            on_step: called after each step.
            elsewhere: fits the run's blocks by other processes (nerf/blocks_on_ray.py); None: here.

        Raises:
            DataError: another process fits this run, or see nerf.fit.fit.
        """
        with self.held() as claim:
            found = self.checked.finding
            config = replace(self.config, finding=None if found is None else asdict(found))
            write(self.folder, config)  # of two that began at once, the one that trains has described the run
            cameras.keep(self.folder, self.scene)
            if elsewhere is None:
                model = fit(self.scene, self.config.fit, self.folder, on_step, pick_device(device), lambda: claim.lost)
            else:
                elsewhere(self, device, on_step)
                model = checkpoint.open_model(self.folder, pick_device(device))
        return PlacedModel(model, self.scene.origin_m)

    @contextmanager
    def held(self) -> Iterator[Claim]:
        """Keep other processes from fitting this run while the block runs; a block within a block changes nothing.

        Raises:
            DataError: another process has it in hand.
        """
        if "_claim" in vars(self):
            yield vars(self)["_claim"]
            return
        with hold(self.folder / OWNER, str(self.folder), by_launch=True) as claim:
            vars(self)["_claim"] = claim
            try:
                yield claim
            finally:
                del vars(self)["_claim"]

    def report(self, device: str = "auto", lpips: Lpips | None = None, info: dict[str, Any] | None = None) -> Report:
        """Score the held-out views of the trained field, and write the report's files.

        Args:
            device: where to render.
            lpips: None leaves that figure out.
            info: what the report says was run; default: what a study wrote of this run, else its name and config.
        """
        model = self._model(device)
        held_out = [self.scene.ids[position] for position in self.scene.test]
        truths, told = Truths(self.drive, held_out), poses_remark(self.drive, held_out)
        subject = Subject(model.render, checkpoint.digest(self.folder), info or self._info(), told)
        label = f"held-out views of {names_of([self])[0]}"
        with threads.limited(None), self.progress(label, len(self.scene.test)) as step:
            return report(self.scene, truths, subject, self.folder, Scoring(lpips), step)

    def open_model(self, device: str = "auto") -> Model:
        """Load the trained field; it renders poses of the drive's own frame."""
        return PlacedModel(self._model(device), checkpoint.origin_of(self.folder) or origin.NONE)

    def viewpoints(self, frames: str | None = None) -> Viewpoints:
        """Return where the drive's camera was, in a range of frames a:b; None: the run's.

        Where the drive cannot be opened, the cameras that the run kept serve: those of its own frames.
        """
        try:
            drive = self.drive
        except (DataError, OSError):
            views = self.kept_cameras()
            if views is None:
                raise
            return views.only(frames)
        return along(drive, frames or self.config.frames)

    def kept_cameras(self) -> Viewpoints | None:
        """Return where the run's frames were seen from, as it kept it when it was fitted; None where it did not."""
        name = Path(str(self.config.drive.get("path", ""))).name
        return cameras.kept(self.folder, self.folder.parent / SCENES, name)

    def render(self, views: Viewpoints, folder: Path, device: str = "auto") -> None:
        """Render views and write their pictures and depth maps: nerf.pictures.save_view."""
        model = self.open_model(device)
        with self.progress("render", len(views.ids)) as step:
            for id_, pose in zip(views.ids, views.T_world_cam, strict=True):
                save_view(folder, id_, model.render(pose, views.camera))
                step()

    def _model(self, device: str) -> Model:
        """Load the trained field in the scene's frame; one that shows the run's own frames is given them."""
        model = checkpoint.open_model(self.folder, pick_device(device))
        if isinstance(model, ShowsScene):
            model.show(self.scene)
        return model

    def _info(self) -> dict[str, Any]:
        """Return what a study wrote of the run, so that it still finds it done; else the run's name and config."""
        path = self.folder / "metrics.json"
        before = Report.load(path).info if path.exists() else {}
        return before if "command" in before else {"name": self.name, "config": asdict(self.config)}


FitElsewhere: TypeAlias = Callable[[Run, str, OnStep], None]
"""Fits the blocks of a run, on a device, and tells of steps; returns when all are done."""


def begin(
    drive: Drive,
    prior: Guide | None = None,
    scene: SceneConfig | None = None,
    fit: FitConfig | None = None,
    folder: Path | None = None,
    progress: ProgressBar = silent,
) -> Run:
    """Begin a run, or go on with the same one.

        run = begin(open_drive("street"), cache.only("cache"), SceneConfig(views="sparse"))
        run.fit()
        print(run.report().metrics())

    Args:
        drive: its frames are learned.
        prior: its depth guides the fit: a cache's, or TRUTH (nerf.guide), the drive's own; None: colours alone.
        scene: which frames, and what the prior passes.
        fit: everything that decides the outcome.
        folder: the run's folder; default: `runs/<drive>-<field>-<views>-<loss>-<prior>`.
        progress: shows what is prepared and rendered.

    Raises:
        DataError: the folder holds a run with other settings.
    """
    scene = scene or SceneConfig()
    if isinstance(drive, Stretch):  # a run's record reopens the whole drive
        expect(scene.frames is None, "frames", scene.frames, "none beside a stretch of a drive")
        scene = replace(scene, frames=drive.frames)
        drive = drive.drive
    config = RunConfig.of(drive, prior, scene, fit or FitConfig())
    if config.fit.align == "learn":
        expect(prior is not None, "--align", "learn", "auto where there is no prior to align")
        family = config.fit.model.family
        expect(fields.aligns(family), "--align", "learn", f"auto or none: --field {family} learns nothing of a prior")
    config.parts(len(select(drive.ids, config.frames)))  # what cannot be is told before a folder is made
    if folder is None:
        folder = RUNS / f"{drive.name}-{config.title}"
    return replace(claim(folder, config), progress=progress, source=drive)


def claim(folder: Path, config: RunConfig, *, same_budget: bool = False) -> Run:
    """Begin a run in a folder, or go on with the same one.

    A run that had another budget goes on as well, at the new budget's learning rate; with `same_budget` it is begun
    anew, so that figures are those of the budget that is asked for.

    Raises:
        DataError: another run was trained in it, or another process trains this one.
    """
    path = folder / CONFIG
    _refuse_taken(folder)
    before = open_run(folder).config if checkpoint.has_begun(folder) else config
    config = earlier(config, before)  # what an earlier version began goes on as it was
    if before.sparse_step is None:
        config = replace(config, sparse_step=None)  # it had every 4th frame
    if comparable(before) != comparable(config):
        raise DataError(f"{path}: this folder holds a run with other settings: choose another --run, or delete it")
    if same_budget and (before.fit.steps, before.fit.seconds) != (config.fit.steps, config.fit.seconds):
        forget(folder)
    write(folder, config)
    return Run(folder, config)


def forget(folder: Path) -> None:
    """Delete what a run has learned: it begins anew."""
    for name in (checkpoint.NAME, journal.NAME, "metrics.json"):
        (folder / name).unlink(missing_ok=True)
    (folder / blocks.NAME).unlink(missing_ok=True)
    shutil.rmtree(folder / blocks.FOLDER, ignore_errors=True)


def names_of(runs: Sequence[Run]) -> list[str]:
    """Name runs in a table or picture, each differently, by no more than that takes.

    A folder of the usual name is called by what the run is, without its drive and its prior's key.
    """
    whole = labels([run.folder for run in runs])
    short = [KEY.sub("", run.config.title) if run.folder.name.endswith(f"-{run.config.title}") else "" for run in runs]
    found = [own if own and short.count(own) == 1 else other for own, other in zip(short, whole, strict=True)]
    return found if len(set(found)) == len(found) else whole


def _refuse_taken(folder: Path) -> None:
    """Refuse a folder before anything in it is written: another process may train in it."""
    owner = owner_of(folder / OWNER)
    if owner is not None and not (owner.process and (owner.process.is_me or owner.process.is_partner)):
        raise DataError(f"{folder}: {owner}, fits this run: wait for it, stop it, or choose another --run")


def open_run(folder: Path) -> Run:
    """Open a run's folder.

    Raises:
        DataError: there is no config.json in it, or it is damaged or of another format.
    """
    return Run(folder, read(folder))


def moved(run: Run, data: Path) -> Run:
    """Return a run whose drive has moved to the folder `data`; its config.json is brought up to date.

    Raises:
        DataError: that folder holds another drive: the run's images have other calibration or poses.
    """
    drive = reopen(run.config.drive, data)
    if not is_prepared(drive, run.config.scene, run.folder.parent / SCENES):
        raise DataError(f"--data {data}: is not the drive of {run.folder}: its calibration, poses or images differ")
    config = replace(run.config, drive=drive.describe())
    with suppress(OSError):  # a run that cannot be written is told of the new place each time
        write(run.folder, config)
    return replace(run, config=config, source=drive)


def find_all(paths: Sequence[Path]) -> list[Path]:
    """Return the folders of the runs at some paths, each once; DataError where one holds none."""
    folders = [folder for path in paths for folder in find(path)]
    return list({folder.resolve(): folder for folder in folders}.values())


def find(path: Path) -> list[Path]:
    """Return the folder of the run at path, or of all runs that it holds, sorted; DataError where there is none."""
    if not path.exists():
        raise DataError(f"{path}: no such folder: not a run's folder (`nerf fit DATA --run {path}` makes one)")
    if (path / CONFIG).exists() or not path.is_dir():  # what is no folder is told when it is opened
        return [path]
    folders = sorted(inner.parent for inner in path.glob(f"*/{CONFIG}"))
    if not folders:
        raise DataError(f"{path}: not a run's folder, and no runs in it: `nerf fit` makes one")
    return folders
