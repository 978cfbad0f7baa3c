"""The last pass of an upsampling 3D convolution: it interleaves the answers for eight kinds of place.

The readable twin is nets/blocks.UpsampleConv.
"""

import numpy as np

from priors.kernels.floats import Bits, narrow, widen
from priors.machine.compiled import FAST, compiled


@compiled(fastmath=FAST)
def add_interleaved(plus: Bits, answers: Bits, out: Bits, first: int, last: int) -> None:
    """Write plus + answers, interleaved, for the rows first to last - 1.

    Args:
        plus: (b * h, w, planes, c) in 16 or 32 bits.
        answers: (b, h / 2 + 1, w / 2 + 1, planes / 2 + 1, 8 * c): see nets/fused.split_by_place.
        out: as plus, written.
        first: row of plus.
        last: row of plus.
    """
    _, width, planes, channels = plus.shape
    height = 2 * (answers.shape[1] - 1)
    cells = np.empty(planes * channels, answers.dtype)
    ours, theirs = np.empty(cells.size, np.float32), np.empty(cells.size, np.float32)
    for row in range(first, last):
        y = row % height
        source = answers[row // height, (y + 1) // 2]
        for x in range(width):
            line, kind = source[(x + 1) // 2], 4 * (y % 2) + 2 * (x % 2)
            for plane in range(planes):
                start = (kind + plane % 2) * channels
                here, there = cells[plane * channels : (plane + 1) * channels], line[(plane + 1) // 2]
                for c in range(channels):
                    here[c] = there[start + c]
            widen(cells, ours)
            widen(plus[row, x].reshape(-1), theirs)
            for k in range(ours.size):
                ours[k] += theirs[k]
            narrow(ours, out[row, x].reshape(-1))
