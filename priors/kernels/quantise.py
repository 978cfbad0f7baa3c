"""Quantisation of numbers to 8 bits, for convolutions of integers."""

import numpy as np
import numpy.typing as npt

from priors.kernels.floats import Bits
from priors.machine.compiled import FAST, compiled

ITEM_NS = 0.5


@compiled(fastmath=FAST)
def quantise(
    values: Bits, inverse: np.float32, zero: np.float32, out: npt.NDArray[np.uint8], first: int, last: int
) -> None:
    """Write round(value * inverse + zero) of numbers (n,), in 16 or 32 bits, cut to 0 ... 255: first to last - 1.

    Halves are rounded up.
    """
    shift = np.uint32(32 - 8 * values.itemsize)
    whole = np.empty(256, np.uint32)
    numbers = whole.view(np.float32)
    for start in range(first, last, 256):
        count = min(last - start, 256)
        for k in range(count):
            whole[k] = np.uint32(values[start + k]) << shift
        for k in range(count):
            out[start + k] = np.uint8(
                min(max(numbers[k] * inverse + zero + np.float32(0.5), np.float32(0)), np.float32(255))
            )
