"""A frame's stereo pair: read, checked, and mirrored where the frame's camera is the right one.

Matchers know left cameras only. In the mirror, a right camera is one. Only this file mirrors a frame's pair.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from priors import geometry
from priors.codecs import as_grey
from priors.errors import DataError
from priors.geometry import mirror_columns
from priors.pairs.matching import largest_disparity, quarter_match
from priors.pairs.rectification import RectificationError, compare_with_sweep, fit, usual_error
from priors.types import Camera, FloatMap, Frame, Image, Matrix

Kind = TypeVar("Kind", bound=np.generic)
FEW_MATCHES, MANY_MATCHES = 0.45, 0.55
"""Shares of the pixels that match: in 50 pairs 0.46 to 0.96 as they are, 0.07 to 0.42 with left and right swapped."""


@dataclass(frozen=True, slots=True)
class Pair:
    """Two rectified images of one moment, equal in size, with the camera in question as the left one."""

    left: Image
    """Of the camera in question."""
    right: Image
    mirrored: bool
    """Whether both images are mirrored: the camera in question is the right one in truth."""

    def restore(self, map_: npt.NDArray[Kind]) -> npt.NDArray[Kind]:
        """Turn a map (height, width) of `left` into the view of the camera in question, as it is."""
        return mirror_columns(map_) if self.mirrored else map_

    def match(self, matcher: Callable[[Image, Image], FloatMap]) -> FloatMap:
        """Match by a function of the left and the right image; returns its map in the camera's own view."""
        return self.restore(matcher(self.left, self.right))

    def swapped(self) -> "Pair":
        """Return the same pair with the other camera in question."""
        return Pair(mirror_columns(self.right), mirror_columns(self.left), not self.mirrored)


def mirror_camera(camera: Camera, T_cam_lidar: Matrix) -> tuple[Camera, Matrix]:
    """Return the camera and the LiDAR's place as the mirrored image has them."""
    return geometry.mirror(camera), np.diag([-1.0, 1.0, 1.0, 1.0]) @ T_cam_lidar


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


def read_pair(frame: Frame) -> Pair:
    """Read a frame's pair, grey where one of the two is.

    Raises DataError where an image is missing, is no image, or the two differ in size.
    """
    image, other = frame.image(), frame.other()
    if image.ndim != other.ndim:  # one camera is grey: so is the pair
        image, other = as_grey(image), as_grey(other)
    if image.shape != other.shape:
        sizes = " and ".join("x".join(map(str, (a.shape[1], a.shape[0], *a.shape[2:]))) for a in (image, other))
        raise DataError(f"frame {frame.id}: the two images of the pair are {sizes}: expected equal, resize neither")
    for one in (image, other):
        if one.dtype != np.uint8 or one.size == 0:
            raise DataError(
                f"frame {frame.id}: an image is {one.dtype} {one.shape}: expected uint8 pixels, at least one"
            )
    if frame.side == "left":
        return Pair(image, other, mirrored=False)
    return Pair(mirror_columns(image), mirror_columns(other), mirrored=True)


def find_range(frame: Frame, pair: Pair) -> int:
    """Find how large disparities get in a frame's pair, px.

    Raises DataError where the pair matches the other way round only: left and right are swapped.
    """
    small_px = quarter_match(pair.left, pair.right)
    share = np.mean(small_px > 0)
    if share < FEW_MATCHES:
        share_swapped = np.mean(quarter_match(pair.right, pair.left) > 0)
        if share_swapped > MANY_MATCHES:
            raise DataError(
                f"frame {frame.id}: left and right seem to be swapped: {share:.0%} of the pixels match as they are, "
                f"{share_swapped:.0%} the other way round: check which camera is which"
            )
    return largest_disparity(small_px, pair.left.shape[1])


def measure_rectification(frame: Frame, matcher: Callable[[Image, Image], FloatMap]) -> RectificationError:
    """Measure the pair's rectification error against the frame's own sweep.

    Without a sweep it is what the pairs of the frame's rig usually have.

    Args:
        frame: the frame.
        matcher: makes the left image's disparity (height, width), px, 0 = none, whose error is measured.
    """
    usual = usual_error(frame.rig, frame.camera)
    if frame.T_cam_lidar is None or frame.baseline_m is None or not (frame.has("sweep") and frame.has("other")):
        return usual
    sweep = frame.sweep()
    if sweep is None:
        return usual
    pair = read_pair(frame)
    camera, T_cam_lidar = frame.camera, frame.T_cam_lidar
    if pair.mirrored:
        camera, T_cam_lidar = mirror_camera(camera, T_cam_lidar)
        usual = usual.mirrored()
    matched_px = matcher(pair.left, pair.right)
    error = fit(compare_with_sweep(matched_px, pair.left, camera, frame.baseline_m, sweep, T_cam_lidar), usual)
    return error.mirrored() if pair.mirrored else error
