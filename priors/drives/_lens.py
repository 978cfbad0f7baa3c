"""Lenses: cameras that bend straight lines, straightened once when an image is read (OpenCV).

The image keeps its size. The new camera shows what the old one showed but for the border that bends inwards, so that
every pixel has a colour. The optical axis stays, so a depth along it stays what it was: maps are only moved.
"""

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from priors.types import Camera, FloatMap, Image, Matrix

Maps = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]
KEPT = 4
"""Lenses whose tables are kept: 3.7 MB each for an image of KITTI's size."""


@dataclass(frozen=True)
class Lens:
    """A camera as it was calibrated."""

    focal_px: tuple[float, float]
    """Along x and y, pixels."""
    centre_px: tuple[float, float]
    """Principal point, pixels; the centre of the top-left pixel is (0, 0)."""
    size: tuple[int, int]
    """(height, width), pixels."""
    distortion: tuple[float, ...] = ()
    """OpenCV's k1 k2 p1 p2 [k3 [k4 k5 k6]] (Brown, 1971; the last three divide); empty or zeros: none."""

    @property
    def K(self) -> Matrix:
        """Return the calibrated (3, 3), pixels."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])

    @property
    def bends(self) -> bool:
        """Tell whether images must be straightened."""
        return any(self.distortion)

    @property
    def camera(self) -> Camera:
        """Return the camera of the straightened images."""
        return Camera(_straight(self) if self.bends else self.K, self.size)

    def straighten(self, image: Image) -> Image:
        """Straighten an image of the lens; what lies between pixels is blended."""
        return np.asarray(cv2.remap(image, *_tables(self), cv2.INTER_LINEAR)) if self.bends else image

    def straighten_map(self, depth_m: FloatMap) -> FloatMap:
        """Straighten a depth map; values are moved, never blended across an edge."""
        moved = cv2.remap(depth_m, *_tables(self), cv2.INTER_NEAREST) if self.bends else depth_m
        return np.asarray(moved, np.float32)

    def describe(self) -> str:
        """Say what was done, in a line."""
        (fx, fy), (cx, cy), K = self.focal_px, self.centre_px, self.camera.K
        before = f"fx {fx:.1f}, fy {fy:.1f}, centre ({cx:.1f}, {cy:.1f})"
        after = f"fx {K[0, 0]:.1f}, fy {K[1, 1]:.1f}, centre ({K[0, 2]:.1f}, {K[1, 2]:.1f})"
        return f"the lens bends lines: images are straightened when they are read: {before} px became {after} px"


@cache
def _straight(lens: Lens) -> Matrix:
    size = lens.size[::-1]
    K, _ = cv2.getOptimalNewCameraMatrix(lens.K, np.array(lens.distortion), size, alpha=0)
    return np.asarray(K, np.float64)


@lru_cache(maxsize=KEPT)
def _tables(lens: Lens) -> Maps:
    found: Any = cv2.initUndistortRectifyMap(
        lens.K, np.array(lens.distortion), np.eye(3), _straight(lens), lens.size[::-1], cv2.CV_32FC1
    )
    return found[0], found[1]
