"""3DGS data, as graphdeco's trainer reads it: a COLMAP model, points to start from, and inverse depth in 16-bit PNG.

What that trainer does (graphdeco-inria/gaussian-splatting: dataset_readers.py, camera_utils.py, cameras.py, train.py),
and what is done about it here:

- It puts the principal point into the middle of the image, wherever the model has it. Images and maps are therefore
  cut off at one side of each axis, so that the middle is the principal point to a quarter of a pixel.
- inverse depth = code / 65536 * scale + offset, per image, in depth_params.json; the inverse of the camera-z depth, in
  the units of the model, here 1/m. An image whose scale is 5 times the median's, or a fifth, is not used: all images
  have one scale, 65536/65535 over the nearest depth of all, and offset 0.
- It has no mask: every pixel's inverse depth is learned from. Sky is 0, infinitely far. Any other pixel without a
  value takes that of the nearest pixel with one, and how many do is told. A prior that has too few is refused.
"""

import json
import shlex
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from eval.files import write_bytes
from priors import codecs
from priors.errors import DataError
from priors.export import colmap, place
from priors.export.fusion import Cloud, FusionConfig, Step, fuse
from priors.export.ply import Points, write_ply
from priors.export.views import View, Views
from priors.geometry import crop
from priors.sky import sky_mask
from priors.types import Camera, Depth, Frame, Image, Mask

PARAMS = "depth_params.json"
DEPTHS = "depths"
LARGEST_CODE, DIVISOR = 65535, 65536
LEAST_DENSITY = 0.5
"""Share of the pixels below the sky that must have a depth: with less, more is made up than known."""
START = np.dtype(
    [(axis, "<f4") for axis in ("x", "y", "z", "nx", "ny", "nz")] + [(name, "u1") for name in ("red", "green", "blue")]
)
"""A point to start from, with a normal of 0, as the trainer writes them itself."""


@dataclass(frozen=True)
class Coverage:
    """How many pixels below the sky have a depth of their own."""

    known: int = 0
    pixels: int = 0

    def __add__(self, other: "Coverage") -> "Coverage":
        return Coverage(self.known + other.known, self.pixels + other.pixels)

    @property
    def share(self) -> float:
        """The share that has, in [0, 1]."""
        return self.known / max(self.pixels, 1)


def write(folder: Path, views: Views, fusion: FusionConfig, on_view: Step = lambda: None) -> list[str]:
    """Write images/, depths/ and sparse/0/; what is there already is kept, README.txt comes last.

    `on_view` is called twice a view: once when its nearest depth is known, once when it is written.

    Returns:
        What to tell the user, a line each; the last is the command that trains on it.

    Raises:
        DataError: no map can be read, or none has a point, or they have too few depths.
        OSError: it cannot be written.
    """
    scale, coverage = _measure(views, on_view)
    posed: list[colmap.Posed] = []

    def write_views() -> Iterator[View]:
        for view in map(centred, views):
            posed.append(colmap.write_image(folder, view, views))
            path = folder / DEPTHS / f"{view.name}.png"
            if not path.exists():
                _write_inverse(path, fill(view.depth, sky_mask(view.frame.image())), scale)
            yield view
            on_view()

    cloud = fuse(write_views(), views.near_poses, fusion)
    colmap.write_model(folder / colmap.MODEL, posed, cloud)
    write_ply(folder / colmap.MODEL / "points3D.ply", _start(cloud), comments=("metres, in the frame of the model",))
    params = {Path(image.name).stem: {"scale": scale, "offset": 0.0} for image in posed}
    write_bytes(folder / colmap.MODEL / PARAMS, (json.dumps(params, indent=1) + "\n").encode())
    line = shlex.join(["python", "train.py", "-s", str(folder), "-d", DEPTHS])
    told = _about(views, scale, coverage)
    place.write_readme(folder, views, [*place.origin_lines(views), *colmap.about(cloud, fusion), *told, "", line])
    lines = [f"{len(posed)} images, {len(cloud.points)} points: {folder}"]
    if coverage.known < coverage.pixels:
        lines.append(f"{1 - coverage.share:.2%} of the pixels below the sky had no depth: their neighbour's was taken")
    return [*lines, line]


def centred(view: View) -> View:
    """Return a view cut off at one side of each axis, so that its principal point is in the middle.

    Raises DataError where the principal point lies outside the image.
    """
    (height, width), K = view.camera.size, view.camera.K
    left, columns = _window(float(K[0, 2]), width)
    top, rows = _window(float(K[1, 2]), height)
    if min(columns, rows) < 1:
        raise DataError(f"frame {view.frame.id}: its principal point lies outside the image: is the calibration right?")
    window = slice(top, top + rows), slice(left, left + columns)

    whole: Frame = view.frame

    def image() -> Image:
        return np.ascontiguousarray(whole.image()[window])

    depth = view.depth
    parts = (depth.depth_m, depth.confidence, depth.consistency, depth.within_5_percent)
    cut = [None if part is None else np.ascontiguousarray(part[window]) for part in parts]
    camera: Camera = crop(view.camera, top, left, (rows, columns))
    frame = replace(whole, camera=camera, readers={**whole.readers, "image": image})
    return replace(view, frame=frame, depth=Depth(*cut))  # type: ignore[arg-type]


def _window(centre_px: float, length: int) -> tuple[int, int]:
    """Return the first pixel and the length of the largest window of an axis whose middle is the principal point.

    With pixel centres at whole numbers, the middle of `length` pixels is at (length - 1) / 2.
    """
    reach = min(centre_px + 0.5, length - 0.5 - centre_px)  # from the centre to the nearer edge
    inside = max(0, min(length, int(np.floor(2 * reach + 0.5))))
    return (0 if centre_px + 0.5 <= length / 2 else length - inside), inside


def fill(depth: Depth, sky: Mask) -> npt.NDArray[np.float64]:
    """Return inverse depth (height, width), 1/m: 0 in the sky, and a gap takes the value of the nearest pixel.

    Nearest by distance in the image (exact Euclidean distance transform). A map without any value is 0 everywhere.
    """
    valid = depth.valid
    with np.errstate(divide="ignore"):
        inverse = np.where(valid, 1.0 / depth.depth_m.astype(np.float64), 0.0)
    gaps = ~valid & ~sky
    if gaps.any() and valid.any():
        rows, columns = ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)
        inverse[gaps] = inverse[rows[gaps], columns[gaps]]
    return inverse


def _measure(views: Views, on_view: Step) -> tuple[float, Coverage]:
    """Return the one scale of all images, 1/m, and how many pixels have a depth; DataError where they are too few."""
    nearest_m, coverage = np.inf, Coverage()
    for view in map(centred, views):
        valid, below = view.depth.valid, ~sky_mask(view.frame.image())
        if valid.any():
            nearest_m = min(nearest_m, float(view.depth.depth_m[valid].min()))
        coverage += Coverage(int(np.count_nonzero(valid & below)), int(np.count_nonzero(below)))
        on_view()
    if not coverage.share >= LEAST_DENSITY:
        raise DataError(
            f"{views.prior.folder}: {coverage.share:.0%} of the pixels below the sky have a depth: graphdeco's trainer "
            "learns from every pixel: export a dense prior (completion, stereo, mono) or filter less"
        )
    return DIVISOR / LARGEST_CODE / nearest_m, coverage


def _write_inverse(path: Path, inverse: npt.NDArray[np.float64], scale: float) -> None:
    """Write inverse depth (height, width), 1/m, as codes of 16 bits: inverse = code / 65536 * scale."""
    codes = np.clip(np.rint(inverse / scale * DIVISOR), 0, LARGEST_CODE).astype(np.uint16)
    codecs.write_codes_png(path, codes)


def _start(cloud: Cloud) -> Points:
    """Return the cloud as points to start from."""
    points = np.zeros(len(cloud.points), START)
    for name in ("x", "y", "z", "red", "green", "blue"):
        points[name] = cloud.points[name]
    return points


def _about(views: Views, scale: float, coverage: Coverage) -> Iterable[str]:
    """Say what is graphdeco's alone."""
    step = scale / DIVISOR
    return [
        "depths/: inverse depth, 16-bit PNG. 1 / depth = code / 65536 * scale + offset, with scale and offset of",
        f"sparse/0/{PARAMS}: 1/m; depth is along the camera's z axis, metres. All images have one scale.",
        f"A step is {step:.3g} 1/m: {step * 100:.2g} m at 10 m, {step * 2500:.2g} m at 50 m. 0 = sky, infinitely far.",
        f"The trainer has no mask for depth: {1 - coverage.share:.2%} of the pixels below the sky had no depth",
        "and took the value of the nearest pixel that had one.",
        "Images and maps are cut off at one side of each axis: the trainer takes the middle of the image for the",
        "principal point, and now it is, to a quarter of a pixel. cameras.txt has it exactly.",
    ]
