"""The first sure pixel on each side of every pixel."""

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import compiled
from priors.types import Mask


@compiled
def find_nearest(sure: Mask, found: npt.NDArray[np.int32]) -> None:
    """Write the columns of the first sure pixels to the left and right, and the rows of those above and below.

    A sure pixel finds itself.

    Args:
        sure: (height, width).
        found: (4, height, width), -1 where there is none.
    """
    height, width = sure.shape
    left, right, above, below = found[0], found[1], found[2], found[3]
    for row in range(height):
        last = -1
        for column in range(width):
            if sure[row, column]:
                last = column
            left[row, column] = last
            above[row, column] = row if sure[row, column] else (above[row - 1, column] if row else -1)
    for row in range(height - 1, -1, -1):
        last = -1
        for column in range(width - 1, -1, -1):
            if sure[row, column]:
                last = column
            right[row, column] = last
            below[row, column] = row if sure[row, column] else (below[row + 1, column] if row < height - 1 else -1)
