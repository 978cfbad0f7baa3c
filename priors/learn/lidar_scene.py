"""LiDAR scenes for training completion: an image, all LiDAR points of the moment, and the truth beside them.

There are two kinds: the procedural street, whose truth is dense and exact, and real ones (real_scenes.py): KITTI 2015,
whose truth is the benchmark's, and drives, whose truth is what several sweeps saw (accumulated_lidar.py).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from priors import geometry
from priors.errors import DataError
from priors.geometry import mirror_columns
from priors.learn import pair_file
from priors.street import rig
from priors.types import Camera, FloatMap, Image, Mask, Matrix

Points = npt.NDArray[np.float32]
TRUTH_REACH_M = 90.0
"""Truth beyond this teaches nothing: no LiDAR sample is ever there."""
NEAREST_M = 0.1
"""Points nearer than this to the camera's plane are outside its image."""


@dataclass(frozen=True, slots=True)
class LidarScene:
    """One moment: image, LiDAR points, and the truth where it is known beside them."""

    image: Image
    """(h, w, 3) uint8."""
    camera: Camera
    T_cam_lidar: Matrix
    points_m: Points
    """(n, 3) in the camera's axes, inside the image."""
    beam: npt.NDArray[np.uint8]
    """(n,) scan line, 0 = the highest."""
    truth_m: FloatMap
    """(h, w) 0 = unknown."""
    real: bool
    """Truth is accumulated LiDAR, sparse and with what its cleaning left over."""
    accumulated_m: Mapping[int, FloatMap] = field(default_factory=dict)
    """What the lidar method makes of so many sweeps, (h, w) each, 0 = none: other inputs than the own points."""
    source: str = "street"
    """Where it comes from, for figures."""


def read_street(path: Path) -> LidarScene:
    """Read a rendered sample; DataError where it has no LiDAR points."""
    pair = pair_file.read(path)
    if pair.sensors is None:
        raise DataError(f"{path}: a training pair without LiDAR points: completion learns from rendered samples only")
    truth_m = np.where(pair.depth_m < TRUTH_REACH_M, pair.depth_m, np.float32(0))
    sensors = pair.sensors
    return LidarScene(pair.left, sensors.camera, rig.T_left_velo(), sensors.points_m, sensors.beam, truth_m, real=False)


def crop(scene: LidarScene, top: int, left: int, size: tuple[int, int]) -> LidarScene:
    """Cut a window out of a scene."""
    rows, columns = slice(top, top + size[0]), slice(left, left + size[1])
    camera = geometry.crop(scene.camera, top, left, size)
    inside = pixels(scene.points_m, camera)[1]
    return replace(
        scene,
        image=scene.image[rows, columns],
        camera=camera,
        points_m=scene.points_m[inside],
        beam=scene.beam[inside],
        truth_m=scene.truth_m[rows, columns],
        accumulated_m={count: map_[rows, columns] for count, map_ in scene.accumulated_m.items()},
    )


def flip(scene: LidarScene) -> LidarScene:
    """Mirror a scene."""
    T = scene.T_cam_lidar.copy()
    T[0, 3] *= -1  # only where the scanner stands is ever looked at
    return replace(
        scene,
        image=mirror_columns(scene.image),
        camera=geometry.mirror(scene.camera),
        T_cam_lidar=T,
        points_m=scene.points_m * np.array([-1, 1, 1], np.float32),
        truth_m=mirror_columns(scene.truth_m),
        accumulated_m={count: mirror_columns(map_) for count, map_ in scene.accumulated_m.items()},
    )


def rescale(scene: LidarScene, factor: float) -> LidarScene:
    """Make everything larger; the image stays as it is."""
    T = scene.T_cam_lidar.copy()
    T[:3, 3] *= factor
    size = np.float32(factor)
    accumulated_m = {count: map_ * size for count, map_ in scene.accumulated_m.items()}
    return replace(
        scene,
        T_cam_lidar=T,
        points_m=scene.points_m * size,
        truth_m=scene.truth_m * size,
        accumulated_m=accumulated_m,
    )


def pixels(points_m: Points, camera: Camera) -> tuple[npt.NDArray[np.intp], Mask]:
    """Return columns and rows (n, 2) of the points, and which lie inside the image."""
    z = np.maximum(points_m[:, 2:], np.float32(1e-3))
    uv = np.rint(points_m[:, :2] / z * [camera.K[0, 0], camera.K[1, 1]] + camera.K[:2, 2]).astype(np.intp)
    height, width = camera.size
    return uv, (points_m[:, 2] > NEAREST_M) & np.all((uv >= 0) & (uv < [width, height]), axis=1)


def splat(points_m: Points, camera: Camera) -> FloatMap:
    """Return the sparse map (h, w) of points (n, 3), metres; where two fall on one pixel, the nearer."""
    uv, inside = pixels(points_m, camera)
    uv, z = uv[inside], points_m[inside, 2]
    order = np.argsort(-z, kind="stable")
    sparse_m = np.zeros(camera.size, np.float32)
    sparse_m[uv[order, 1], uv[order, 0]] = z[order]
    return sparse_m
