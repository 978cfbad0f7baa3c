"""The request of a run, as config.json holds it: it is enough to go on with the run from its folder alone."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from eval.files import write_bytes
from nerf import fields
from nerf.config import FitConfig
from nerf.guide import Guide, place_of
from nerf.prepare import SceneConfig
from nerf.rate import Rate
from nerf.split import SPARSE_STEP, in_name, split
from priors.errors import DataError
from priors.filters import Filters
from priors.records import restore
from priors.selection import select
from priors.types import Drive

FORMAT = 1
CONFIG = "config.json"
"""What every run's folder has."""


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
    sparse_step: int | None = None
    """Of the frames that are not held out, every so many-th is a sparse view; None: every 4th, as earlier versions
    had it, or other views."""
    finding: dict[str, Any] | None = None
    """What was found of the prior before the fit (nerf/evidence/finding.py); None: it was not looked for."""

    @classmethod
    def of(cls, drive: Drive, prior: Guide | None, scene: SceneConfig, fit: FitConfig) -> "RunConfig":
        """Describe a run of an open drive and an open prior."""
        where = None if prior is None else place_of(prior)
        positions = select(drive.ids, scene.frames)
        step = Rate.of(drive, positions).sparse_step if scene.views == "sparse" else None
        return cls(drive.describe(), where, scene.frames, scene.views, scene.filters, fit, step)

    @property
    def title(self) -> str:
        """What the run is, as its usual folder's name ends: `<field>-<views>`, then `<loss>-<prior>`."""
        loss = [self.fit.losses.loss] if fields.is_trained(self.fit.model.family) else []
        guide = [] if self.prior is None else [*loss, Path(self.prior).name]
        blocks = [] if self.fit.blocks_m is None else [f"blocks{self.fit.blocks_m:g}m"]
        return "-".join([self.fit.model.family, in_name(self.views), *blocks, *guide])

    @property
    def scene(self) -> SceneConfig:
        """What the run's scene has."""
        return SceneConfig(self.views, self.frames, self.filters, self.sparse_step or SPARSE_STEP)

    def parts(self, count: int) -> tuple[list[int], list[int]]:
        """Part so many frames into training and held-out positions."""
        return split(count, self.views, self.sparse_step)


def read(folder: Path) -> RunConfig:
    """Read the config in a run's folder.

    Raises:
        DataError: there is no config.json in it, or it is damaged or of another format.
    """
    path = folder / CONFIG
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        if record.pop("format") != FORMAT:
            raise DataError(f"{path}: a run of another format: train again")
        return restore(RunConfig, record)
    except FileNotFoundError as error:
        raise DataError(
            f"{path}: no such file: not a run's folder (`nerf fit DATA --run {folder}` makes one)"
        ) from error
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"{path}: damaged ({error}): train again") from error


def write(folder: Path, config: RunConfig) -> None:
    """Write a run's config."""
    write_bytes(folder / CONFIG, (json.dumps({"format": FORMAT, **asdict(config)}, indent=2) + "\n").encode())


def comparable(config: RunConfig) -> dict[str, Any]:
    """Return what must be equal to go on: a larger budget may be asked for later."""
    record = json.loads(json.dumps(asdict(config)))
    for budget in ("steps", "seconds"):
        record["fit"].pop(budget)
    record.pop("finding")
    return record
