"""Surfaces of a depth map, compiled: pixels that go on smoothly into each other are joined (union-find)."""

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.warp_draw import Floats
from priors.machine.compiled import compiled

STEPS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))
"""Down and to the right: the pixels that each is compared with. Two pixels reach over a value that is wrong."""
_STEPS = np.array(STEPS, np.int64)


@compiled(error_model="numpy")
def _first(parent, pixel):  # type: ignore[no-untyped-def]
    """Return the first pixel of a pixel's surface, and shorten the way to it."""
    while parent[pixel] != pixel:
        parent[pixel] = parent[parent[pixel]]
        pixel = parent[pixel]
    return pixel


@compiled(error_model="numpy")
def join(inverse: Floats, ratio: float, steps: npt.NDArray[np.int64], parent: npt.NDArray[np.int64]) -> None:
    """Set each pixel's surface, parent (h w,): the number of the surface's first pixel, row by row.

    Args:
        inverse: (h, w) inverse depth, 1/m; not above 0: no value, a surface of its own.
        ratio: pixels are joined where the farther is less than so many times as far as the nearer.
        steps: (n, 2) rows down and columns to the right to the pixels that each is compared with.
        parent: filled.
    """
    height, width = inverse.shape
    for pixel in range(height * width):
        parent[pixel] = pixel
    for row in range(height):
        for column in range(width):
            here = inverse[row, column]
            if not here > 0:
                continue
            for step in range(len(steps)):
                y, x = row + steps[step, 0], column + steps[step, 1]
                if y >= height or x < 0 or x >= width:
                    continue
                there = inverse[y, x]
                if there > 0 and here < ratio * there and there < ratio * here:
                    one, other = _first(parent, row * width + column), _first(parent, y * width + x)
                    parent[max(one, other)] = min(one, other)
    for pixel in range(height * width):
        parent[pixel] = _first(parent, pixel)


def surfaces(inverse: Floats, ratio: float) -> npt.NDArray[np.int64]:
    """Return the surface of each pixel (h, w) of a map of inverse depth (h, w): see `join`."""
    parent = np.empty(inverse.size, np.int64)
    join(np.ascontiguousarray(inverse), ratio, _STEPS, parent)
    return parent.reshape(inverse.shape)
