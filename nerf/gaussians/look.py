"""Look: a training frame as the start sees it, a dense map of surfaces with normals and what is not to be used."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from nerf.scene import Scene
from nerf.warp.fill import fill
from priors.geometry import rays
from priors.sky import sky_mask
from priors.types import Camera, Matrix

Floats = npt.NDArray[np.float32]
Flags = npt.NDArray[np.bool_]

FARTHEST_M = 180.0
"""What is farther belongs to the coarse layer, metres."""
EDGE = np.float32(0.12)
"""A value with others in its 3x3 that are nearer and farther by this share lies between two surfaces."""
NEAR_PX = 6.0
"""What lies no farther from a pixel with a value is filled in from around; the rest is the coarse layer's."""
FILLED_TRUST = np.float32(0.05)
"""How much a depth counts that was filled in."""
SMOOTH_PX = 5
"""Window of the median before normals are taken."""


@dataclass(frozen=True)
class Look:
    """A frame's surfaces."""

    T_world_cam: Matrix
    camera: Camera
    image: npt.NDArray[np.uint8]
    """(h, w, 3)"""
    depth_m: Floats
    """(h, w) camera-z depth of every pixel, metres; what the prior lacks is filled in from around."""
    trust: Floats
    """(h, w) how much it counts, [0, 1]; 0: it is filled in from afar."""
    usable: Flags
    """(h, w) whether a surface may stand there: no sky, not between two surfaces."""
    sky: Flags
    """(h, w)"""

    @property
    def nbytes(self) -> int:
        """How much memory it takes, with its normals."""
        return self.image.nbytes + 5 * self.depth_m.nbytes + 2 * self.sky.nbytes

    @cached_property
    def normals(self) -> Floats:
        """(h, w, 3) unit normals of the smoothed depth in the camera's frame, towards it."""
        smooth = cv2.medianBlur(self.depth_m, SMOOTH_PX)
        points = rays(self.camera).astype(np.float32) * smooth[..., None]
        edge = cv2.BORDER_REPLICATE  # mirrored, the derivative across the image's edge would be 0
        across, down = (cv2.Sobel(points, cv2.CV_32F, *order, ksize=3, borderType=edge) for order in ((1, 0), (0, 1)))
        normal = np.cross(down, across)  # x right, y down, z forward: towards the camera
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        facing = points / np.linalg.norm(points, axis=-1, keepdims=True)
        return np.where(length > 0, normal / np.maximum(length, 1e-20), -facing).astype(np.float32)


def look_at(scene: Scene, position: int) -> Look:
    """Prepare a frame; without a value everything is filled in, with a trust of 0."""
    image = np.asarray(scene.images[position])
    depth_m = np.zeros(scene.camera.size, np.float32) if scene.depth_m is None else np.asarray(scene.depth_m[position])
    known = np.isfinite(depth_m) & (depth_m > 0)
    inverse = np.divide(np.float32(1), depth_m, out=np.zeros_like(depth_m), where=known)
    sky = sky_mask(image) & ~known if scene.sky is None else np.asarray(scene.sky[position]) > 0
    if not known.any():
        known, inverse = sky, np.full_like(inverse, 1 / FARTHEST_M)
        trust = np.zeros_like(depth_m)
    else:
        weight = np.float32(1) if scene.weight is None else scene.weight[position] / np.float32(255)
        near = cv2.distanceTransform((~known).astype(np.uint8), cv2.DIST_L2, 3) <= NEAR_PX
        trust = np.where(known, np.maximum(weight, FILLED_TRUST), np.where(near, FILLED_TRUST, 0)).astype(np.float32)
    depth_m = (1 / np.maximum(fill(inverse, known), np.float32(1e-4))).astype(np.float32)
    usable = ~sky & ~between_surfaces(depth_m) & (depth_m < FARTHEST_M)
    return Look(scene.T_world_cam[position], scene.camera, image, depth_m, trust, usable, sky)


def between_surfaces(depth_m: Floats) -> Flags:
    """Tell which pixels (h, w) have neighbours that are clearly nearer and others that are clearly farther."""
    around = np.ones((3, 3), np.uint8)
    low, high = cv2.erode(depth_m, around), cv2.dilate(depth_m, around)
    return np.asarray((low < depth_m * (1 - EDGE)) & (high > depth_m * (1 + EDGE)))
