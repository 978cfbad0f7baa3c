"""What a depth network for single images learns from: an image, its camera, and depth where it is known."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
import numpy.typing as npt
import torch

from priors import geometry
from priors.colours import as_rgb
from priors.learn.completion import vary
from priors.learn.loop import Batch
from priors.types import Camera, FloatMap, Image

Kind = TypeVar("Kind", bound=np.generic)
LARGEST_M = 150.0
"""Depth beyond this teaches nothing."""
SKY, SURFACE, UNKNOWN = 1, 0, -1


@dataclass(frozen=True, slots=True)
class View:
    """One image and what is known of it."""

    image: Image
    """(h, w, 3) RGB or (h, w) grey."""
    camera: Camera
    depth_m: FloatMap
    """(h, w), 0 = not known; dense or sparse."""
    sky: npt.NDArray[np.int8]
    """(h, w) SKY, SURFACE or UNKNOWN."""
    source: str
    """Where it comes from, for the log."""


def label_sky(image: Image, depth_m: FloatMap) -> npt.NDArray[np.int8]:
    """Label a real image: a surface where there is depth, sky where the sky mask says so and there is none."""
    from priors.sky import sky_mask

    return np.where(depth_m > 0, SURFACE, np.where(sky_mask(image), SKY, UNKNOWN)).astype(np.int8)


def cut(view: View, rng: np.random.Generator, size: tuple[int, int], zoom: tuple[float, float]) -> View:
    """Cut a random window and resize it to `size`, the camera with it; every second one is mirrored.

    The depth stays what it is: a picture that is twice as large is one of a camera with twice the focal length. Where
    the view is too small for the window, it is enlarged as little as needed.
    """
    height, width = view.camera.size
    least = max(size[0] / height, size[1] / width)
    factor = max(least, float(np.exp(rng.uniform(np.log(zoom[0]), np.log(zoom[1])))))
    window = min(height, round(size[0] / factor)), min(width, round(size[1] / factor))
    top, left = int(rng.integers(height - window[0] + 1)), int(rng.integers(width - window[1] + 1))
    rows, columns = slice(top, top + window[0]), slice(left, left + window[1])
    camera = geometry.resize(geometry.crop(view.camera, top, left, window), size)
    way = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
    image = np.asarray(cv2.resize(view.image[rows, columns], size[::-1], interpolation=way), np.uint8)
    depth_m, sky = nearest(view.depth_m[rows, columns], size), nearest(view.sky[rows, columns], size)
    if rng.random() < 0.5:
        camera.K[0, 2] = size[1] - 1 - camera.K[0, 2]
        image, depth_m, sky = image[:, ::-1], depth_m[:, ::-1], sky[:, ::-1]
    return View(image, camera, depth_m, sky, view.source)


def nearest(map_: npt.NDArray[Kind], size: tuple[int, int]) -> npt.NDArray[Kind]:
    """Resize a map to (height, width) without mixing its values."""
    rows = ((np.arange(size[0]) + 0.5) * map_.shape[0] / size[0]).astype(np.intp)
    columns = ((np.arange(size[1]) + 0.5) * map_.shape[1] / size[1]).astype(np.intp)
    return map_[rows[:, None], columns]


def repaint(view: View, rng: np.random.Generator) -> View:
    """Change exposure, colour, sharpness and noise as cameras do."""
    return View(vary(as_rgb(view.image), rng), view.camera, view.depth_m, view.sky, view.source)


def collate(views: Sequence[View]) -> Batch:
    """Stack views of one size: image (b, 3, h, w) in [0, 1], K (b, 3, 3), depth_m and sky (b, h, w)."""
    image = torch.from_numpy(np.stack([as_rgb(view.image) for view in views])).permute(0, 3, 1, 2).float() / 255
    return {
        "image": image.contiguous(memory_format=torch.channels_last),
        "K": torch.from_numpy(np.stack([v.camera.K for v in views])).float(),
        "depth_m": torch.from_numpy(np.stack([v.depth_m for v in views])),
        "sky": torch.from_numpy(np.stack([v.sky for v in views])).float(),
    }
