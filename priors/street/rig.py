"""The rig: two cameras and a LiDAR, mounted as on KITTI's car."""

import numpy as np

from priors import geometry
from priors.types import Camera, Matrix

KITTI_CAMERA = Camera(np.array([[721.5377, 0, 609.5593], [0, 721.5377, 172.854], [0, 0, 1]]), (375, 1242))
BASELINE_M = 0.54
LEFT_OFFSET_M = 0.06
"""How far camera 2 is to the left of camera 0, metres."""

FACING = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""From x forward, y left, z up to a camera's x right, y down, z forward."""


def camera(size: tuple[int, int]) -> Camera:
    """Return the rectified camera for images of (height, width)."""
    return geometry.resize(KITTI_CAMERA, size)


def T_cam0_velo() -> Matrix:
    """Return the LiDAR's place: 27 cm behind camera 0 and 8 cm above it, as KITTI's."""
    T = FACING.copy()
    T[:3, 3] = [-0.004, -0.076, -0.272]
    return T


def T_left_velo() -> Matrix:
    """Return the LiDAR's place as camera 2, the left colour camera, sees it."""
    T = T_cam0_velo()
    T[0, 3] += LEFT_OFFSET_M
    return T


def T_velo_imu() -> Matrix:
    """Return the IMU's place in the LiDAR's frame."""
    T = np.eye(4)
    T[:3, 3] = [-0.81, 0.32, -0.8]
    return T


def right_of(T_world_cam: Matrix) -> Matrix:
    """Return the right camera's pose for the left one's."""
    T = T_world_cam.copy()
    T[:3, 3] += BASELINE_M * T[:3, 0]
    return T
