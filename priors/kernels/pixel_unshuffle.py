"""Pixel-unshuffle of images in one pass over memory; the readable twin is nets/stereo_input.py in plain torch."""

from typing import Any

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import compiled


@compiled(error_model="numpy")
def unshuffle(
    images: npt.NDArray[np.uint8], table: npt.NDArray[Any], factor: int, out: npt.NDArray[Any], first: int, last: int
) -> None:
    """Write table[image] with factor x factor pixels as channels: (b, h, w, c) -> (b, rows, columns, c * factor^2).

    The order of channels is that of torch's pixel_unshuffle; right and bottom edges are repeated to fill `out`.
    Done are lines first to last - 1 of the b * rows there are.
    """
    height, width, channels = images.shape[1:]
    rows, columns = out.shape[1:3]
    for line in range(first, last):
        b, row = line // rows, line % rows
        for dy in range(factor):
            y = min(factor * row + dy, height - 1)
            for column in range(columns):
                for dx in range(factor):
                    x = min(factor * column + dx, width - 1)
                    for c in range(channels):
                        out[b, row, column, (c * factor + dy) * factor + dx] = table[images[b, y, x, c]]
