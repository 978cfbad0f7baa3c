"""Images of one wall from known places by a camera whose lens may bend lines: what COLMAP and nerfstudio describe."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

SIZE = (96, 160)
FX, FY, CX, CY = 130.0, 128.0, 81.25, 46.75  # the centre of the top-left pixel is (0, 0)
BENT = (-0.08, 0.02, 0.001, -0.002)  # k1 k2 p1 p2
K = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1.0]])
WALL_M = 12.0


@dataclass(frozen=True)
class Taken:
    """One image of the wall z = WALL_M of the world."""

    name: str
    T_world_cam: np.ndarray
    image: np.ndarray
    depth_m: np.ndarray


def colour(xyz_m: np.ndarray) -> np.ndarray:
    """Smooth colours (..., 3) of the wall at places (..., 3)."""
    x, y = xyz_m[..., 0], xyz_m[..., 1]
    waves = (np.sin(0.9 * x), np.cos(0.7 * y), np.sin(0.5 * x + 0.8 * y))
    return np.rint(128 + 100 * np.stack(waves, axis=-1)).astype(np.uint8)


def look(T_world_cam: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What rays (..., 3) of a camera, z = 1, see: places in the world (..., 3) and depth along z (...)."""
    turned = directions @ T_world_cam[:3, :3].T
    depth_m = (WALL_M - T_world_cam[2, 3]) / turned[..., 2]
    return T_world_cam[:3, 3] + depth_m[..., None] * turned, depth_m


def bend(xy: np.ndarray, distortion: tuple[float, ...]) -> np.ndarray:
    """Where a lens puts straight image coordinates (..., 2) (Brown, 1971)."""
    k1, k2, p1, p2 = distortion
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    bent_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([bent_x, bent_y], axis=-1)


def unbend(bent: np.ndarray, distortion: tuple[float, ...]) -> np.ndarray:
    """The straight coordinates that a lens puts there, by fixed-point steps."""
    xy = bent.copy()
    for _ in range(100):
        xy += bent - bend(xy, distortion)
    return xy


def take(name: str, number: int, distortion: tuple[float, ...] = ()) -> Taken:
    """Take the image from the number-th place, pixel by pixel, through the lens."""
    v, u = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float64)
    xy = unbend(np.stack([(u - CX) / FX, (v - CY) / FY], axis=-1), distortion or (0.0, 0.0, 0.0, 0.0))
    T_world_cam = np.eye(4)
    T_world_cam[:3, :3] = Rotation.from_euler("xyz", [2, -5 + 3 * number, 1], degrees=True).as_matrix()
    T_world_cam[:3, 3] = [0.4 * number, -0.1, 0.3 * number]
    places, depth_m = look(T_world_cam, np.concatenate([xy, np.ones((*SIZE, 1))], axis=-1))
    return Taken(name, T_world_cam, colour(places), depth_m.astype(np.float32))


def seen_by(T_world_cam: np.ndarray, K_shown: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """The image and the depth that a straight camera would see."""
    v, u = np.mgrid[: size[0], : size[1]].astype(np.float64)
    directions = np.stack([u, v, np.ones(size)], axis=-1) @ np.linalg.inv(K_shown).T
    places, depth_m = look(T_world_cam, directions)
    return colour(places), depth_m
