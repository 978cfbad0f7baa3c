"""A moment for training: one crop of a real or rendered frame, with all that the three kinds of network learn from it.

    moment.pair()     for stereo networks
    moment.scene()    for completion
    moment.view()     for mono

A pack of crops (crop_pack.py) holds moments, so that the images travel once and not once a network.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from priors import geometry
from priors.adapt.views import SKY, SURFACE, UNKNOWN, LabelledView
from priors.errors import DataError
from priors.geometry import convert_disparity
from priors.learn.lidar_scene import TRUTH_REACH_M, LidarScene, Points, pixels
from priors.learn.stereo_pair import StereoPair
from priors.pairs.rectification import NONE, RectificationError
from priors.types import Camera, FloatMap, Image, Mask, Matrix

STREET = "street"
"""Source of the rendered moments, whose truth is dense and exact."""


@dataclass(frozen=True, slots=True)
class Scan:
    """What the LiDAR of a moment saw."""

    points_m: Points
    """(n, 3) own points in the camera's axes, inside the image."""
    beam: npt.NDArray[np.uint8]
    """(n,) scan line, 0 = the highest."""
    T_cam_lidar: Matrix
    accumulated_m: Mapping[int, FloatMap] = field(default_factory=dict)
    """Maps (h, w) that the lidar method makes of so many sweeps, metres, 0 = none."""


@dataclass(frozen=True, slots=True)
class Moment:
    """A crop and what is known of it; all maps are of the left view."""

    source: str
    name: str
    left: Image
    """(h, w, 3) RGB or (h, w) grey, uint8."""
    right: Image | None
    """The same shape; None: there is one eye."""
    camera: Camera
    """The left one, of the crop."""
    baseline_m: float
    true_px: FloatMap
    """(h, w) true disparity as the images have it, 0 = not known. Without a right view: what such a pair would have."""
    matched_px: FloatMap
    """(h, w) the classical match where the truth is not known, 0 = none."""
    matched_weight: float
    """How far to trust the match."""
    sky: Mask
    """(h, w)."""
    error: RectificationError = NONE
    """What turns the disparities of the images into those that the calibration promises."""
    scan: Scan | None = None

    def pair(self) -> StereoPair:
        """Return the stereo pair; DataError where there is one eye."""
        if self.right is None:
            raise DataError(f"{self.source} {self.name}: one eye is no stereo pair")
        true = self.true_px > 0
        disparity_px = np.where(true, self.true_px, self.matched_px)
        weight = np.where(self.matched_px > 0, np.float32(self.matched_weight), np.float32(0))
        weight[true | self.sky] = 1
        return StereoPair(self.left, self.right, disparity_px, self.sky, weight, self.source)

    def scene(self) -> LidarScene:
        """Return the LiDAR scene; DataError where there is no sweep."""
        if self.scan is None:
            raise DataError(f"{self.source} {self.name}: no sweep to learn completion from")
        scan, real, truth_m = self.scan, self.source != STREET, self._depth_m(self.true_px)
        if not real:
            truth_m = np.where(truth_m < TRUTH_REACH_M, truth_m, np.float32(0))
        image = self.left if self.left.ndim == 3 else np.repeat(self.left[..., None], 3, axis=2)
        known = LidarScene(image, self.camera, scan.T_cam_lidar, scan.points_m, scan.beam, truth_m, real)
        return replace(known, accumulated_m=scan.accumulated_m, source=self.source)

    def view(self) -> LabelledView:
        """Return the single view: true depth, and where a moment has no truth at all, that of its match."""
        depth_m = self._depth_m(self.true_px if np.any(self.true_px) else self.matched_px)
        unseen = SURFACE if self.source == STREET else UNKNOWN
        sky = np.where(self.sky, SKY, np.where(depth_m > 0, SURFACE, unseen)).astype(np.int8)
        return LabelledView(self.left, self.camera, depth_m, sky, self.source)

    def cut(self, top: int, left: int, size: tuple[int, int]) -> "Moment":
        """Cut the same window (height, width) out of everything; disparities stay."""
        window = slice(top, top + size[0]), slice(left, left + size[1])
        camera, scan = geometry.crop(self.camera, top, left, size), self.scan
        if scan is not None:
            inside = pixels(scan.points_m, camera)[1]
            accumulated_m = {count: map_[window] for count, map_ in scan.accumulated_m.items()}
            scan = Scan(scan.points_m[inside], scan.beam[inside], scan.T_cam_lidar, accumulated_m)
        return replace(
            self,
            left=self.left[window],
            right=None if self.right is None else self.right[window],
            camera=camera,
            true_px=self.true_px[window],
            matched_px=self.matched_px[window],
            sky=self.sky[window],
            scan=scan,
        )

    def _depth_m(self, disparity_px: FloatMap) -> FloatMap:
        """Return the depth (h, w), metres, that the calibration promises of disparities in the images, 0 = none."""
        promised_px = np.where(disparity_px > 0, self.error.correct(disparity_px, self.camera), np.float32(0))
        return convert_disparity(np.maximum(promised_px, np.float32(0)), self.camera.fx, self.baseline_m)
