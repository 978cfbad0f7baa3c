"""Nodes: what the browser draws of a drive - its path, its cameras, images in them, clouds of points."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from priors.types import Camera, Image, Matrix
from priors.view.cloud import Cloud
from priors.view.scene import spread
from priors.view.track import Track, field_of_view, quaternion

CAMERAS = 60
"""Cameras that are drawn along a path; of a long drive every n-th."""
CAMERA_M, IMAGE_M = 0.25, 1.2
"""Sizes of a camera that is drawn small, and of one that holds its image, metres."""
KEYS = {"next frame": ("N", 1), "previous frame": ("B", -1)}
"""Commands of both views: key, and by how many frames."""
PATH_RGB, CAMERA_RGB, IMAGE_RGB = (90, 170, 255), (150, 156, 166), (255, 255, 255)


def draw_path(server: Any, track: Track) -> list[Any]:
    """Draw the camera's path as a line; returns its nodes."""
    places_m = track.path_m().astype(np.float32)
    if len(places_m) < 2:
        return []
    segments = np.stack([places_m[:-1], places_m[1:]], axis=1)
    return [server.scene.add_line_segments("/path/line", segments, PATH_RGB, thickness=2.0, thickness_units="screen")]


def draw_cameras(
    server: Any, track: Track, camera: Camera, colours: Sequence[tuple[int, int, int]] | None = None
) -> list[Any]:
    """Draw the cameras along the path as small frustums, at most CAMERAS of them; returns their nodes.

    Args:
        server: viser's.
        track: where they are.
        camera: what they are.
        colours: of each frame's; None: all of one.
    """
    nodes = []
    for position in spread(len(track.ids), CAMERAS):
        pose = track.pose(position)
        if pose is not None and track.posed:
            colour = CAMERA_RGB if colours is None else colours[position]
            nodes.append(frustum(server, f"/path/cameras/{position}", pose, camera, colour))
    return nodes


def frustum(
    server: Any, name: str, T_view_cam: Matrix, camera: Camera, rgb: tuple[int, int, int], image: Image | None = None
) -> Any:
    """Draw a camera; with an image it is larger."""
    fov, aspect = field_of_view(camera)
    scale = CAMERA_M if image is None else IMAGE_M
    look = {"scale": scale, "thickness": 1.5, "thickness_units": "screen", "color": rgb, "jpeg_quality": 85}
    place = {"wxyz": quaternion(T_view_cam), "position": T_view_cam[:3, 3]}
    return server.scene.add_camera_frustum(name, fov, aspect, image=image, cast_shadow=False, **look, **place)


def cloud(server: Any, name: str, points: Cloud, size_m: float) -> Any:
    """Draw a cloud of points of a size, metres; returns its node."""
    return server.scene.add_point_cloud(
        name,
        points.xyz_m,
        points.rgb,
        point_size=size_m,
        point_shape="circle",
        point_shading="flat",
        precision="float32",
    )
