"""A frame's stereo pair: read with this camera as the left one, checked, and how far its disparities are off."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from priors.errors import DataError
from priors.pairs.matching import largest_disparity, quarter_match
from priors.pairs.offset import Offset, compare, fit_points, usual_offset
from priors.types import Camera, FloatMap, Frame, Image, Matrix

Kind = TypeVar("Kind", bound=np.generic)
FEW, MANY = 0.45, 0.55
"""Shares of the pixels that match: in 50 pairs 0.46 to 0.96 as they are, 0.07 to 0.42 with left and right swapped."""


def baseline(frame: Frame) -> float:
    """Return the pair's baseline in metres, or raise DataError where there is none."""
    if frame.baseline_m is None or not np.isfinite(frame.baseline_m):
        frame.other()  # says why, where the drive knows
        raise DataError(f"frame {frame.id}: the stereo baseline is not known: check the calibration of both cameras")
    if frame.baseline_m <= 0:
        raise DataError(
            f"frame {frame.id}: the stereo baseline is {frame.baseline_m:g} m, expected above 0: "
            "check which camera is the left one"
        )
    return frame.baseline_m


def read_pair(frame: Frame) -> tuple[Image, Image]:
    """Read the pair with this camera as the left one: in the mirror, a right camera is."""
    image, other = frame.image(), frame.other()
    if image.shape != other.shape:
        sizes = " and ".join("x".join(map(str, (a.shape[1], a.shape[0], *a.shape[2:]))) for a in (image, other))
        raise DataError(f"frame {frame.id}: the two images of the pair are {sizes}: expected equal, resize neither")
    for one in (image, other):
        if one.dtype != np.uint8 or one.size == 0:
            raise DataError(
                f"frame {frame.id}: an image is {one.dtype} {one.shape}: expected uint8 pixels, at least one"
            )
    if frame.side == "left":
        return image, other
    return np.ascontiguousarray(image[:, ::-1]), np.ascontiguousarray(other[:, ::-1])


def find_range(frame: Frame, image: Image, other: Image) -> int:
    """Find how large disparities get in a pair as `read_pair` returns it, px.

    Raises DataError where the pair matches the other way round only: left and right are swapped.
    """
    small_px = quarter_match(image, other)
    share = np.mean(small_px > 0)
    if share < FEW:
        swapped = np.mean(quarter_match(other, image) > 0)
        if swapped > MANY:
            raise DataError(
                f"frame {frame.id}: left and right seem to be swapped: {share:.0%} of the pixels match as they are, "
                f"{swapped:.0%} the other way round: check which camera is which"
            )
    return largest_disparity(small_px, image.shape[1])


def calibrate(frame: Frame, match: Callable[[Image, Image], FloatMap]) -> Offset:
    """Measure the pair's offset against the frame's own sweep; without one it is what the rig's pairs usually have.

    match: makes the disparity (height, width), px, 0 = none, that is to be corrected; of `read_pair`'s images.
    """
    usual = usual_offset(frame.rig, frame.camera)
    if frame.T_cam_lidar is None or frame.baseline_m is None or not (frame.has("sweep") and frame.has("other")):
        return usual
    sweep = frame.sweep()
    if sweep is None:
        return usual
    image, other = read_pair(frame)
    camera, T_cam_lidar = frame.camera, frame.T_cam_lidar
    if frame.side == "right":
        camera, T_cam_lidar, usual = *mirror(camera, T_cam_lidar), usual.mirrored()
    points = compare(match(image, other), image, camera, frame.baseline_m, sweep, T_cam_lidar)
    found = fit_points(points, usual)
    return found if frame.side == "left" else found.mirrored()


def mirror(camera: Camera, T_cam_lidar: Matrix) -> tuple[Camera, Matrix]:
    """Return the camera and the LiDAR's place as the horizontally mirrored image has them."""
    K = camera.K.copy()
    K[0, 2] = camera.size[1] - 1 - K[0, 2]
    return Camera(K, camera.size), np.diag([-1.0, 1.0, 1.0, 1.0]) @ T_cam_lidar


def unmirror(frame: Frame, map_: npt.NDArray[Kind]) -> npt.NDArray[Kind]:
    """Turn a map made from `read_pair` back into the frame's own view."""
    return map_ if frame.side == "left" else np.ascontiguousarray(map_[:, ::-1])
