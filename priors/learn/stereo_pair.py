"""Stereo pairs for training: two rectified views, and what is known of their disparity."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from priors import geometry
from priors.errors import DataError
from priors.geometry import mirror_columns
from priors.types import Camera, FloatMap, Image, Mask


@dataclass(frozen=True, slots=True)
class Sensors:
    """The rig of a rendered pair, and what its LiDAR sees."""

    camera: Camera
    """The left one."""
    baseline_m: float
    points_m: npt.NDArray[np.float32]
    """(n, 3) LiDAR points that fall into the left image, in its camera's axes; those behind an edge are among them."""
    beam: npt.NDArray[np.uint8]
    """(n,) the scan line of each point, 0 = the highest."""


@dataclass(frozen=True, slots=True)
class StereoPair:
    """Two views of one moment; all maps are for the left one."""

    left: Image
    """(h, w, 3) RGB or (h, w) grey, uint8."""
    right: Image
    """Same shape."""
    disparity_px: FloatMap
    """(h, w); left x matches right x - disparity; 0 where it is not known, and in the sky."""
    sky: Mask
    """(h, w)."""
    weight: FloatMap
    """(h, w) in [0, 1]: how far to trust the disparity, the sky's 0 too; 0 where it is not known."""
    source: str
    """Where it comes from: street, warped, odometry."""
    sensors: Sensors | None = None
    """Of a rendered pair."""

    @property
    def known(self) -> Mask:
        """Tell where the disparity is the truth, or a label to learn from (h, w)."""
        return self.weight > 0

    @property
    def depth_m(self) -> FloatMap:
        """Return a rendered pair's camera-z depth (h, w), metres; 0 = none. DataError for other pairs."""
        if self.sensors is None:
            raise DataError(f"a pair of {self.source} images has no camera: depth is known of rendered pairs only")
        reach = np.float32(self.sensors.camera.fx * self.sensors.baseline_m)
        safe_px = np.maximum(self.disparity_px, np.float32(1e-6))
        return np.where(self.disparity_px > 0, reach / safe_px, np.float32(0)).astype(np.float32)


def mirror(pair: StereoPair, right_px: FloatMap, right_known: Mask, right_sky: Mask) -> StereoPair:
    """Exchange the views in the mirror: the flipped right view is the new left one.

    Args:
        pair: any pair.
        right_px: (h, w) disparity of the right view: right x matches left x + disparity.
        right_known: (h, w) where it is known.
        right_sky: (h, w).

    Returns:
        The mirrored pair, without sensors.
    """
    weight = mirror_columns(right_known).astype(np.float32)
    left, right = mirror_columns(pair.right), mirror_columns(pair.left)
    disparity_px = mirror_columns(right_px) * weight
    return StereoPair(left, right, disparity_px, mirror_columns(right_sky), weight, pair.source)


def crop(pair: StereoPair, top: int, left: int, size: tuple[int, int]) -> StereoPair:
    """Cut the same window (height, width) out of both views; disparities stay."""
    window = slice(top, top + size[0]), slice(left, left + size[1])
    sensors = pair.sensors
    return replace(
        pair,
        left=pair.left[window],
        right=pair.right[window],
        disparity_px=pair.disparity_px[window],
        sky=pair.sky[window],
        weight=pair.weight[window],
        sensors=sensors and replace(sensors, camera=geometry.crop(sensors.camera, top, left, size)),
    )
