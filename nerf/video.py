"""Video along the drive's path: colour over depth, the camera gliding between the frames' poses."""

import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from eval.image import as_uint8
from nerf.types import Render
from priors.draw.colours import colour_depth
from priors.errors import DataError
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
        if self.steps < 1 or not self.fps > 0:
            raise DataError(f"video: {self.steps} steps at {self.fps} fps, expected 1 or more and above 0")


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
        DataError: the path does not end in .mp4, or OpenCV cannot write videos here.
    """
    config = config or VideoConfig()
    poses = interpolate(T_world_cam, config.steps)

    def pictures() -> Iterator[Image]:
        for pose in poses:
            yield picture(render, pose, camera)
            on_picture()

    write_pictures(path, pictures(), config.fps)
    return len(poses)


def picture(render: Render, pose: npt.NDArray[np.float64], camera: Camera) -> Image:
    """Render colour over depth: (2 height, width, 3), each side even, as the codec needs it."""
    view = render(pose, camera)
    both = np.concatenate([as_uint8(view.rgb), colour_depth(view.solid().depth_m)])
    return np.pad(both, ((0, 0), (0, both.shape[1] % 2), (0, 0)), mode="edge")


def write_pictures(path: Path, pictures: Iterator[Image], fps: float) -> None:
    """Write RGB pictures of one even size as an MP4 file (MPEG-4 part 2), atomically."""
    if path.suffix != ".mp4":
        raise DataError(f"{path}: expected a name that ends in .mp4")
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{uuid.uuid4().hex[:8]}.mp4")
    writer = None
    try:
        count = 0
        for rgb in pictures:
            if writer is None:
                code = cv2.VideoWriter.fourcc(*"mp4v")
                writer = cv2.VideoWriter(str(temporary), code, fps, (rgb.shape[1], rgb.shape[0]))
                if not writer.isOpened():
                    raise DataError(f"{path}: this OpenCV cannot write MP4: install opencv-contrib-python-headless")
            writer.write(np.ascontiguousarray(rgb[..., ::-1]))
            count += 1
        if writer is None:
            raise DataError(f"{path}: no pictures to write")
        writer.release()
        if cv2.VideoCapture(str(temporary)).get(cv2.CAP_PROP_FRAME_COUNT) != count:  # OpenCV tells no write errors
            raise DataError(f"{path}: the video was not written whole: is the disk full?")
        temporary.replace(path)
    finally:
        if writer is not None:
            writer.release()
        temporary.unlink(missing_ok=True)
