"""A rectified pair with what is known of its disparity: what a stereo network is trained on."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from priors import geometry
from priors.codecs import as_rgb
from priors.learn import sample as samples
from priors.types import Camera, FloatMap, Image, Mask

Item = dict[str, Any]
T = TypeVar("T", bound=np.generic)


@dataclass(frozen=True, slots=True)
class Pair:
    """Two views of one moment; all maps are for the left one."""

    left: Image
    """(h, w, 3) RGB or (h, w) grey, uint8."""
    right: Image
    """Same shape."""
    disparity_px: FloatMap
    """(h, w); left x matches right x - disparity; 0 where not known, or infinitely far."""
    known: Mask
    """(h, w) where disparity_px is the truth, or a label to learn from; the sky is known to be 0."""
    sky: Mask
    """(h, w)."""
    weight: FloatMap
    """(h, w) in [0, 1]: how far to trust it, 0 where not known."""
    source: str
    """Where it comes from: street, warped, odometry."""
    camera: Camera | None = None
    baseline_m: float | None = None
    points_m: npt.NDArray[np.float32] | None = None
    """(n, 3) LiDAR points in the left camera's axes."""
    beam: npt.NDArray[np.uint8] | None = None
    """(n,) each point's scan line."""


def from_street(path: Path) -> Pair:
    """Read a rendered sample; everything is known but what lies beyond its range without being sky."""
    found = samples.read(path)
    known = (found.disparity_px > 0) | found.sky
    disparity_px = np.where(found.sky, np.float32(0), found.disparity_px)
    return Pair(
        found.left,
        found.right,
        disparity_px,
        known,
        found.sky,
        known.astype(np.float32),
        "street",
        found.camera,
        found.baseline_m,
        found.points_m,
        found.beam,
    )


def mirror(pair: Pair, right_px: FloatMap, right_known: Mask, right_sky: Mask) -> Pair:
    """Exchange the views in the mirror: the flipped right view is the new left one.

    Args:
        pair: any pair.
        right_px: (h, w) disparity of the right view: right x matches left x + disparity.
        right_known: (h, w) where it is known.
        right_sky: (h, w).

    Returns:
        The mirrored pair, without camera and points.
    """
    known, sky = flip(right_known), flip(right_sky)
    weight = known.astype(np.float32)
    return Pair(flip(pair.right), flip(pair.left), flip(right_px) * weight, known, sky, weight, pair.source)


def flip(map_: npt.NDArray[T]) -> npt.NDArray[T]:
    """Mirror an image or a map (h, w, ...)."""
    return np.ascontiguousarray(map_[:, ::-1])


def crop(pair: Pair, top: int, left: int, size: tuple[int, int]) -> Pair:
    """Cut the same window out of both views; disparities stay."""
    window = slice(top, top + size[0]), slice(left, left + size[1])
    cut = replace(
        pair,
        left=pair.left[window],
        right=pair.right[window],
        disparity_px=pair.disparity_px[window],
        known=pair.known[window],
        sky=pair.sky[window],
        weight=pair.weight[window],
    )
    return cut if pair.camera is None else replace(cut, camera=geometry.crop(pair.camera, top, left, size))


def to_item(pair: Pair) -> Item:
    """Return the pair as networks want it.

    Returns:
        left, right (3, h, w) float32 in [0, 1] (rows of interleaved colours in memory: channels-last), disparity_px,
        weight (h, w) float32, known, sky (h, w) bool, source; where the camera is known also depth_m (h, w),
        K (3, 3), baseline_m, points_m (n, 3) and beam (n,).
    """
    item: Item = {
        "left": _planes(pair.left),
        "right": _planes(pair.right),
        "disparity_px": np.ascontiguousarray(pair.disparity_px),
        "known": np.ascontiguousarray(pair.known),
        "sky": np.ascontiguousarray(pair.sky),
        "weight": np.ascontiguousarray(pair.weight),
        "source": pair.source,
    }
    if pair.camera is not None and pair.baseline_m is not None:
        near = pair.disparity_px > 0
        reach = np.float32(pair.camera.fx * pair.baseline_m)
        item["depth_m"] = np.where(near, reach / np.where(near, pair.disparity_px, np.float32(1)), np.float32(0))
        item |= {"K": pair.camera.K, "baseline_m": pair.baseline_m}
        item |= {"points_m": pair.points_m, "beam": pair.beam}
    return item


def _planes(image: Image) -> npt.NDArray[np.float32]:
    return np.multiply(as_rgb(image), np.float32(1 / 255), dtype=np.float32).transpose(2, 0, 1)
