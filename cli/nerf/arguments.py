"""The arguments of commands that render a run."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from cli.arguments import Device, ThreadArguments
from cli.console import err, progress
from nerf.run import Run, find, moved, open_run
from priors.errors import UsageError
from priors.selection import parse_range

RUNS = Path("runs")


@dataclass(frozen=True)
class RunArguments(ThreadArguments):
    """Which run, and which of its drive's frames."""

    run: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN]")] = None
    """The run's folder; default: the only one in runs/."""
    frames: str | None = None
    """Range of frames, a:b; default: the run's."""
    device: Device = "auto"
    """Where to render; auto: a GPU where there is one."""
    data: Path | None = None
    """Where the run's drive is now, if it has moved."""

    def __post_init__(self) -> None:
        super().__post_init__()
        parse_range(self.frames)

    def open(self, typed: Sequence[str]) -> Run:
        """Open the run; `typed`, program, command and flags, is repeated where there are several to choose from."""
        return open_moved(self._folder(typed), self.data)

    def _folder(self, typed: Sequence[str]) -> Path:
        """Return the folder of the run that is named, or of the only one there is."""
        if self.run is None and not RUNS.is_dir():
            raise UsageError(f"which run? There is no folder {RUNS}/ here: name a run's folder (`nerf fit` makes one)")
        folders = find(self.run or RUNS)
        if len(folders) > 1:
            raise UsageError(f"{self.run or RUNS}: {len(folders)} runs: name one:{_listed(folders, self.run, typed)}")
        if folders[0] != self.run:
            err.print(f"run: {folders[0]}")
        return folders[0]


def _listed(folders: Sequence[Path], run: Path | None, typed: Sequence[str]) -> str:
    """Number the runs, each as the command that takes it."""
    rest = [word for word in typed[2:] if run is None or word != str(run)]
    lines = [shlex.join([*typed[:2], str(folder), *rest]) for folder in folders]
    return "".join(f"\n  {number}. {line}" for number, line in enumerate(lines, 1))


def open_moved(folder: Path, data: Path | None) -> Run:
    """Open a run; `data` says where its drive is now, if it has moved."""
    run = replace(open_run(folder), progress=progress)
    return run if data is None else moved(run, data)
