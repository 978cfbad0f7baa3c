"""Dense depth from sparse LiDAR and one image, without learning.

1. Samples that the camera cannot see (a scanner beside it looks past near edges) are dropped.
2. Every sample gets a plane in inverse depth, fitted to its neighbours: exact for planes in space, which are linear in it.
3. A pixel takes the plane of the sample that is nearest in place and colour, then the average of the planes around
   that agree with it: edges stay where the image has them, and nothing floats between two surfaces.
4. Holes wider than the samples' spacing are filled from the same thing at a quarter of the size, and so on.
"""

from dataclasses import dataclass, field, replace
from typing import Literal, Self, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from priors.errors import DataError
from priors.methods.lidar import Lidar
from priors.types import Camera, Depth, FloatMap, Frame, Image, Matrix

Samples: TypeAlias = tuple[npt.NDArray[np.int32], npt.NDArray[np.int32], npt.NDArray[np.int32], npt.NDArray[np.float32]]

SHRINK = 4  # from one level to the next
LEVELS = 4
BEHIND = np.float32(0.1)  # share of inverse depth by which a covering surface is nearer
LEAST_PARALLAX_PX = np.float32(2)
USUAL_PULL_PX_M = 100.0  # parallax of a scanner on the car's roof, px per 1/m, where its place is not known
RIDGE_PX2 = np.float32(0.3)
SAME_SURFACE, SAME_SURFACE_PER_M = np.float32(0.1), np.float32(0.006)  # neighbours that may tell a sample's slope
AGREE, AGREE_PER_M = np.float32(0.05), np.float32(0.0005)  # planes that are averaged
COLOUR = 2e-4  # cost of a squared 8-bit RGB difference: 70 levels weigh as much as one gap
LARGEST_GAP_PX = 48


@dataclass(frozen=True)
class Completion:
    """Fill a sparse depth map, guided by the image."""

    source: Literal["auto", "velodyne_raw", "lidar"] = "auto"
    """Where the samples come from: the data set's own sparse maps, or the lidar method; auto: the former if there."""
    lidar: Lidar = field(default_factory=lambda: Lidar(sweeps=1))
    """The lidar method's settings, where it is the source."""
    guidance: float = 1.0
    """How much the image's colours decide which sample a pixel follows; 0: only distance does."""
    reach_px: int = 64
    """Pixels farther than this from any sample get no value (the sky, mostly)."""

    def __post_init__(self) -> None:
        if not self.guidance >= 0 or self.reach_px < 0:
            found = f"guidance {self.guidance} and reach-px {self.reach_px}"
            raise DataError(f"completion: expected guidance >= 0 and reach-px >= 0, found {found}")

    def resolve(self, frame: Frame) -> Self:
        """Return the config with the source decided."""
        if self.source != "auto":
            return replace(self, lidar=self.lidar.resolve(frame))
        source: Literal["velodyne_raw", "lidar"] = "velodyne_raw" if frame.has("sparse") else "lidar"
        return replace(self, source=source, lidar=self.lidar.resolve(frame))

    def __call__(self, frame: Frame) -> Depth:
        """Make the dense map (height, width), metres along the camera's z axis, with confidence.

        Raises DataError where the drive has neither sparse maps nor a LiDAR.
        """
        config = self.resolve(frame)
        sparse = frame.sparse() if config.source == "velodyne_raw" else config.lidar(frame)
        return complete(
            sparse.depth_m, frame.image(), frame.camera, frame.T_cam_lidar, self.guidance, reach_px=self.reach_px
        )


def complete(
    sparse_m: FloatMap,
    image: Image,
    camera: Camera,
    T_cam_lidar: Matrix | None = None,
    guidance: float = 1.0,
    reach_px: int = 64,
) -> Depth:
    """Fill a sparse depth map (height, width), metres, 0 (or not finite) = no sample.

    Args:
        sparse_m: any number of samples anywhere; scan lines and random points both work.
        image: (height, width, 3) RGB or (height, width) grey, uint8.
        camera: of both maps.
        T_cam_lidar: where the scanner is, for the test of what the camera sees; None: somewhere on the car's roof.
        guidance: as in Completion.
        reach_px: as in Completion.

    Returns:
        depth_m and confidence (height, width); both 0 farther than reach_px from any sample, so everywhere without one.
    """
    from priors.kernels import samples as kernels

    if sparse_m.shape != image.shape[:2]:
        raise DataError(f"completion: the sparse map is {sparse_m.shape}, the image {image.shape[:2]}: resize neither")
    known = np.where(np.isfinite(sparse_m) & (sparse_m > 0), sparse_m, np.float32(0)).astype(np.float32)
    samples = kernels.gather(known)
    nothing = np.zeros(known.shape, np.float32)
    if len(samples[3]) == 0:
        return Depth(nothing, nothing.copy())
    gap_y, gap_x = _gaps(samples)
    pull = _pull(camera, T_cam_lidar, samples)
    hidden = kernels.seen_through(*samples, pull, round(1.4 * gap_y), round(2.4 * gap_x), BEHIND, LEAST_PARALLAX_PX)
    samples = kernels.keep(*samples, ~hidden)
    guide = np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image
    inverse, confidence = _spread(samples, guide, guidance, LEVELS)
    depth_m = 1 / np.clip(inverse, samples[3].min() * 0.8, samples[3].max() * 1.5)
    near = _near(samples, known.shape, reach_px)
    return Depth(np.where(near, depth_m, np.float32(0)), np.where(near, confidence, np.float32(0)))


def _gaps(samples: Samples) -> tuple[float, float]:
    from priors.kernels.samples import gaps

    row_start, row, column, _ = samples
    down, across = gaps(row_start, row, column, LARGEST_GAP_PX, 1 + len(row) // 500)
    return max(float(down), 1.0), max(float(across), 1.0)


def _pull(camera: Camera, T_cam_lidar: Matrix | None, samples: Samples) -> npt.NDArray[np.float32]:
    """Return the parallax between scanner and camera at every sample, pixels per unit of inverse depth."""
    _, row, column, inverse = samples
    if T_cam_lidar is None:
        return np.full(len(inverse), USUAL_PULL_PX_M * camera.fx / 721, np.float32)
    x, y, z = T_cam_lidar[:3, 3]
    across = camera.K[0, 0] * x - (column - camera.K[0, 2]) * z
    down = camera.K[1, 1] * y - (row - camera.K[1, 2]) * z
    return (np.abs(across) + np.abs(down) + 1e-3).astype(np.float32)


def _spread(samples: Samples, image: Image, guidance: float, levels: int) -> tuple[FloatMap, FloatMap]:
    """Return inverse depth (1/m) and confidence, with holes filled from the coarser levels."""
    from priors.kernels import samples as kernels
    from priors.kernels import spread

    height, width = image.shape[:2]
    row_start, row, column, inverse = samples
    gap_y, gap_x = _gaps(samples)
    reach_y, reach_x = max(int(np.ceil(1.6 * gap_y)), 6), max(int(np.ceil(2.4 * gap_x)), 6)
    tolerance = SAME_SURFACE * inverse + SAME_SURFACE_PER_M
    slope_y, slope_x = kernels.slopes(*samples, reach_y, reach_x, tolerance, RIDGE_PX2)
    runs = int(np.ceil(2 * reach_x / spread.LANES))
    pad = max(reach_y, spread.LANES * (runs + 1) // 2)
    size = (height + 2 * pad, width + 2 * pad)
    guide = np.empty((3, *size), np.uint8)
    for channel in range(3):
        cv2.copyMakeBorder(
            np.ascontiguousarray(image[..., channel]), pad, pad, pad, pad, cv2.BORDER_REPLICATE, dst=guide[channel]
        )
    cost = np.full(size, np.inf, np.float32)
    value, total, top, bottom = (np.zeros(size, np.float32) for _ in range(4))
    planes = (row + pad, column + pad, inverse, slope_y, slope_x, guide, reach_y, runs)
    scale = tuple(np.float32(number) for number in (1 / (1.6 * gap_y) ** 2, 1 / (2.4 * gap_x) ** 2, guidance * COLOUR))
    spread.choose(*planes, *scale, cost, value, total)
    spread.blend(*planes, *scale, value, np.float32(1 / (0.03 * np.median(inverse))), top, bottom)
    inside = (slice(pad, -pad), slice(pad, -pad))
    dense = top[inside] / np.maximum(bottom[inside], 1e-20)
    confidence = bottom[inside] / np.maximum(total[inside], 1e-20) / (1 + cost[inside])
    hole = np.isinf(cost[inside])
    if levels > 1 and hole.any():
        small = cv2.resize(image, None, fx=1 / SHRINK, fy=1 / SHRINK, interpolation=cv2.INTER_AREA)
        coarse, sure = _spread(_thin(samples, small.shape[:2]), small, guidance, levels - 1)
        dense[hole] = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)[hole]
        confidence[hole] = 0.5 * cv2.resize(sure, (width, height), interpolation=cv2.INTER_LINEAR)[hole]
    return dense, confidence


def _thin(samples: Samples, size: tuple[int, int]) -> Samples:
    """Return the samples of the smaller map: the nearest one in every cell."""
    from priors.kernels.samples import gather

    _, row, column, inverse = samples
    cell = np.minimum(row // SHRINK, size[0] - 1), np.minimum(column // SHRINK, size[1] - 1)
    largest = np.zeros(size, np.float32)
    np.maximum.at(largest, cell, inverse)
    with np.errstate(divide="ignore"):
        depth_m = np.where(largest > 0, 1 / largest, np.float32(0))
    return gather(depth_m)


def _near(samples: Samples, size: tuple[int, int], reach_px: int) -> npt.NDArray[np.bool_]:
    away = np.ones(size, np.uint8)
    away[samples[1], samples[2]] = 0
    return cv2.distanceTransform(away, cv2.DIST_L2, 3) <= reach_px
