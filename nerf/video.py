"""Video along the drive's path: colour over depth, the camera gliding between the frames' poses."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eval.image import as_uint8
from nerf.types import Render
from priors.draw.colours import colour_depth
from priors.draw.mp4 import write_mp4
from priors.errors import expect, expect_between
from priors.types import Camera, Image

Poses = npt.NDArray[np.float64]


@dataclass(frozen=True)
class VideoConfig:
    """How a video is made."""

    steps: int = 2
    """Pictures from one frame of the drive to the next: 2 adds one between."""
    fps: float = 20.0
    """Pictures a second: 20 with 2 steps is the speed of a drive of 10 Hz."""

    def __post_init__(self) -> None:
        expect_between(1, self.steps, 1000, "--steps")
        expect(0 < self.fps <= 1000, "--fps", self.fps, "pictures a second, above 0 and at most 1000")


def interpolate(T_world_cam: Poses, steps: int) -> Poses:
    """Return the poses (n, 4, 4) with steps - 1 more between neighbours: (steps (n - 1) + 1, 4, 4).

    Rotations turn evenly about one axis (Shoemake, SIGGRAPH 1985), places move along the line.
    """
    from scipy.spatial.transform import Rotation, Slerp

    if len(T_world_cam) < 2:
        return T_world_cam
    frames = np.arange(len(T_world_cam))
    times = np.arange(steps * (len(frames) - 1) + 1) / steps
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, :3, :3] = Slerp(frames, Rotation.from_matrix(T_world_cam[:, :3, :3]))(times).as_matrix()
    for axis in range(3):
        poses[:, axis, 3] = np.interp(times, frames, T_world_cam[:, axis, 3])
    return poses


def write_video(
    path: Path,
    render: Render,
    camera: Camera,
    T_world_cam: Poses,
    config: VideoConfig | None = None,
    on_picture: Callable[[], None] = lambda: None,
) -> int:
    """Render a video along the poses (n, 4, 4) of the drive's frames.

    Returns:
        How many pictures it has. The file is renamed into place when all are written.

    Raises:
        DataError: the path does not end in .mp4, or there are no poses.
    """
    config = config or VideoConfig()
    poses = interpolate(T_world_cam, config.steps)

    def pictures() -> Iterator[Image]:
        for pose in poses:
            yield picture(render, pose, camera)
            on_picture()

    return write_mp4(path, pictures(), config.fps)


def picture(render: Render, pose: npt.NDArray[np.float64], camera: Camera) -> Image:
    """Render colour over depth: (2 height, width, 3)."""
    view = render(pose, camera)
    return np.concatenate([as_uint8(view.rgb), colour_depth(view.solid().depth_m)])
