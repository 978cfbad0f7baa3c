"""A camera, and how it draws Gaussians, as kernels read it: numbers in float32."""

from typing import Any, NamedTuple

import numpy as np

from nerf.gaussians.types import SIDE_REACH, Drawing, Viewpoint


class Lens(NamedTuple):
    """A camera and how it draws, as the kernels read it; float32."""

    right: tuple[np.float32, np.float32, np.float32]
    """The camera's x axis in the scene's frame: the first row of R_cam_world."""
    down: tuple[np.float32, np.float32, np.float32]
    ahead: tuple[np.float32, np.float32, np.float32]
    centre_m: tuple[np.float32, np.float32, np.float32]
    focal: tuple[np.float32, np.float32]
    """fx and fy, pixels."""
    middle: tuple[np.float32, np.float32]
    """cx and cy, pixels."""
    reach_x: tuple[np.float32, np.float32]
    """Least and most x / z of a shape: SIDE_REACH."""
    reach_y: tuple[np.float32, np.float32]
    low_pass_px2: np.float32
    least_alpha: np.float32
    near_m: np.float32
    cap_m: np.float32
    compensate: bool
    size: tuple[int, int]
    """(height, width), pixels."""


def lens_of(viewpoint: Viewpoint, drawing: Drawing) -> Lens:
    """Return a camera as the kernels read it."""
    camera, T = viewpoint.camera, np.asarray(viewpoint.T_world_cam, np.float64)
    (fx, fy), (cx, cy), (h, w) = camera.K[[0, 1], [0, 1]], camera.K[:2, 2], camera.size
    side_x, side_y = (SIDE_REACH - 1) * 0.5 * w / fx, (SIDE_REACH - 1) * 0.5 * h / fy
    reaches = (-cx / fx - side_x, (w - cx) / fx + side_x), (-cy / fy - side_y, (h - cy) / fy + side_y)
    numbers = drawing.low_pass_px2, drawing.least_alpha, drawing.near_m, drawing.cap_m
    values: Any = [*T[:3, :3].T, T[:3, 3], (fx, fy), (cx, cy), *reaches, *numbers]
    values = [np.float32(x) if np.ndim(x) == 0 else tuple(np.float32(y) for y in x) for x in values]
    return Lens._make([*values, drawing.compensate, (h, w)])
