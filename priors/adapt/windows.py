"""Windows of training views: drawn, cut out, resized, perhaps mirrored; the camera follows."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from priors import geometry
from priors.adapt.views import LabelledView
from priors.types import Camera, Image

Kind = TypeVar("Kind", bound=np.generic)
LARGEST_CROP, MULTIPLE = (256, 512), 32
"""Crops that a network is fine-tuned on: the largest (height, width), and what both sides are multiples of."""
ZOOM = (0.75, 1.33)
"""How much such a crop is scaled, at random."""


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
        resized = geometry.resize(geometry.crop(camera, self.top, self.left, self.shape), self.size)
        return geometry.mirror(resized) if self.mirrored else resized

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
        return geometry.mirror_columns(picture) if self.mirrored else picture


def draw_window(
    of: tuple[int, int], rng: np.random.Generator, size: tuple[int, int], zoom: tuple[float, float]
) -> Window:
    """Draw a window of a picture of (height, width) `of`, which becomes `size`; every second one is mirrored.

    Where the picture is too small for the window, it is enlarged as little as needed.
    """
    height, width = of
    least = max(size[0] / height, size[1] / width)
    factor = max(least, float(np.exp(rng.uniform(np.log(zoom[0]), np.log(zoom[1])))))
    shape = min(height, round(size[0] / factor)), min(width, round(size[1] / factor))
    top, left = int(rng.integers(height - shape[0] + 1)), int(rng.integers(width - shape[1] + 1))
    return Window(top, left, shape, size, bool(rng.random() < 0.5))


def random_crop(
    view: LabelledView, rng: np.random.Generator, size: tuple[int, int], zoom: tuple[float, float]
) -> LabelledView:
    """Cut a random window and resize it to `size`, the camera with it; every second one is mirrored.

    The depth stays what it is: a picture that is twice as large is one of a camera with twice the focal length.
    """
    return crop(view, draw_window(view.camera.size, rng, size, zoom))


def crop(view: LabelledView, window: Window) -> LabelledView:
    """Return a window of a view."""
    camera, image = window.camera(view.camera), window.image(view.image)
    return LabelledView(image, camera, window.map(view.depth_m), window.map(view.sky), view.source)


def crop_size(views: Sequence[LabelledView]) -> tuple[int, int]:
    """Return the crop's (height, width): multiples of 32 that every view holds, LARGEST_CROP at most."""
    sizes = np.array([view.camera.size for view in views])
    height, width = np.minimum(np.maximum(sizes.min(axis=0) // MULTIPLE, 1) * MULTIPLE, LARGEST_CROP)
    return int(height), int(width)


def nearest(map_: npt.NDArray[Kind], size: tuple[int, int]) -> npt.NDArray[Kind]:
    """Resize a map to (height, width) without mixing its values."""
    rows = ((np.arange(size[0]) + 0.5) * map_.shape[0] / size[0]).astype(np.intp)
    columns = ((np.arange(size[1]) + 0.5) * map_.shape[1] / size[1]).astype(np.intp)
    return map_[rows[:, None], columns]
