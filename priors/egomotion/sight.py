"""Sight: what one frame shows of the scene around it: a grey image and the depth of its pixels, for following corners.

Depth is that of a stereo match, corrected as the stereo method does it, or of the frame's LiDAR sweep.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from priors.codecs import as_grey
from priors.errors import DataError
from priors.geometry import convert_disparity, project, scatter_nearest, transform, untwist
from priors.pairs.matching import halve, match
from priors.pairs.read import Pair, baseline, measure_rectification, read_pair
from priors.pairs.rectification import RectificationError
from priors.types import Camera, Drive, FloatMap, Frame, Image

Source: TypeAlias = Literal["stereo", "lidar"]
WIDEST_PX = 800
"""Wider images are halved: half of KITTI's size tells a motion to 0.03 px, and costs a quarter."""
NEAREST_M = 1.0


@dataclass(frozen=True)
class Sight:
    """A frame's image and depth, in one size."""

    grey: Image
    """(height, width)."""
    depth_m: FloatMap
    """(height, width), metres along z; 0 = none."""
    camera: Camera
    """Of this size."""
    fx_baseline: float | None
    """Focal length times baseline, px m, where the depth is that of a pair; None for a LiDAR's."""


@dataclass(frozen=True)
class Eyes:
    """How the frames of one drive are looked at."""

    source: Source
    error: RectificationError
    """What the disparities are corrected by."""

    def __call__(self, frame: Frame) -> Sight:
        """Look at a frame; DataError where its images or its sweep cannot be read."""
        return _by_pair(frame, self.error) if self.source == "stereo" else _by_sweep(frame)


Look: TypeAlias = Callable[[Frame], Sight]
"""Looks at a frame; DataError where that cannot be done."""


def open_eyes(drive: Drive, source: Source | Literal["auto"] = "auto") -> Eyes:
    """Choose what tells depth, and measure a pair's rectification error on the first frame that has one.

    Raises:
        DataError: the drive has neither a pair nor a LiDAR, or not the one that is asked for.
    """
    wanted: tuple[Source, ...] = ("stereo", "lidar") if source == "auto" else (source,)
    for name in wanted:
        has = _has_pair if name == "stereo" else _has_sweep
        for index in range(len(drive)):
            try:
                frame = drive[index]
                if has(frame):
                    error = measure_rectification(frame, match) if name == "stereo" else RectificationError()
                    return Eyes(name, error)
            except DataError:
                continue  # it is told where the frame is used
    lacks = {"stereo": "stereo pair", "lidar": "LiDAR"}
    raise DataError(f"{drive.name}: no {' and no '.join(lacks[name] for name in wanted)}: its motion cannot be seen")


def _has_pair(frame: Frame) -> bool:
    return frame.has("image") and frame.has("other") and bool(frame.baseline_m)


def _has_sweep(frame: Frame) -> bool:
    return frame.has("image") and frame.has("sweep") and frame.T_cam_lidar is not None


def _by_pair(frame: Frame, error: RectificationError) -> Sight:
    """Match a frame's pair."""
    fx_baseline, pair = frame.camera.fx * baseline(frame), read_pair(frame)
    left, right, camera = as_grey(pair.left), as_grey(pair.right), frame.camera
    scale = 1
    while left.shape[1] > WIDEST_PX:
        left, right, camera, scale = halve(left), halve(right), halve_camera(camera), 2 * scale
    small = Pair(left, right, pair.mirrored)
    matched_px = small.match(match)
    small_error = shrink(error, scale)
    disparity_px = np.where(matched_px > 0, small_error.correct(matched_px, camera), np.float32(0))
    disparity_px = np.maximum(disparity_px, np.float32(0))
    depth_m = convert_disparity(disparity_px, camera.fx, fx_baseline / frame.camera.fx)
    return Sight(small.restore(left), depth_m, camera, fx_baseline / scale)


def _by_sweep(frame: Frame) -> Sight:
    """Project a frame's own sweep."""
    grey, camera, sweep = as_grey(frame.image()), frame.camera, frame.sweep()
    if sweep is None or frame.T_cam_lidar is None:
        raise DataError(f"frame {frame.id}: it has no sweep")
    while grey.shape[1] > WIDEST_PX:
        grey, camera = halve(grey), halve_camera(camera)
    uv_px, depth_m = project(camera, transform(frame.T_cam_lidar, untwist(sweep)))
    far = depth_m > NEAREST_M
    return Sight(grey, scatter_nearest(uv_px[far], depth_m[far], camera.size), camera, None)


def halve_camera(camera: Camera) -> Camera:
    """Return the camera of an image that `halve` made."""
    K = camera.K.copy()
    K[:2] /= 2
    K[:2, 2] -= 0.25  # the first pixel's centre is (0, 0): a half pixel of the large image is cut off on either side
    height, width = camera.size
    return Camera(K, ((height + 1) // 2, (width + 1) // 2))


def shrink(error: RectificationError, scale: int) -> RectificationError:
    """Return a rectification error in the pixels of images that are `scale` times as small."""
    shift, tilt, yaw, pitch = (value / scale for value in error.offset_px)
    return RectificationError(shift, tilt, yaw, pitch, error.scale)
