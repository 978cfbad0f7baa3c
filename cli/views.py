"""What commands that render a run share."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import tyro

from cli.arguments import Device, ThreadArguments, pick_device
from nerf import checkpoint
from nerf.pictures import Render
from nerf.run import Run, open_run
from nerf.view import renderer
from priors.selection import select
from priors.types import Camera


@dataclass(frozen=True)
class RunArguments(ThreadArguments):
    """Which run, and which of its drive's frames."""

    run: Annotated[Path, tyro.conf.Positional]
    """The run's folder."""
    frames: str | None = None
    """Range of frames, a:b; default: the run's."""
    device: Device = "auto"
    """Where to render; auto: a GPU where there is one."""


@dataclass(frozen=True)
class Opened:
    """A run ready to be rendered."""

    run: Run
    render: Render
    camera: Camera
    ids: list[str]
    T_world_cam: npt.NDArray[np.float64]
    """(frames, 4, 4)"""


def open_views(args: RunArguments) -> Opened:
    """Open a run, its field and its drive's poses."""
    made = open_run(args.run)
    drive = made.drive()
    positions = select(drive.ids, args.frames or made.config.frames)
    frames = [drive[position] for position in positions]
    poses = np.array([frame.T_world_cam for frame in frames])
    render = renderer(checkpoint.open_model(args.run, pick_device(args.device)))
    return Opened(made, render, frames[0].camera, [frame.id for frame in frames], poses)
