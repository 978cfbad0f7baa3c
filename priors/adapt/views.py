"""What a depth network for single images learns from: an image, its camera, and depth where it is known."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
import numpy.typing as npt
import torch

from priors import geometry
from priors.adapt.augment import augment
from priors.adapt.batch import Batch
from priors.codecs import as_rgb
from priors.types import Camera, FloatMap, Image

Kind = TypeVar("Kind", bound=np.generic)
LARGEST_M = 150.0
"""Depth beyond this teaches nothing."""
SKY, SURFACE, UNKNOWN = 1, 0, -1
LARGEST_CROP, MULTIPLE = (256, 512), 32
"""Crops that a network adapts on."""
ZOOM = (0.75, 1.33)
"""How much such a crop is scaled, at random."""


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


@dataclass(frozen=True, slots=True)
class Window:
    """A part of a picture, resized, perhaps mirrored."""

    top: int
    left: int
    shape: tuple[int, int]
    """(height, width) of the part."""
    size: tuple[int, int]
    """(height, width) after resizing."""
    mirrored: bool

    @property
    def factor(self) -> float:
        """How many times larger its content becomes."""
        return self.size[0] / self.shape[0]

    def camera(self, camera: Camera) -> Camera:
        """Return the camera that takes the window's picture (mirrored: of the mirrored world)."""
        found = geometry.resize(geometry.crop(camera, self.top, self.left, self.shape), self.size)
        if self.mirrored:
            found.K[0, 2] = self.size[1] - 1 - found.K[0, 2]
        return found

    def image(self, image: Image) -> Image:
        """Cut an image."""
        way = cv2.INTER_AREA if self.factor < 1 else cv2.INTER_LINEAR
        return self._mirror(np.asarray(cv2.resize(self._part(image), self.size[::-1], interpolation=way), np.uint8))

    def map(self, map_: npt.NDArray[Kind]) -> npt.NDArray[Kind]:
        """Cut a map without mixing its values."""
        return self._mirror(nearest(self._part(map_), self.size))

    def _part(self, picture: npt.NDArray[Kind]) -> npt.NDArray[Kind]:
        return picture[self.top : self.top + self.shape[0], self.left : self.left + self.shape[1]]

    def _mirror(self, picture: npt.NDArray[Kind]) -> npt.NDArray[Kind]:
        return picture[:, ::-1] if self.mirrored else picture


def choose_window(
    of: tuple[int, int], rng: np.random.Generator, size: tuple[int, int], zoom: tuple[float, float]
) -> Window:
    """Draw a window of a picture of (height, width) `of`, that becomes `size`; every second one is mirrored.

    Where the picture is too small for the window, it is enlarged as little as needed.
    """
    height, width = of
    least = max(size[0] / height, size[1] / width)
    factor = max(least, float(np.exp(rng.uniform(np.log(zoom[0]), np.log(zoom[1])))))
    shape = min(height, round(size[0] / factor)), min(width, round(size[1] / factor))
    top, left = int(rng.integers(height - shape[0] + 1)), int(rng.integers(width - shape[1] + 1))
    return Window(top, left, shape, size, bool(rng.random() < 0.5))


def cut(view: View, rng: np.random.Generator, size: tuple[int, int], zoom: tuple[float, float]) -> View:
    """Cut a random window and resize it to `size`, the camera with it; every second one is mirrored.

    The depth stays what it is: a picture that is twice as large is one of a camera with twice the focal length.
    """
    return cut_out(view, choose_window(view.camera.size, rng, size, zoom))


def cut_out(view: View, window: Window) -> View:
    """Return a window of a view."""
    camera, image = window.camera(view.camera), window.image(view.image)
    return View(image, camera, window.map(view.depth_m), window.map(view.sky), view.source)


def crop_size(views: Sequence[View]) -> tuple[int, int]:
    """Return the crop's (height, width): multiples of 32 that every view holds, LARGEST_CROP at most."""
    sizes = np.array([view.camera.size for view in views])
    height, width = np.minimum(np.maximum(sizes.min(axis=0) // MULTIPLE, 1) * MULTIPLE, LARGEST_CROP)
    return int(height), int(width)


def nearest(map_: npt.NDArray[Kind], size: tuple[int, int]) -> npt.NDArray[Kind]:
    """Resize a map to (height, width) without mixing its values."""
    rows = ((np.arange(size[0]) + 0.5) * map_.shape[0] / size[0]).astype(np.intp)
    columns = ((np.arange(size[1]) + 0.5) * map_.shape[1] / size[1]).astype(np.intp)
    return map_[rows[:, None], columns]


def repaint(view: View, rng: np.random.Generator) -> View:
    """Change exposure, colour, sharpness and noise as cameras do."""
    return View(augment(as_rgb(view.image), rng), view.camera, view.depth_m, view.sky, view.source)


def collate(views: Sequence[View]) -> Batch:
    """Stack views of one size: image (b, 3, h, w) in [0, 1], K (b, 3, 3), depth_m and sky (b, h, w)."""
    image = torch.from_numpy(np.stack([as_rgb(view.image) for view in views])).permute(0, 3, 1, 2).float() / 255
    return {
        "image": image.contiguous(memory_format=torch.channels_last),
        "K": torch.from_numpy(np.stack([v.camera.K for v in views])).float(),
        "depth_m": torch.from_numpy(np.stack([v.depth_m for v in views])),
        "sky": torch.from_numpy(np.stack([v.sky for v in views])).float(),
    }
