"""Viewpoints: where views are rendered from, along a drive or from a file of poses."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from priors.errors import DataError
from priors.poses import parse_pose
from priors.selection import select
from priors.text import read_lines
from priors.types import Camera, Drive


@dataclass(frozen=True)
class Viewpoints:
    """Poses of one camera."""

    camera: Camera
    ids: list[str]
    """Names of the views' files."""
    T_world_cam: npt.NDArray[np.float64]
    """(n, 4, 4) camera to world, the drive's own frame, metres."""

    def only(self, frames: str | None) -> "Viewpoints":
        """Return those in a range of frames a:b; None: all of them. DataError where there are none."""
        positions = select(self.ids, frames)
        return Viewpoints(self.camera, [self.ids[position] for position in positions], self.T_world_cam[positions])


def along(drive: Drive, frames: str | None = None) -> Viewpoints:
    """Return where a drive's camera was, in a range of frames a:b; None: all of them."""
    posed = [drive[position] for position in select(drive.ids, frames)]
    return Viewpoints(posed[0].camera, [frame.id for frame in posed], np.array([f.T_world_cam for f in posed]))


def read_poses(path: Path, camera: Camera) -> Viewpoints:
    """Read KITTI's poses, one a line: 12 numbers, camera to world, row by row, metres, in the drive's own frame.

    Raises:
        DataError: it cannot be read, or a line has not 12 finite numbers.
    """
    lines = [line for line in read_lines(path) if line.text]
    if not lines:
        raise DataError(f"{path}: expected 12 numbers a line, found no line")
    poses = np.array([parse_pose(line.text, f"{path}: line {line.number}") for line in lines])
    return Viewpoints(camera, [f"{i:06d}" for i in range(len(lines))], poses)
