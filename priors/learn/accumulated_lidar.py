"""Accumulated LiDAR of real drives: the truth of a frame, and what is made of several sweeps, as users have it.

The truth is what nine sweeps saw, placed by the drive's poses, or by odometry where it has none, and cleaned.
"""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from priors.errors import DataError
from priors.geometry import invert, transform
from priors.learn.lidar_odometry import poses
from priors.learn.lidar_scene import LidarScene, pixels, splat
from priors.learn.scan_lines import beam_of
from priors.methods.lidar import Lidar, hidden
from priors.motion import Trajectory
from priors.types import FloatMap, Frame, Mask, Matrix, Sweep

SWEEPS, SURE = 9, 0.05
"""Sweeps accumulated, and the least confidence of a value to be truth."""
INPUTS = (2, 3, 5, 11)
"""Numbers of sweeps that a completion is given."""
AROUND_PX, SLACK = (17, 13), 0.03
"""Truth lies between the own sweep's nearest and farthest samples in such a window, to within a share of them."""


def scenes_of(frames: list[Frame], source: str) -> list[LidarScene]:
    """Make scenes of a drive's frames that follow each other; DataError where one has no sweep.

    Args:
        frames: consecutive frames; without poses, those around them are not looked at.
        source: what the drive is called in figures.
    """
    placed = frames if all(frame.T_world_cam is not None for frame in frames) else _pose(frames)
    return [_accumulate(frame, source) for frame in placed]


def _pose(frames: list[Frame]) -> list[Frame]:
    """Give frames poses that their sweeps tell, and neighbours to accumulate."""
    sweeps = [_sweep(frame) for frame in frames]
    T_world_lidars = poses([sweep.xyz_m for sweep in sweeps])

    path = Trajectory.of_numbers(dict(enumerate(T_world_lidars)), {})

    def reader(at: int) -> Callable[[int], Sweep | None]:
        def read(offset: int = 0) -> Sweep | None:
            index = at + offset
            inside = 0 <= index < len(sweeps)
            placed = replace(sweeps[index], T_world_lidar=T_world_lidars[index]) if inside else None
            return path.without_far_side(placed, str(at), str(index))

        return read

    posed = []
    for index, frame in enumerate(frames):
        T_world_cam = T_world_lidars[index] @ invert(_T_cam_lidar(frame))
        readers = {**frame.readers, "sweep": reader(index)}
        posed.append(replace(frame, T_world_cam=T_world_cam, readers=readers))
    return posed


def own_scene(frame: Frame, truth_m: FloatMap, source: str) -> LidarScene:
    """Make a scene of a real frame's own sweep and its truth (h, w), 0 = not known."""
    xyz_m, T_cam_lidar = _sweep(frame).xyz_m.astype(np.float64), _T_cam_lidar(frame)
    points_m, beam = transform(T_cam_lidar, xyz_m).astype(np.float32), beam_of(xyz_m)
    inside = pixels(points_m, frame.camera)[1]
    image, camera = frame.image(), frame.camera
    return LidarScene(image, camera, T_cam_lidar, points_m[inside], beam[inside], truth_m, real=True, source=source)


def _accumulate(frame: Frame, source: str) -> LidarScene:
    """Read a frame's own points and accumulate its truth."""
    scene = own_scene(frame, np.zeros(frame.camera.size, np.float32), source)
    accumulated = Lidar(sweeps=SWEEPS, stereo=False)(frame)
    if accumulated.confidence is None:
        raise ValueError("the lidar method gives a confidence with every map")
    own_m = splat(scene.points_m, frame.camera)
    own_m[hidden(np.where(own_m > 0, own_m, np.float32(np.inf)), frame.camera.fx)] = 0
    sure = (accumulated.confidence > SURE) & agrees(accumulated.depth_m, own_m)
    truth_m = np.where(sure, accumulated.depth_m, np.float32(0))
    accumulated_m = {count: Lidar(sweeps=count)(frame).depth_m for count in INPUTS}
    return replace(scene, truth_m=truth_m, accumulated_m=accumulated_m)


def agrees(depth_m: FloatMap, own_m: FloatMap) -> Mask:
    """Tell which values lie within the depths that the frame's own sweep (0 = none) has around them (height, width)."""
    window = np.ones(AROUND_PX, np.uint8)
    nearest_m = cv2.erode(np.where(own_m > 0, own_m, np.float32(np.inf)), window)
    farthest_m = cv2.dilate(own_m, window)
    return np.asarray((depth_m > (1 - SLACK) * nearest_m) & (depth_m < (1 + SLACK) * farthest_m))


def _sweep(frame: Frame) -> Sweep:
    sweep = frame.sweep()
    if sweep is None:
        raise DataError(f"frame {frame.id}: no sweep to learn from")
    return sweep


def _T_cam_lidar(frame: Frame) -> Matrix:
    if frame.T_cam_lidar is None:
        raise DataError(f"frame {frame.id}: the LiDAR's place on the car is not known")
    return frame.T_cam_lidar
