"""Depth completion without learning: samples that carry planes, spread to the pixels that look like them.

1. Samples that the camera cannot see (a scanner beside it looks past near edges) are dropped, and doubtful ones
   handicapped.
2. Every sample gets a plane in inverse depth, fitted to its neighbours: a plane in space is one in inverse depth.
3. A pixel takes the plane of the sample that is nearest in place and brightness, then the average of the planes around
   that agree with it: edges stay where the image has them.
4. Holes wider than the samples' spacing are filled from the same thing at a sixth of the size, and so on.
5. A 5x5 median and a 3x3 blur of inverse depth clean up what is left.

All lengths are in units of the samples' own spacing, so that 64 lines, 8 lines and random points work alike.
"""

import threading
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from priors.codecs import as_grey
from priors.errors import DataError
from priors.types import Camera, Depth, FloatMap, Image, Mask, Matrix

if TYPE_CHECKING:  # keeps the kernels out of --help
    from priors.kernels.sparse_samples import SparseSamples

SHRINK, LEVELS = 6, 3  # from one level to the next, and how many: the coarsest cell is 36 pixels
EVERYWHERE_PX = 1 << 20  # as reach_px: a value in every pixel
CELL_PX = 4  # grid of the tests that need no pixel's precision
LARGEST_GAP_PX = 48  # spacing beyond which the coarser levels do the filling
BEHIND = 1.1  # ratio of depths from which on two samples are of different surfaces
COVERED = 0.5  # samples that are more likely covered than this are dropped
DOUBT = 0.45  # cost of a sample per likelihood of being covered
FARNESS = 0.2  # cost per e-fold of depth: in doubt the near surface covers the far one
SAME_SURFACE, SAME_SURFACE_PER_M = np.float32(0.07), np.float32(0.004)  # neighbours that tell a sample's slope
RIDGE_PX2 = np.float32(1)  # holds slopes that no neighbour tells
SHARE = 3  # how many samples in a row may have one slope
AGREE, AGREE_PER_M = np.float32(0.05), np.float32(0.0005)  # planes that are averaged
FAR_Y, FAR_X = 1.6, 2.4  # gaps down and across that cost 1; scan lines are denser across than down
CONTRAST = 6e-4  # cost of a squared 8-bit grey difference: 41 levels cost 1
EDGE = np.float32(30)  # confidence halves where the blur moves a value by 1/30 of itself
UNSUPPORTED = np.float32(0.01)  # certainty where even the coarsest level has no sample


def complete(
    sparse_m: FloatMap,
    image: Image,
    camera: Camera,
    T_cam_lidar: Matrix | None = None,
    guidance: float = 1.0,
    reach_px: int = 64,
) -> Depth:
    """Fill a sparse depth map (height, width), metres; what is not in 1 mm .. 10 km is no sample.

    Args:
        sparse_m: any number of samples anywhere; scan lines and random points both work.
        image: (height, width, 3) RGB or (height, width) grey, uint8.
        camera: of both.
        T_cam_lidar: where the scanner was, to find what it saw and the camera cannot; None: the camera sees all.
        guidance: as in Completion.
        reach_px: as in Completion.

    Returns:
        depth_m and confidence (height, width), both 0 farther than reach_px from any sample (so everywhere if there
        is none). Values stay between 0.8 times the nearest sample's and 1.25 times the farthest's.

    Raises DataError where the sizes differ.
    """
    if sparse_m.shape != image.shape[:2]:
        raise DataError(f"completion: sparse map {sparse_m.shape} and image {image.shape[:2]} differ in size")
    samples = list_samples(sparse_m)
    if not len(samples.inverse):
        return Depth(np.zeros(sparse_m.shape, np.float32), np.zeros(sparse_m.shape, np.float32))
    doubt = np.zeros(len(samples.inverse), np.float32)
    if T_cam_lidar is not None:
        samples, doubt = _drop_covered(samples, camera, T_cam_lidar)
    grey = as_grey(image)
    filled = _fill(samples, doubt, grey, np.float32(guidance * CONTRAST), LEVELS)
    return _finish(samples, filled, reach_px, grey.shape)


def list_samples(sparse_m: FloatMap) -> "SparseSamples":
    """List the samples of a sparse depth map (height, width), metres."""
    from priors.kernels import sparse_samples as kernels

    return kernels.list_samples(np.ascontiguousarray(sparse_m, dtype=np.float32))


def clean_map(samples: "SparseSamples", size: tuple[int, ...]) -> FloatMap:
    """Return samples as a sparse depth map (height, width), metres."""
    sparse_m = np.zeros(size, np.float32)
    sparse_m[samples.row, samples.column] = 1 / samples.inverse
    return sparse_m


def inverse_limits(samples: "SparseSamples") -> tuple[np.float32, np.float32]:
    """Return the least and the largest inverse depth (1/m) that may come out."""
    return np.float32(samples.inverse.min() * 0.8), np.float32(samples.inverse.max() * 1.25)


def near_samples(samples: "SparseSamples", size: tuple[int, ...], reach_px: int) -> Mask:
    """Tell which pixels (height, width) are within reach_px (to within 4) of a sample."""
    return _near(samples, size, reach_px)[: size[0], : size[1]] > 0


class _Filled(NamedTuple):
    """A level that is filled, with a border on all sides."""

    inverse: FloatMap
    """Inverse depth, 1/m."""
    certain: FloatMap
    """How certain it is."""
    pad: int
    """Width of the border, pixels."""


def _drop_covered(samples: "SparseSamples", camera: Camera, T_cam_lidar: Matrix) -> tuple["SparseSamples", FloatMap]:
    """Return the samples that the camera sees, and the doubt about each."""
    from priors.kernels import sparse_samples as kernels

    gap_y, gap_x = _gaps(samples)
    x, y, z = T_cam_lidar[:3, 3]
    pull_y = camera.K[1, 1] * y - (samples.row - camera.K[1, 2]) * z
    pull_x = camera.K[0, 0] * x - (samples.column - camera.K[0, 2]) * z
    reach_y, reach_x = round(1.4 * gap_y), round(2.4 * gap_x)
    cells_m = _thin(samples, camera.size, CELL_PX)
    window = np.ones((2 * -(-reach_y // CELL_PX) + 1, 2 * -(-reach_x // CELL_PX) + 1), np.uint8)
    with np.errstate(divide="ignore"):
        nearest = cv2.dilate(np.where(cells_m > 0, 1 / cells_m, np.float32(0)), window)
    pulls = pull_y.astype(np.float32), pull_x.astype(np.float32)
    likely = kernels.covered(*samples, *pulls, 1.2 * gap_y, 1.5 * gap_x, reach_y, reach_x, BEHIND, nearest, CELL_PX)
    visible = likely < COVERED
    return kernels.keep(*samples, visible), likely[visible]


def _gaps(samples: "SparseSamples") -> tuple[float, float]:
    """Return the samples' spacing down and across, pixels, 1 or more."""
    from priors.kernels.sparse_samples import gaps

    down, across = gaps(samples.row_start, samples.row, samples.column, LARGEST_GAP_PX, 1 + len(samples.row) // 300)
    return max(down, 1.0), max(across, 1.0)


def _fill(samples: "SparseSamples", doubt: FloatMap, image: Image, contrast: np.float32, levels: int) -> _Filled:
    """Spread the samples over a grey image; holes are filled from the next coarser level."""
    from priors.kernels import plane_propagation as propagation
    from priors.kernels import sparse_samples as kernels

    inverse = samples.inverse
    gap_y, gap_x = _gaps(samples)
    reach_y, reach_x = max(round(1.15 * gap_y), 3), max(round(2 * gap_x), 3)
    runs = -(-2 * reach_x // propagation.LANES)
    pad = max(reach_y, propagation.LANES * runs // 2)
    guide = cv2.copyMakeBorder(image, pad, pad, pad, pad, cv2.BORDER_REPLICATE)
    work = _SCRATCH.hold(f"level {levels}", (4, *guide.shape))
    cost, value, top, bottom = work
    cost.fill(propagation.NOTHING)
    work[2:].fill(0)
    place = samples.row + pad, samples.column + pad, inverse
    tolerance = SAME_SURFACE * inverse + SAME_SURFACE_PER_M
    window = max(round(1.3 * gap_y), 3), max(round(1.3 * gap_x), 3)
    slopes = kernels.slopes(*samples, *window, tolerance, RIDGE_PX2, SHARE)
    handicap = np.float32(DOUBT) * doubt - np.float32(FARNESS) * np.log(inverse)
    planes = (*place, *slopes, handicap - handicap.min(), reach_y, runs)
    scale = np.float32(1 / (FAR_Y * gap_y) ** 2), np.float32(1 / (FAR_X * gap_x) ** 2)
    propagation.assign(*planes, *scale, guide, contrast, cost, value)
    propagation.average(*planes, *scale, value, AGREE, AGREE_PER_M, top, bottom)
    coarse = _fill_coarsely(samples, image, contrast, levels - 1)
    propagation.fill_holes(cost, top, bottom, pad, coarse.inverse, coarse.certain, coarse.pad, SHRINK)
    return _Filled(top, cost, pad)


def _fill_coarsely(samples: "SparseSamples", image: Image, contrast: np.float32, levels: int) -> _Filled:
    """Fill a sixth of the size by so many levels; where none is left, everything is the samples' median."""
    if levels < 1:
        return _Filled(np.full((1, 1), np.median(samples.inverse), np.float32), np.full((1, 1), UNSUPPORTED), 0)
    size = _smaller(image.shape, SHRINK)
    small = np.asarray(cv2.resize(image, size[::-1], interpolation=cv2.INTER_NEAREST), np.uint8)
    thinned = list_samples(_thin(samples, image.shape, SHRINK))
    return _fill(thinned, np.zeros_like(thinned.inverse), small, contrast, levels)


def _finish(samples: "SparseSamples", filled: _Filled, reach_px: int, size: tuple[int, ...]) -> Depth:
    """Clean the inverse depth up and turn it into depth with confidence (height, width)."""
    from priors.kernels import plane_propagation as propagation

    depth_m, confidence = np.empty(size, np.float32), np.empty(size, np.float32)
    crisp, soft = _SCRATCH.hold("finish", (2, *size))
    pad = filled.pad
    cv2.medianBlur(filled.inverse[pad : pad + size[0], pad : pad + size[1]], 5, dst=crisp)
    cv2.GaussianBlur(crisp, (3, 3), 0, dst=soft)
    near = _near(samples, size, reach_px)
    propagation.to_depth(crisp, soft, filled.certain, pad, near, *inverse_limits(samples), EDGE, depth_m, confidence)
    return Depth(depth_m, confidence)


def _near(samples: "SparseSamples", size: tuple[int, ...], reach_px: int) -> npt.NDArray[np.uint8]:
    """Return 1 near a sample, else 0; up to CELL_PX - 1 rows and columns larger than size."""
    empty = _thin(samples, size, CELL_PX) == 0
    within = (CELL_PX * cv2.distanceTransform(empty.astype(np.uint8), cv2.DIST_L2, 3) <= reach_px).astype(np.uint8)
    near = cv2.resize(within, None, fx=CELL_PX, fy=CELL_PX, interpolation=cv2.INTER_NEAREST)
    return np.asarray(near, np.uint8)


def _thin(samples: "SparseSamples", size: tuple[int, ...], step: int) -> FloatMap:
    """Return the sparse map that is step times smaller, metres: the nearest sample in every cell."""
    from priors.kernels.sparse_samples import downsample

    return downsample(samples.row, samples.column, samples.inverse, step, *_smaller(size, step))


def _smaller(size: tuple[int, ...], step: int) -> tuple[int, int]:
    return -(-size[0] // step), -(-size[1] // step)


class _Scratch(threading.local):
    """Work memory of each thread, kept between frames: fresh pages cost as much as filling them."""

    def __init__(self) -> None:
        self.arrays: dict[str, FloatMap] = {}

    def hold(self, name: str, shape: tuple[int, ...]) -> FloatMap:
        """Return this thread's memory of that name, contents unknown; it grows as needed."""
        size = int(np.prod(shape))
        held = self.arrays.get(name)
        if held is None or held.size < size:
            held = self.arrays[name] = np.empty(size, np.float32)
        return held[:size].reshape(shape)


_SCRATCH = _Scratch()
