"""What a run's view shows beside the field: its drive's cameras, and its prior's points where there are any."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from nerf.guide import Truth, open_guide
from nerf.run import Run
from priors.cache import Prior
from priors.errors import DataError
from priors.selection import select
from priors.types import Camera
from priors.view.scene import MOST_POINTS, DriveScene
from priors.view.track import Track

Part: TypeAlias = Literal["trained on", "held out", "not used"]
"""What a frame is to the run."""
PRIOR = "prior"
NO_POINTS = "the run's prior is the drive's own truth: its points are not shown"
USUAL = Camera(np.array([[230.0, 0, 198], [0, 230, 59.5], [0, 0, 1]]), (120, 397))
"""Where nothing is known of the run's own camera."""


@dataclass(frozen=True)
class Stage:
    """What there is beside the field."""

    camera: Camera
    track: Track
    parts: list[Part]
    """Of each of the track's frames."""
    drive: DriveScene | None
    """Where the drive could be opened; with the run's prior where that could be too."""
    remarks: tuple[str, ...] = ()
    """What is not there and why, one line each."""

    @property
    def has_points(self) -> bool:
        """Whether the prior's points can be shown."""
        return self.drive is not None and bool(self.drive.priors)


def open_stage(run: Run, frames: str | None = None, most_points: int = MOST_POINTS) -> Stage:
    """Open what there is: the drive, else what was prepared of it beside the run, else nothing but a start.

    Args:
        run: whose.
        frames: only these of its frames, a:b; None: all of them.
        most_points: of the prior, shown at once.

    Raises:
        DataError: none of the run's frames is in the range.
    """
    try:
        drive = run.drive
        indices = select(drive.ids, run.config.frames)
        posed = {index for index in indices if drive[index].T_world_cam is not None}
    except (DataError, OSError) as error:
        return _without_drive(run, frames, f"the drive cannot be opened: {error}")
    wanted = set(select(drive.ids, frames)) & posed
    if not wanted:
        return _start(f"{drive.name}: none of these frames has a pose")
    parts = dict(zip(indices, _parts(run, len(indices)), strict=True))
    priors, remarks = _prior(run)
    scene = DriveScene(drive, sorted(wanted), priors, most_points)
    return Stage(scene.frame(0).camera, scene.track, [parts[index] for index in scene.indices], scene, remarks)


def _prior(run: Run) -> tuple[dict[str, Prior], tuple[str, ...]]:
    """Open the run's prior; where it cannot be opened, say why."""
    if run.config.prior is None:
        return {}, ()
    try:
        guide = open_guide(run.config.prior)
        return ({}, (NO_POINTS,)) if isinstance(guide, Truth) else ({PRIOR: guide}, ())
    except (DataError, OSError) as error:
        return {}, (f"the prior cannot be opened: {error}",)


def _without_drive(run: Run, frames: str | None, reason: str) -> Stage:
    """Take the cameras that the run kept, where it did."""
    views = run.kept_cameras()
    if views is None:
        return _start(reason)
    parts = dict(zip(views.ids, _parts(run, len(views.ids)), strict=True))
    shown = views.only(frames)
    poses = list(shown.T_world_cam)
    track = Track(shown.ids, poses, poses[0][:3, 3].copy(), True)
    return Stage(shown.camera, track, [parts[id_] for id_ in shown.ids], None, (reason,))


def _start(reason: str) -> Stage:
    """Begin at the world's origin."""
    track = Track(["start"], [np.eye(4)], np.zeros(3), True)
    return Stage(USUAL, track, ["not used"], None, (reason, "no camera is known: the view begins at the origin"))


def _parts(run: Run, count: int) -> list[Part]:
    train, test = run.config.parts(count)
    trained, held_out = set(train), set(test)
    return ["trained on" if i in trained else "held out" if i in held_out else "not used" for i in range(count)]
