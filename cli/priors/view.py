"""`priors view`: a drive and its priors in three dimensions, live in a browser."""

import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from cli.arguments import DatasetName, DriveArguments, by_drive, find_priors, folders_to_name, parse, reopen_drive
from cli.view import AddressArguments
from priors.cache import Prior, holds_priors
from priors.drives import DriveOptions
from priors.errors import DataError, UsageError, expect_between
from priors.naming import labels
from priors.selection import parse_range, select
from priors.view import server
from priors.view.panel import DrivePanel
from priors.view.scene import MOST_POINTS, DriveScene

EXAMPLES = """Look at a drive in three dimensions, live in a browser: the camera's path, images, LiDAR sweeps, and the
points of the priors in a cache, coloured by image, depth, error or confidence.
Needs viser: pip install 'roadprior[view]'.

examples:
  priors view cache/
  priors view cache/DRIVE --frames 5:17
  priors view street/                                  a drive without priors
"""
CACHE = Path("cache")


@dataclass(frozen=True)
class ViewArguments(AddressArguments):
    """Arguments of `priors view`."""

    what: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[CACHE|DATA]")] = None
    """A cache, a drive's or a prior's folder in it, or DATA, a drive's own folder; default: cache/ where there is one,
    else the drive here."""
    frames: str | None = None
    """Only this range of frames, a:b."""
    data: Path | None = None
    """Where the drive of a cache is now, if it has moved since the build."""
    points: int = MOST_POINTS
    """Points shown at once, at most, of a prior and as many of sweeps: more frames at once are thinner."""
    dataset: DatasetName = "auto"
    """Data set of DATA; auto recognises it from the folder."""
    part: tyro.conf.OmitArgPrefixes[DriveOptions] = field(default_factory=DriveOptions)

    def __post_init__(self) -> None:
        super().__post_init__()
        parse_range(self.frames)
        expect_between(1, self.points, 10**8, "--points")

    def scene(self, typed: list[str]) -> DriveScene:
        """Open what there is to see; `typed`, the command, is repeated where there are several drives."""
        place = CACHE if self.what is None and holds_priors(CACHE) else self.what
        priors = [] if place is None or not holds_priors(place) else self._priors(place)
        if priors:
            drive = reopen_drive(priors, self.part.truth, self.data)
        else:
            drive = DriveArguments(place, self.dataset, self.part).open(typed)
        named = dict(zip(labels(priors), priors, strict=True))
        return DriveScene(drive, select(drive.ids, self.frames), named, self.points)

    def _priors(self, place: Path) -> list[Prior]:
        """Return the priors of the one drive that is looked at; UsageError where there are several drives."""
        wanted = self.part.drive
        found = [prior for prior in find_priors(place) if wanted in (None, prior.drive["name"])]
        if not found:
            raise DataError(f"{place}: no priors of {wanted}: `priors list {place}` tells what there is")
        several = by_drive(found)
        if len(several) > 1:
            lines = [f"\n  priors view {shlex.quote(str(folder))}" for folder in folders_to_name(several)]
            raise UsageError(f"{place}: holds {len(several)} drives: name one:{''.join(lines)}")
        return several[0]


ARGUMENTS = {"priors view": ViewArguments}


def run(arguments: list[str]) -> int:
    """Serve the view until Ctrl-C; returns the exit code."""
    args = parse(ViewArguments, "priors view", EXAMPLES, arguments)
    server.require()
    scene = args.scene(["priors", "view", *arguments])
    return args.serve(f"priors view {scene.drive.name}", lambda opened: DrivePanel(opened, scene))
