"""Dense depth from sparse LiDAR and one image: without learning, or mended by a network (_completion_network.py).

Without learning:

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
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal, Self

import cv2
import numpy as np
import numpy.typing as npt

from priors.errors import DataError
from priors.machine import threads
from priors.methods.lidar import Lidar
from priors.sky import doubt, sky_mask
from priors.types import Camera, Depth, FloatMap, Frame, Image, Mask, Matrix

if TYPE_CHECKING:
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
_HELD = threading.local()  # work memory, kept between frames: fresh pages cost as much as filling them


@dataclass(frozen=True)
class Completion:
    """Fill a sparse depth map, guided by the image."""

    source: Literal["auto", "velodyne_raw", "lidar"] = "auto"
    """Where the samples come from: the data set's own sparse maps, or the lidar method; auto: the former if there."""
    lidar: Lidar = field(default_factory=Lidar)
    """The lidar method's settings, where it is the source."""
    guidance: float = 1.0
    """How much the image's brightness decides which sample a pixel follows; 0: only distance does."""
    reach_px: int = 64
    """Pixels farther than this from any sample (to within 4) get no value: the sky, mostly."""
    model: Literal["classical", "mffnet"] = "classical"
    """classical: no learning; mffnet: a network mends what that fills, and says how sure it is."""
    size: Literal["s", "m"] = "s"
    """Of the network: small is faster."""
    runtime: Literal["auto", "bf16", "fp32", "cuda", "onnx"] = "auto"
    """What runs the network; auto: CUDA where there is one, else what a table says is fastest on this CPU."""
    weights: Path | None = None
    """Your own weights for the network, .safetensors; default: those that come with the package."""

    VERSION: ClassVar[int] = 0 + Lidar.VERSION
    """Raised with lidar's, whose maps it fills: a sum, so that either makes a new one."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.guidance) and self.guidance >= 0 and self.reach_px >= 0):
            found = f"guidance {self.guidance} and reach-px {self.reach_px}"
            raise DataError(f"completion: expected guidance >= 0 and reach-px >= 0, found {found}")
        if self.model == "classical" and self.weights is not None:
            raise DataError(f"--completion.weights {self.weights}: of a network: ask for it by --completion.model")

    @property
    def reads(self) -> tuple[str, ...]:
        """Return what a frame must have."""
        return ("image", "sparse" if self.source == "velodyne_raw" else "sweep")

    @threads.limited(None)
    def resolve(self, frame: Frame) -> Self:
        """Return the config with the source decided."""
        source = self.source
        if source == "auto":
            source = "velodyne_raw" if frame.has("sparse") else "lidar"
        resolved = replace(self, source=source, lidar=self.lidar.resolve(frame))
        if self.model == "classical":
            return replace(resolved, size=type(self).size, runtime=type(self).runtime)  # they decide nothing
        from priors.nets import runtime

        if self.weights is not None and self.weights.suffix == ".onnx":
            raise DataError(f"{self.weights}: completion runs no ONNX files: name the network's .safetensors")
        return replace(resolved, runtime=runtime.choose_floating(self.runtime, self.weights, self.model))

    def weights_digest(self) -> str | None:
        """Return the hash of the network's weights, for the cache's key; None for the classical method."""
        if self.model == "classical":
            return None
        from priors.nets import weights

        return weights.digest(weights.find(self.model, self.size, self.weights))

    @threads.limited(None)
    def __call__(self, frame: Frame) -> Depth:
        """Make the dense map (height, width), metres along the camera's z axis; the sky's confidence is 0.

        Raises DataError where the drive has neither sparse maps nor a LiDAR, or the network's weights are missing.
        """
        config = self.resolve(frame)
        sparse = frame.sparse() if config.source == "velodyne_raw" else config.lidar(frame)
        # What the lidar method accumulates was seen from many places, and is cleaned of what the camera does not see.
        T_cam_lidar = frame.T_cam_lidar if config.source == "velodyne_raw" else None
        image = frame.image()
        given = sparse.depth_m, image, frame.camera, T_cam_lidar, self.guidance
        found = complete(*given, self.reach_px) if config.model == "classical" else config.mend(*given)
        return doubt(found, sky_mask(image))

    def mend(
        self,
        sparse_m: FloatMap,
        image: Image,
        camera: Camera,
        T_cam_lidar: Matrix | None = None,
        guidance: float = 1.0,
    ) -> Depth:
        """Fill a sparse map as `complete` does, and let the network correct it; where no sample is near, both are 0."""
        from priors.kernels.sparse_samples import list_samples
        from priors.methods import _completion_network as network
        from priors.nets import runtime

        ready = network.open_network(
            self.size, runtime.choose_floating(self.runtime, self.weights, self.model), self.weights
        )
        fill = complete(sparse_m, image, camera, T_cam_lidar, guidance, EVERYWHERE_PX)
        samples = list_samples(np.ascontiguousarray(sparse_m, dtype=np.float32))
        _, row, column, inverse = samples
        if not len(row):
            return fill  # no sample, no value
        clean_m = np.zeros_like(fill.depth_m)
        clean_m[row, column] = 1 / inverse
        near = _near(samples, clean_m.shape, self.reach_px)[: clean_m.shape[0], : clean_m.shape[1]] > 0
        least, largest = _limits(inverse)
        return network.mend(ready, fill, clean_m, image, near, (float(1 / largest), float(1 / least)))


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
    from priors.kernels import sparse_samples as kernels

    if sparse_m.shape != image.shape[:2]:
        raise DataError(f"completion: sparse map {sparse_m.shape} and image {image.shape[:2]} differ in size")
    samples = kernels.list_samples(np.ascontiguousarray(sparse_m, dtype=np.float32))
    if not len(samples[3]):
        return Depth(np.zeros(sparse_m.shape, np.float32), np.zeros(sparse_m.shape, np.float32))
    doubt = np.zeros(len(samples[3]), np.float32)
    if T_cam_lidar is not None:
        samples, doubt = _drop_covered(samples, camera, T_cam_lidar)
    grey: Image = image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
    spread = _spread(samples, doubt, grey, np.float32(guidance * CONTRAST), LEVELS)
    return _finish(samples, *spread, reach_px, grey.shape)


def _drop_covered(samples: "SparseSamples", camera: Camera, T_cam_lidar: Matrix) -> tuple["SparseSamples", FloatMap]:
    """Return the samples that the camera sees, and the doubt about each."""
    from priors.kernels import sparse_samples as kernels

    _, row, column, _ = samples
    gap_y, gap_x = _gaps(samples)
    x, y, z = T_cam_lidar[:3, 3]
    pull_y = camera.K[1, 1] * y - (row - camera.K[1, 2]) * z
    pull_x = camera.K[0, 0] * x - (column - camera.K[0, 2]) * z
    reach_y, reach_x = round(1.4 * gap_y), round(2.4 * gap_x)
    cells_m = _thin(samples, camera.size, CELL_PX)
    window = np.ones((2 * -(-reach_y // CELL_PX) + 1, 2 * -(-reach_x // CELL_PX) + 1), np.uint8)
    with np.errstate(divide="ignore"):
        nearest = cv2.dilate(np.where(cells_m > 0, 1 / cells_m, np.float32(0)), window)
    pulls = pull_y.astype(np.float32), pull_x.astype(np.float32)
    likely = kernels.covered(*samples, *pulls, 1.2 * gap_y, 1.5 * gap_x, reach_y, reach_x, BEHIND, nearest, CELL_PX)
    kept = likely < COVERED
    return kernels.keep(*samples, kept), likely[kept]


def _gaps(samples: "SparseSamples") -> tuple[float, float]:
    from priors.kernels.sparse_samples import gaps

    row_start, row, column, _ = samples
    down, across = gaps(row_start, row, column, LARGEST_GAP_PX, 1 + len(row) // 300)
    return max(down, 1.0), max(across, 1.0)


def _spread(
    samples: "SparseSamples", doubt: FloatMap, image: Image, contrast: np.float32, levels: int
) -> tuple[FloatMap, FloatMap, int]:
    """Return inverse depth (1/m), how certain it is, and by how much both are padded; holes are filled."""
    from priors.kernels import plane_propagation
    from priors.kernels import sparse_samples as kernels

    _, row, column, inverse = samples
    gap_y, gap_x = _gaps(samples)
    reach_y, reach_x = max(round(1.15 * gap_y), 3), max(round(2 * gap_x), 3)
    runs = -(-2 * reach_x // plane_propagation.LANES)
    pad = max(reach_y, plane_propagation.LANES * runs // 2)
    guide = cv2.copyMakeBorder(image, pad, pad, pad, pad, cv2.BORDER_REPLICATE)
    work = _hold(f"level {levels}", (4, *guide.shape))
    cost, value, top, bottom = work
    cost.fill(plane_propagation.NOTHING)
    work[2:].fill(0)
    place = row + pad, column + pad, inverse
    tolerance = SAME_SURFACE * inverse + SAME_SURFACE_PER_M
    window = max(round(1.3 * gap_y), 3), max(round(1.3 * gap_x), 3)
    slopes = kernels.slopes(*samples, *window, tolerance, RIDGE_PX2, SHARE)
    handicap = np.float32(DOUBT) * doubt - np.float32(FARNESS) * np.log(inverse)
    planes = (*place, *slopes, handicap - handicap.min(), reach_y, runs)
    scale = np.float32(1 / (FAR_Y * gap_y) ** 2), np.float32(1 / (FAR_X * gap_x) ** 2)
    plane_propagation.assign(*planes, *scale, guide, contrast, cost, value)
    plane_propagation.average(*planes, *scale, value, AGREE, AGREE_PER_M, top, bottom)
    if levels > 1:
        size = _smaller(image.shape, SHRINK)
        small = np.asarray(cv2.resize(image, size[::-1], interpolation=cv2.INTER_NEAREST), np.uint8)
        thinned = kernels.list_samples(_thin(samples, image.shape, SHRINK))
        coarse = _spread(thinned, np.zeros_like(thinned[3]), small, contrast, levels - 1)
    else:
        coarse = np.full((1, 1), np.median(inverse), np.float32), np.full((1, 1), UNSUPPORTED), 0
    plane_propagation.fill_holes(cost, top, bottom, pad, *coarse, SHRINK)
    return top, cost, pad


def _finish(
    samples: "SparseSamples", inverse: FloatMap, certain: FloatMap, pad: int, reach_px: int, size: tuple[int, ...]
) -> Depth:
    """Clean the inverse depth up and turn it into depth with confidence."""
    from priors.kernels import plane_propagation

    depth_m, confidence = np.empty(size, np.float32), np.empty(size, np.float32)
    crisp, soft = _hold("finish", (2, *size))
    cv2.medianBlur(inverse[pad : pad + size[0], pad : pad + size[1]], 5, dst=crisp)
    cv2.GaussianBlur(crisp, (3, 3), 0, dst=soft)
    near = _near(samples, size, reach_px)
    limits = _limits(samples[3])
    plane_propagation.to_depth(crisp, soft, certain, pad, near, *limits, EDGE, depth_m, confidence)
    return Depth(depth_m, confidence)


def _limits(inverse: FloatMap) -> tuple[np.float32, np.float32]:
    """Return the least and the largest inverse depth (1/m) that may come out."""
    return np.float32(inverse.min() * 0.8), np.float32(inverse.max() * 1.25)


def near_samples(sparse_m: FloatMap, reach_px: int) -> Mask:
    """Tell which pixels (height, width) are within reach_px (to within 4) of a sample."""
    from priors.kernels.sparse_samples import list_samples

    height, width = sparse_m.shape
    near = _near(list_samples(np.ascontiguousarray(sparse_m, dtype=np.float32)), sparse_m.shape, reach_px)
    return near[:height, :width] > 0


def _near(samples: "SparseSamples", size: tuple[int, ...], reach_px: int) -> npt.NDArray[np.uint8]:
    """Return 1 near a sample, else 0; up to CELL_PX - 1 rows and columns larger than size."""
    empty = _thin(samples, size, CELL_PX) == 0
    within = (CELL_PX * cv2.distanceTransform(empty.astype(np.uint8), cv2.DIST_L2, 3) <= reach_px).astype(np.uint8)
    near = cv2.resize(within, None, fx=CELL_PX, fy=CELL_PX, interpolation=cv2.INTER_NEAREST)
    return np.asarray(near, np.uint8)


def _hold(name: str, shape: tuple[int, ...]) -> FloatMap:
    """Return this thread's work memory of that name, contents unknown; it grows as needed."""
    size = int(np.prod(shape))
    held: FloatMap = getattr(_HELD, name, np.empty(0, np.float32))
    if held.size < size:
        held = np.empty(size, np.float32)
        setattr(_HELD, name, held)
    return held[:size].reshape(shape)


def _smaller(size: tuple[int, ...], step: int) -> tuple[int, int]:
    return -(-size[0] // step), -(-size[1] // step)


def _thin(samples: "SparseSamples", size: tuple[int, ...], step: int) -> FloatMap:
    """Return the sparse map that is step times smaller, metres: the nearest sample in every cell."""
    from priors.kernels.sparse_samples import downsample

    return downsample(*samples[1:], step, *_smaller(size, step))
