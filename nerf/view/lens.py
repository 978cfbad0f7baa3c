"""Lens: a browser's camera as the field renders it, and a rendered view as the browser shows it."""

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from eval.image import as_uint8
from nerf.types import RenderedView
from priors.draw.colours import colour_depth
from priors.types import Camera, Image, Matrix

FARTHEST_M = 160.0
"""Depth that a browser is given of the sky: viser's depth ends at 167 m."""


def browser_camera(fov: float, aspect: float, pixels: int) -> Camera:
    """Return the camera of a browser's window with about so many pixels, its principal point in the middle.

    Args:
        fov: vertical field of view, radians.
        aspect: the window's width over its height.
        pixels: of the finished picture.
    """
    height = max(1, round(float(np.sqrt(pixels / aspect))))
    width = max(1, round(height * aspect))
    focal_y = height / (2 * np.tan(fov / 2))
    focal_x = width / (2 * np.tan(fov / 2) * aspect)
    K = np.array([[focal_x, 0, (width - 1) / 2], [0, focal_y, (height - 1) / 2], [0, 0, 1]])
    return Camera(K, (height, width))


def browser_pose(wxyz: npt.ArrayLike, place_m: npt.ArrayLike, origin_m: npt.NDArray[np.float64]) -> Matrix:
    """Return T_world_cam (4, 4) of a browser's camera, whose place (3,) is in metres from the view's origin."""
    w, x, y, z = np.asarray(wxyz, dtype=np.float64)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
    pose[:3, 3] = np.asarray(place_m, dtype=np.float64) + origin_m
    return pose


def colours(view: RenderedView, depth: bool) -> Image:
    """Return what is shown of a view: its colour, or its depth in colours."""
    return colour_depth(view.solid().depth_m) if depth else as_uint8(view.rgb)


def hiding_m(view: RenderedView) -> npt.NDArray[np.float32]:
    """Return the depth behind which the browser's own things are hidden: (height, width) metres."""
    solid = view.solid()
    return np.where(solid.valid, np.minimum(solid.depth_m, FARTHEST_M), np.float32(FARTHEST_M)).astype(np.float32)


def show(client: Any, view: RenderedView, depth: bool, hide: bool) -> None:
    """Let a browser show a view behind everything else; with `hide`, its surfaces hide what lies behind them."""
    client.scene.set_background_image(
        colours(view, depth), format="jpeg", jpeg_quality=90, depth=hiding_m(view) if hide else None
    )
    client.flush()
