"""Rendering of training samples from procedural streets: many worlds, cameras, lights and places, once to disk.

Two thirds of the samples look as KITTI's car does; the rest through other cameras: wider and narrower, higher and
lower, with other baselines, tilted, looking to the side. What differs between the two images of a real pair
(exposure, rectification, noise, dirt) is added when a sample is used, anew each time: learn/stereo_augment.py.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from priors import geometry
from priors.learn import pair_file
from priors.learn.sample_folder import PER_WORLD, sample_path
from priors.learn.stereo_pair import Sensors, StereoPair
from priors.selection import shard
from priors.street import lidar, rig
from priors.street.config import StreetConfig
from priors.street.street import Street
from priors.types import Camera, Matrix

SIZE = (288, 576)
SECONDS = 18.0
KITTI_SHARE = 0.65
FIRST_WORLD = 100_000
"""Training worlds are seeded from here on, so that no street that a user renders by a small seed was trained on."""


def render(out: Path, count: int, on_sample: Callable[[int], None] = lambda number: None, part: str = "1/1") -> None:
    """Render samples 0 to count - 1 into a folder; what is there already is kept.

    Raises DataError where `part` is not i/n.

    Args:
        out: folder; sample n is `<n>.npz` and follows from n alone.
        count: how many samples it is to hold.
        on_sample: called with each sample's number when it is there.
        part: i/n, to share the work among n processes.
    """
    for world in shard(list(range(-(-count // PER_WORLD))), part):
        street: Street | None = None
        for number in range(world * PER_WORLD, min((world + 1) * PER_WORLD, count)):
            path = sample_path(out, number)
            if not path.exists():
                street = street or Street(FIRST_WORLD + world, config=draw_world(FIRST_WORLD + world))
                pair_file.write(path, render_sample(street, number))
            on_sample(number)


def draw_world(seed: int) -> StreetConfig:
    """Draw a world that may be foggier, darker, emptier or steeper than the streets users are shown."""
    rng = np.random.default_rng([seed, 21])
    config = StreetConfig.draw(seed, length_m=340.0 + 1.1 * SECONDS * 13.0)
    change: dict[str, float | tuple[float, float]] = {}
    if rng.random() < 0.2:
        change["haze_m"] = rng.uniform(120.0, 900.0)
    if rng.random() < 0.4:
        change["exposure"] = rng.uniform(0.4, 1.25)
    if rng.random() < 0.25:
        change["built_share"] = (rng.uniform(0, 0.2), rng.uniform(0, 0.2))
    if rng.random() < 0.25:
        change["slope"] = rng.uniform(0.02, 0.06)
    if rng.random() < 0.3:
        change["sky_strength"] = rng.uniform(0.6, 1.3)
    if rng.random() < 0.3:
        change["sun_elevation_rad"] = rng.uniform(0.2, 0.6)
    if rng.random() < 0.4:
        change["saturation"] = rng.uniform(0.3, 1.2)
    return replace(config, **change)  # type: ignore[arg-type]


def render_sample(street: Street, number: int, size: tuple[int, int] = SIZE) -> StereoPair:
    """Render sample `number` of a street."""
    rng = np.random.default_rng([number, 22])
    kitti = rng.random() < KITTI_SHARE
    camera = _kitti_crop(rng, size) if kitti else _other_camera(rng, size)
    baseline_m = rig.BASELINE_M if kitti else float(rng.uniform(0.25, 0.8))
    time_s = float(rng.uniform(0, SECONDS))
    T_world_cam = street.T_world_cam(time_s) @ _sway(rng, wide=not kitti)
    T_world_right = T_world_cam.copy()
    T_world_right[:3, 3] += baseline_m * T_world_cam[:3, 0]
    left = street.view(T_world_cam, camera, time_s, 2 * number)
    right = street.view(T_world_right, camera, time_s, 2 * number + 1)
    reach = np.float32(camera.fx * baseline_m)
    disparity_px = np.where(left.depth_m > 0, reach / np.maximum(left.depth_m, np.float32(1e-3)), np.float32(0))
    points_m, beam = _scan(street, T_world_cam, camera, time_s, rng)
    weight = ((disparity_px > 0) | left.sky).astype(np.float32)
    sensors = Sensors(camera, baseline_m, points_m, beam)
    return StereoPair(left.image, right.image, disparity_px, left.sky, weight, "street", sensors)


def _kitti_crop(rng: np.random.Generator, size: tuple[int, int]) -> Camera:
    """Return KITTI's camera cropped to a window anywhere in its image, now and then a little zoomed."""
    zoom = rng.uniform(0.85, 1.25)
    camera = rig.camera((int(375 * zoom), int(1242 * zoom)))
    K = camera.K.copy()
    K[0, 2] -= rng.uniform(0, max(1, camera.size[1] - size[1]))
    K[1, 2] -= rng.uniform(0, max(1, camera.size[0] - size[0]))
    return Camera(K, size)


def _other_camera(rng: np.random.Generator, size: tuple[int, int]) -> Camera:
    """Return a camera with another focal length and a window of an image of unknown size."""
    focal = float(np.exp(rng.uniform(np.log(250.0), np.log(1600.0))))
    height, width = size
    K = np.diag([focal, focal, 1.0])
    K[:2, 2] = width * rng.uniform(0.0, 1.0), height * rng.uniform(0.15, 0.75)
    return Camera(K, size)


def _sway(rng: np.random.Generator, *, wide: bool) -> Matrix:
    """Return where the camera is and looks beside the rig's own place."""
    T = np.eye(4)
    degrees = rng.normal(0, [0.6, 1.5, 0.5]) if not wide else rng.normal(0, [2.0, 15.0, 1.5])
    T[:3, :3] = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
    metres = rng.uniform([-0.8, -0.15, 0], [0.8, 0.1, 0]) if not wide else rng.uniform([-1.2, -1.0, 0], [1.2, 0.5, 0])
    T[:3, 3] = metres
    return T


def _scan(
    street: Street, T_world_cam: Matrix, camera: Camera, time_s: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Measure one turn of a LiDAR mounted beside the camera as on KITTI's car; keep what falls into the image."""
    material, tint = street.surfaces()
    T_cam_velo = rig.T_left_velo()
    T_cam_velo[:3, 3] += rng.normal(0, 0.05, 3)

    def poses(times: np.ndarray) -> Matrix:
        return np.broadcast_to(T_world_cam @ T_cam_velo, (len(times), 4, 4))

    points, _ = lidar.scan(street.caster, material, tint, poses, time_s, rng)
    xyz = points[:, :3].astype(np.float64)
    elevation = np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1]))
    middles = 0.5 * (lidar.ELEVATIONS_RAD[:-1] + lidar.ELEVATIONS_RAD[1:])
    beam = (63 - np.searchsorted(middles[::-1], elevation)).astype(np.uint8)
    xyz_cam_m = geometry.transform(T_cam_velo, xyz)
    uv, depth_m = geometry.project(camera, xyz_cam_m)
    height, width = camera.size
    inside = (depth_m > 0.5) & np.all((uv > -0.5) & (uv < [width - 0.5, height - 0.5]), axis=1)
    return xyz_cam_m[inside].astype(np.float32), beam[inside]
