"""Where the browser's camera stands: at a frame's pose, and at first where the whole drive can be seen."""

from typing import Any

import numpy as np

from priors.types import Camera, Matrix
from priors.view.track import Track, fitting_fov

LOOK_AHEAD_M = 8.0
"""How far before the camera the point lies that a drag of the mouse turns around."""
BEHIND_M, ABOVE_M = 7.0, 3.0


def place_first(server: Any, track: Track) -> None:
    """Let a new browser look along the drive, from behind and above the first camera, with the cameras' up as up."""
    up, pose = track.up(), first_pose(track)
    server.scene.set_up_direction(up)
    server.initial_camera.position = pose[:3, 3] - BEHIND_M * pose[:3, 2] + ABOVE_M * up
    server.initial_camera.look_at = pose[:3, 3] + LOOK_AHEAD_M * pose[:3, 2]
    server.initial_camera.up = up
    server.initial_camera.far = 5000.0


def first_pose(track: Track) -> Matrix:
    """Return the first pose (4, 4) of a track."""
    poses = (track.pose(position) for position in range(len(track.ids)))
    return next((pose for pose in poses if pose is not None), np.eye(4))


def stand_at(client: Any, T_view_cam: Matrix, camera: Camera) -> None:
    """Put a browser's camera where a drive's camera was, with a field of view that shows its whole image."""
    with client.atomic():
        client.camera.position = T_view_cam[:3, 3]
        client.camera.up_direction = -T_view_cam[:3, 1]
        client.camera.look_at = T_view_cam[:3, 3] + LOOK_AHEAD_M * T_view_cam[:3, 2]
        client.camera.fov = fitting_fov(camera, client.camera.aspect)
