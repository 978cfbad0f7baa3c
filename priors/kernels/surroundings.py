"""What the pixels around a pixel say of its surface: those of its own colour, and all of them."""

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import FAST, compiled
from priors.types import FloatMap, Image


@compiled(fastmath=FAST, error_model="numpy")
def gather(
    image: Image,
    values: FloatMap,
    trust: FloatMap,
    at: npt.NDArray[np.intp],
    grid: tuple[int, int],
    alike: npt.NDArray[np.float32],
    out: FloatMap,
) -> None:
    """Write four rows (4, n) for n pixels: how the values around differ from each pixel's own.

    They are the mean difference of those of like colour, that of all, the logarithm of the share of those of like
    colour, and the deviation among these. Each neighbour counts by the square of its trust.

    Args:
        image: (height, width, 3) uint8.
        values: (height, width).
        trust: (height, width) in [0, 1].
        at: (n,) indices of pixels.
        grid: how far the neighbours lie at most, and from one to the next, pixels; at borders the border's.
        alike: (766,) what a neighbour counts by the sum of its three channels' differences.
        out: (4, n).
    """
    height, width = values.shape
    reach, step = grid
    least = np.float32(1e-6)
    for n in range(at.size):
        row, column = at[n] // width, at[n] % width
        red, green, blue = (
            np.int32(image[row, column, 0]),
            np.int32(image[row, column, 1]),
            np.int32(image[row, column, 2]),
        )
        own = values[row, column]
        weight, total, weight_alike, total_alike, square = least, np.float32(0), least, np.float32(0), np.float32(0)
        for down in range(-reach, reach + 1, step):
            y = min(max(row + down, 0), height - 1)
            for right in range(-reach, reach + 1, step):
                x = min(max(column + right, 0), width - 1)
                differs = abs(image[y, x, 0] - red) + abs(image[y, x, 1] - green) + abs(image[y, x, 2] - blue)
                counts = trust[y, x] * trust[y, x]
                more = values[y, x] - own
                weight += counts
                total += counts * more
                counts *= alike[differs]
                weight_alike += counts
                total_alike += counts * more
                square += counts * more * more
        mean = total_alike / weight_alike
        out[0, n], out[1, n], out[2, n] = mean, total / weight, np.log(weight_alike / weight)
        out[3, n] = np.sqrt(max(square / weight_alike - mean * mean, np.float32(0)))
