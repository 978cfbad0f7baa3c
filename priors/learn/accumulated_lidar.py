"""Accumulated LiDAR as the truth of real drives: sweeps, placed by odometry and cleaned, frame by frame."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from priors.drives.kitti_raw import KittiRaw
from priors.errors import DataError
from priors.geometry import invert, transform
from priors.learn.lidar_odometry import poses
from priors.learn.lidar_scene import LidarScene, pixels, splat
from priors.methods.lidar import Lidar, hidden
from priors.motion import Trajectory
from priors.types import FloatMap, Frame, Mask, Matrix, Sweep

SWEEPS, SURE = 9, 0.05
"""Sweeps accumulated, and the least confidence of a value to be truth."""
AROUND_PX, SLACK = (17, 13), 0.03
"""Truth lies between the own sweep's nearest and farthest samples in such a window, to within a share of them."""
LINE_RAD = np.radians(np.concatenate([np.linspace(2.0, -8.33, 32), np.linspace(-8.83, -24.8, 32)]))
"""Elevations of an HDL-64's lines."""


class AccumulatedDrives:
    """KITTI raw drives with sweeps and no poses, held in memory; the first frames of each are for validation."""

    def __init__(self, folder: Path, held_out: int = 4) -> None:
        """Take a drive's folder, or one whose kitti_raw_train/ holds drives; DataError where there is none."""
        folders = sorted((folder / "kitti_raw_train").glob("*/*_sync")) or [folder]
        self.train: list[LidarScene] = []
        self.validation: list[LidarScene] = []
        for path in folders:
            drive = KittiRaw(path)
            scenes = [_accumulate(frame) for frame in _pose([drive[index] for index in range(len(drive))])]
            self.train += scenes[held_out:]
            self.validation += scenes[:held_out]


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


def _sweep(frame: Frame) -> Sweep:
    sweep = frame.sweep()
    if sweep is None:
        raise DataError(f"frame {frame.id}: no sweep to learn from")
    return sweep


def _T_cam_lidar(frame: Frame) -> Matrix:
    if frame.T_cam_lidar is None:
        raise DataError(f"frame {frame.id}: the LiDAR's place on the car is not known")
    return frame.T_cam_lidar


def _accumulate(frame: Frame) -> LidarScene:
    """Read a frame's own points and accumulate its truth."""
    xyz_m, T_cam_lidar = _sweep(frame).xyz_m.astype(np.float64), _T_cam_lidar(frame)
    elevation = np.arctan2(xyz_m[:, 2], np.hypot(xyz_m[:, 0], xyz_m[:, 1]))
    beam = (63 - np.searchsorted(0.5 * (LINE_RAD[:-1] + LINE_RAD[1:])[::-1], elevation)).astype(np.uint8)
    points_m = transform(T_cam_lidar, xyz_m).astype(np.float32)
    inside = pixels(points_m, frame.camera)[1]
    accumulated = Lidar(sweeps=SWEEPS, stereo=False)(frame)
    if accumulated.confidence is None:
        raise ValueError("the lidar method gives a confidence with every map")
    own_m = splat(points_m[inside], frame.camera)
    own_m[hidden(np.where(own_m > 0, own_m, np.float32(np.inf)), frame.camera.fx)] = 0
    sure = (accumulated.confidence > SURE) & agrees(accumulated.depth_m, own_m)
    truth_m = np.where(sure, accumulated.depth_m, np.float32(0))
    return LidarScene(frame.image(), frame.camera, T_cam_lidar, points_m[inside], beam[inside], truth_m, real=True)


def agrees(depth_m: FloatMap, own_m: FloatMap) -> Mask:
    """Tell which values lie within the depths that the frame's own sweep (0 = none) has around them (height, width)."""
    window = np.ones(AROUND_PX, np.uint8)
    nearest_m = cv2.erode(np.where(own_m > 0, own_m, np.float32(np.inf)), window)
    farthest_m = cv2.dilate(own_m, window)
    return np.asarray((depth_m > (1 - SLACK) * nearest_m) & (depth_m < (1 + SLACK) * farthest_m))
