"""A run: a folder with what was asked for, and everything that came of it.

runs/<name>/config.json              drive, prior, frames, views and every setting
           /checkpoint.safetensors   nerf.checkpoint
           /metrics.jsonl            a line every LOG_EVERY steps: step, seconds, losses, PSNR of the batch
           /metrics.json, renders/   nerf.report
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from nerf import checkpoint
from nerf.fit import FitConfig
from nerf.scene import Progress, Scene, open_scene, silent
from priors import cache, codecs
from priors.drives import reopen
from priors.errors import DataError
from priors.filters import Filters
from priors.records import restore
from priors.selection import select
from priors.types import Drive

FORMAT = 1
SCENES = ".scenes"
"""Folder beside the runs that holds their prepared arrays, shared by all of them."""


@dataclass(frozen=True)
class RunConfig:
    """What a run was asked for."""

    drive: dict[str, Any]
    """What reopens the drive."""
    prior: str | None
    """The prior's folder; None: colours alone."""
    frames: str | None
    """Range of frames, a:b."""
    views: str
    """dense, sparse or a number."""
    filters: Filters
    """What the prior passes before it is used."""
    fit: FitConfig
    """Everything else."""


@dataclass(frozen=True)
class Run:
    """A run's folder and config."""

    folder: Path
    config: RunConfig

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.name

    def drive(self) -> Drive:
        """Open the run's drive."""
        return reopen(self.config.drive)

    def scene(self, drive: Drive, progress: Progress = silent) -> Scene:
        """Open the run's scene; what was prepared already is used again."""
        config = self.config
        prior = None if config.prior is None else cache.only(Path(config.prior))
        positions = select(drive.ids, config.frames)
        home = self.folder.parent / SCENES
        return open_scene(drive, prior, config.views, positions, home, config.filters, progress)


def claim(folder: Path, config: RunConfig, same_budget: bool = False) -> Run:
    """Begin a run in a folder, or go on with the same one; DataError where another run was trained in it.

    A run that had another budget goes on as well, at the new budget's learning rate; with `same_budget` it is begun
    anew, so that figures are those of the budget that is asked for.
    """
    path = folder / "config.json"
    found = open_run(folder).config if (folder / checkpoint.NAME).exists() else config
    if _comparable(found) != _comparable(config):
        raise DataError(f"{path}: this folder holds a run with other settings: choose another --run, or delete it")
    if same_budget and (found.fit.steps, found.fit.seconds) != (config.fit.steps, config.fit.seconds):
        for name in (checkpoint.NAME, "metrics.jsonl", "metrics.json"):
            (folder / name).unlink(missing_ok=True)
    text = json.dumps({"format": FORMAT, **asdict(config)}, indent=2) + "\n"
    codecs.write_bytes(path, text.encode())
    return Run(folder, config)


def open_run(folder: Path) -> Run:
    """Open a run's folder.

    Raises:
        DataError: there is no config.json in it, or it is damaged or of another format.
    """
    path = folder / "config.json"
    try:
        record = json.loads(path.read_text())
        if record.pop("format") != FORMAT:
            raise DataError(f"{path}: a run of another format: train again")
        return Run(folder, restore(RunConfig, record))
    except FileNotFoundError as error:
        raise DataError(
            f"{path}: no such file: not a run's folder (`nerf fit DATA --run {folder}` makes one)"
        ) from error
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"{path}: damaged ({error}): train again") from error


def _comparable(config: RunConfig) -> dict[str, Any]:
    """Return what must be equal to go on: a larger budget may be asked for later."""
    record = json.loads(json.dumps(asdict(config)))
    for budget in ("steps", "seconds"):
        record["fit"].pop(budget)
    return record
