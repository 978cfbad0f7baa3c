"""The arguments of commands that render a run."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from cli.arguments import Device, ThreadArguments
from cli.console import progress
from nerf.run import Run, moved, open_run
from priors.selection import parse_range


@dataclass(frozen=True)
class RunArguments(ThreadArguments):
    """Which run, and which of its drive's frames."""

    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """The run's folder."""
    frames: str | None = None
    """Range of frames, a:b; default: the run's."""
    device: Device = "auto"
    """Where to render; auto: a GPU where there is one."""
    data: Path | None = None
    """Where the run's drive is now, if it has moved."""

    def __post_init__(self) -> None:
        super().__post_init__()
        parse_range(self.frames)

    def open(self) -> Run:
        """Open the run."""
        return open_moved(self.run, self.data)


def open_moved(folder: Path, data: Path | None) -> Run:
    """Open a run; `data` says where its drive is now, if it has moved."""
    run = replace(open_run(folder), progress=progress)
    return run if data is None else moved(run, data)
