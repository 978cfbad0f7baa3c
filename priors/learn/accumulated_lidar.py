"""Truth from a real drive: what several sweeps saw, placed by the sweeps themselves and cleaned, frame by frame."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from priors.drives.kitti_raw import KittiRaw
from priors.errors import DataError
from priors.geometry import invert, transform
from priors.learn.lidar_odometry import poses
from priors.learn.lidar_scene import Scene, pixels, splat
from priors.methods.lidar import Lidar, hidden
from priors.types import FloatMap, Frame, Mask, Sweep

SWEEPS, SURE = 9, 0.05
"""Sweeps accumulated, and the least confidence of a value to be truth."""
AROUND_PX, SLACK = (17, 13), 0.03
"""Truth lies between the own sweep's nearest and farthest samples in such a window, to within a share of them."""
LINE_RAD = np.radians(np.concatenate([np.linspace(2.0, -8.33, 32), np.linspace(-8.83, -24.8, 32)]))
"""Elevations of an HDL-64's lines."""


class Drive:
    """KITTI raw drives with sweeps and no poses, held in memory; the first frames of each are for validation."""

    def __init__(self, folder: Path, held_out: int = 4) -> None:
        """Take a drive's folder, or one whose kitti_raw_train/ holds drives; DataError where there is none."""
        within = sorted((folder / "kitti_raw_train").glob("*/*_sync"))
        self.train: list[Scene] = []
        self.validation: list[Scene] = []
        for found in within or [folder]:
            drive = KittiRaw(found)
            scenes = [_scene(frame) for frame in _placed([drive[index] for index in range(len(drive))])]
            self.train += scenes[held_out:]
            self.validation += scenes[:held_out]


def _placed(frames: list[Frame]) -> list[Frame]:
    """Give frames poses that their sweeps tell, and neighbours to accumulate."""
    sweeps = [frame.sweep() for frame in frames]
    if any(sweep is None for sweep in sweeps) or any(frame.T_cam_lidar is None for frame in frames):
        raise DataError(f"frame {frames[0].id} and after: no sweeps to learn from")
    found = poses([sweep.xyz_m for sweep in sweeps if sweep is not None])

    def reader(at: int) -> Callable[[int], Sweep | None]:
        def read(offset: int = 0) -> Sweep | None:
            index, sweep = at + offset, sweeps[min(max(at + offset, 0), len(sweeps) - 1)]
            return replace(sweep, T_world_lidar=found[index]) if sweep and 0 <= index < len(sweeps) else None

        return read

    placed = []
    for index, frame in enumerate(frames):
        assert frame.T_cam_lidar is not None
        T_world_cam = found[index] @ invert(frame.T_cam_lidar)
        readers = {**frame.readers, "sweep": reader(index)}
        placed.append(replace(frame, T_world_cam=T_world_cam, readers=readers))
    return placed


def _scene(frame: Frame) -> Scene:
    """Read a frame's own points and accumulate its truth."""
    sweep = frame.sweep()
    assert sweep is not None and frame.T_cam_lidar is not None
    xyz_m = sweep.xyz_m.astype(np.float64)
    elevation = np.arctan2(xyz_m[:, 2], np.hypot(xyz_m[:, 0], xyz_m[:, 1]))
    beam = (63 - np.searchsorted(0.5 * (LINE_RAD[:-1] + LINE_RAD[1:])[::-1], elevation)).astype(np.uint8)
    seen = transform(frame.T_cam_lidar, xyz_m).astype(np.float32)
    inside = pixels(seen, frame.camera)[1]
    gathered = Lidar(sweeps=SWEEPS, stereo=False)(frame)
    assert gathered.confidence is not None
    own_m = splat(seen[inside], frame.camera)
    own_m[hidden(np.where(own_m > 0, own_m, np.float32(np.inf)), frame.camera.fx)] = 0
    sure = (gathered.confidence > SURE) & agrees(gathered.depth_m, own_m)
    truth_m = np.where(sure, gathered.depth_m, np.float32(0))
    return Scene(frame.image(), frame.camera, frame.T_cam_lidar, seen[inside], beam[inside], truth_m, real=True)


def agrees(depth_m: FloatMap, own_m: FloatMap) -> Mask:
    """Tell which values lie within the depths that the frame's own sweep (0 = none) has around them (height, width)."""
    window = np.ones(AROUND_PX, np.uint8)
    nearest_m = cv2.erode(np.where(own_m > 0, own_m, np.float32(np.inf)), window)
    farthest_m = cv2.dilate(own_m, window)
    return np.asarray((depth_m > (1 - SLACK) * nearest_m) & (depth_m < (1 + SLACK) * farthest_m))
