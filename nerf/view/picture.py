"""Picture: one view of a field, drawn coarse to fine, in pieces that are small enough to be given up in between.

The first level shows the whole view at once, at a size that takes FIRST_S at most. Each level after it has FINER times
as many pixels a side, or all, and comes in bands of rows of about BAND_S. The last level's rays are those of the whole
view: the finished picture is what the field renders of it in one go.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from nerf.types import RenderedView
from priors.geometry import crop, resize
from priors.types import Camera, FloatMap, Matrix

FIRST_S = 0.12
"""What the first level may take: pictures follow a moving camera."""
BAND_S = 0.1
"""What a band may take: so long a newer camera waits at most."""
LEAST_RAYS = 256
"""Fewer are not worth a call."""
FINER = 4
"""How many times more pixels a side the next level has; the last step may be a smaller one."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A part of a level: some rows of it."""

    camera: Camera
    """Renders it."""
    level: Camera
    """The whole level's."""
    top: int
    """Its first row in the level."""
    first: bool
    """Whether it is of the first level."""

    @property
    def last(self) -> bool:
        """Whether the level is whole with it."""
        return self.top + self.camera.size[0] == self.level.size[0]


class Picture:
    """One view that is being drawn."""

    def __init__(self, T_world_cam: Matrix, camera: Camera, rays_a_second: float) -> None:
        """Plan the pieces of a view.

        Args:
            T_world_cam: (4, 4) camera to world, metres.
            camera: of the finished picture.
            rays_a_second: how fast the field is rendered here.
        """
        self.T_world_cam, self.camera = T_world_cam, camera
        self.rgb: FloatMap = np.zeros((*camera.size, 3), np.float32)
        self.depth_m: FloatMap = np.zeros(camera.size, np.float32)
        self.median_m: FloatMap = np.zeros(camera.size, np.float32)
        self.opacity: FloatMap = np.zeros(camera.size, np.float32)
        self._pieces = pieces(camera, rays_a_second)
        self._next = next(self._pieces, None)

    @property
    def whole(self) -> bool:
        """Whether every pixel has been rendered."""
        return self._next is None

    def take(self) -> Piece:
        """Return the piece that is next; ask only while the picture is not whole."""
        if self._next is None:
            raise ValueError("the picture is whole")
        piece, self._next = self._next, next(self._pieces, None)
        return piece

    def paste(self, piece: Piece, view: RenderedView) -> None:
        """Put a rendered piece into its place, made as large as it is shown."""
        height, width = self.camera.size
        rows = rows_of(piece, height)
        size = (width, rows.stop - rows.start)
        self.rgb[rows] = _enlarge(view.rgb, size, cv2.INTER_LINEAR)
        for mine, part in (
            (self.depth_m, view.depth_m),
            (self.median_m, view.median_m),
            (self.opacity, view.opacity),
        ):
            mine[rows] = _enlarge(part, size, cv2.INTER_NEAREST)

    def view(self) -> RenderedView:
        """Return what there is so far."""
        return RenderedView(self.rgb, self.depth_m, self.median_m, self.opacity)


def pieces(camera: Camera, rays_a_second: float) -> Iterator[Piece]:
    """Give the pieces of a view, level by level, from the top down in each."""
    band = max(LEAST_RAYS, round(rays_a_second * BAND_S))
    for number, size in enumerate(levels(camera.size, max(LEAST_RAYS, round(rays_a_second * FIRST_S)))):
        level = resize(camera, size) if size != camera.size else camera
        rows = size[0] if number == 0 else max(1, band // size[1])
        for top in range(0, size[0], rows):
            part = crop(level, top, 0, (min(rows, size[0] - top), size[1]))
            yield Piece(part, level, top, number == 0)


def levels(size: tuple[int, int], first: int) -> list[tuple[int, int]]:
    """Return the levels' sizes (height, width), coarse to fine: the first has at most `first` pixels or is a dot."""
    divisor = 1
    while -(-size[0] // divisor) * -(-size[1] // divisor) > max(1, first):
        divisor += 1
    divisors = [divisor]
    while divisors[-1] > 1:
        divisors.append(max(1, divisors[-1] // FINER))
    return [(-(-size[0] // divisor), -(-size[1] // divisor)) for divisor in divisors]


def rows_of(piece: Piece, height: int) -> slice:
    """Return the rows of a picture of this height that a piece covers; a level's pieces cover each row once."""
    total = piece.level.size[0]
    return slice(piece.top * height // total, (piece.top + piece.camera.size[0]) * height // total)


def _enlarge(part: FloatMap, size: tuple[int, int], how: int) -> npt.NDArray[np.float32]:
    """Return a part at (width, height); as it is where it has that size."""
    if part.shape[:2] == size[::-1]:
        return part
    return np.asarray(cv2.resize(part, size, interpolation=how), dtype=np.float32)
