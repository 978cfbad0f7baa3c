"""Cloud: coloured points of one frame, few enough for a browser, in the view's own frame (float32, near its origin)."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from priors.codecs import as_rgb
from priors.draw.colours import colour_confidence, colour_depth, colour_error
from priors.errors import DataError
from priors.geometry import rays
from priors.types import Camera, Depth, Frame, Image, Mask, Matrix

Colouring: TypeAlias = Literal["image", "depth", "error", "confidence"]
"""What the colour of a point tells."""
SWEEP_RGB = (255, 170, 40)
LIGHT_M, LIGHT = (-2.0, 2.0), (0.3, 1.0)
"""Heights from the LiDAR, metres, between which its points become brighter, and how bright they are."""


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points and their colours."""

    xyz_m: npt.NDArray[np.float32]
    """(n, 3) metres from the view's origin."""
    rgb: npt.NDArray[np.uint8]
    """(n, 3)"""
    whole: int
    """How many points there were before they were thinned."""

    def __len__(self) -> int:
        return len(self.xyz_m)


def empty() -> Cloud:
    """Return a cloud without points."""
    return Cloud(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), 0)


def join(clouds: list[Cloud]) -> Cloud:
    """Put clouds together."""
    if not clouds:
        return empty()
    xyz_m = np.concatenate([cloud.xyz_m for cloud in clouds])
    return Cloud(xyz_m, np.concatenate([cloud.rgb for cloud in clouds]), sum(cloud.whole for cloud in clouds))


def paint(frame: Frame, depth: Depth, colouring: Colouring) -> tuple[Image, Mask]:
    """Colour a map's pixels: (height, width, 3), and where there is a colour: (height, width).

    Raises:
        DataError: the frame has no image or no truth, or the map no confidence, to colour by; or sizes differ.
    """
    where = depth.valid
    if colouring == "image":
        picture = as_rgb(frame.image())
    elif colouring == "depth":
        picture = colour_depth(depth.depth_m)
    elif colouring == "confidence":
        picture = colour_confidence(depth.trust(), where)
    else:
        truth = frame.truth()
        _expect_size(frame, truth.depth_m.shape, depth.depth_m.shape)
        picture, where = colour_error(depth.depth_m, truth.depth_m), where & truth.valid
    _expect_size(frame, picture.shape, depth.depth_m.shape)
    return picture, where


def sure_and_near(depth: Depth, least_confidence: float, farthest_m: float) -> Mask:
    """Tell which pixels (height, width) are so sure and so near; a map without confidence is sure everywhere."""
    kept = depth.valid & (depth.depth_m <= farthest_m)
    return kept if depth.confidence is None else kept & (depth.confidence >= least_confidence)


def back_project(camera: Camera, depth: Depth, kept: Mask, picture: Image, T_view_cam: Matrix, most: int) -> Cloud:
    """Turn the kept pixels of a depth map into points, thinned evenly to at most `most`.

    Args:
        camera: of the map.
        depth: the map.
        kept: (height, width), which pixels to take.
        picture: (height, width, 3), their colours.
        T_view_cam: (4, 4) camera to the view's frame, metres.
        most: largest number of points, 1 or more.
    """
    _expect_camera(camera, depth)
    places = np.flatnonzero(kept)
    taken = places[:: max(1, -(-len(places) // most))]
    xyz_cam = rays(camera).reshape(-1, 3)[taken] * depth.depth_m.reshape(-1)[taken, None]
    xyz_m = xyz_cam @ T_view_cam[:3, :3].T + T_view_cam[:3, 3]
    return Cloud(xyz_m.astype(np.float32), picture.reshape(-1, 3)[taken], len(places))


def place(sweep_m: npt.NDArray[np.floating], T_view_lidar: Matrix, most: int) -> Cloud:
    """Map a sweep (n, 3), metres, z up, into the view's frame, thinned evenly to at most `most` points.

    Points are orange, the higher the brighter: one colour alone would show no shape.
    """
    finite = np.flatnonzero(np.isfinite(sweep_m).all(axis=1))
    taken = sweep_m[finite[:: max(1, -(-len(finite) // most))]].astype(np.float64)
    xyz_m = (taken @ T_view_lidar[:3, :3].T + T_view_lidar[:3, 3]).astype(np.float32)
    light = np.interp(taken[:, 2], LIGHT_M, LIGHT)
    return Cloud(xyz_m, np.rint(light[:, None] * np.array(SWEEP_RGB)).astype(np.uint8), len(finite))


def _expect_size(frame: Frame, found: tuple[int, ...], wanted: tuple[int, ...]) -> None:
    if tuple(found[:2]) != tuple(wanted[:2]):
        raise DataError(f"frame {frame.id}: the map is {wanted[1]}x{wanted[0]}, what colours it {found[1]}x{found[0]}")


def _expect_camera(camera: Camera, depth: Depth) -> None:
    if depth.depth_m.shape != camera.size:
        (height, width), (rows, columns) = depth.depth_m.shape, camera.size
        raise DataError(f"the map is {width}x{height}, the camera {columns}x{rows}: build the prior again")
