"""The correction of a pre-filled depth map, MFFNet's last step, in one pass; the twin is mffnet.correct in torch."""

import numpy as np

from priors.kernels.floats import Bits, exponentiate, widen
from priors.machine.compiled import FAST, compiled
from priors.types import FloatMap

LARGEST_LOGIT = np.float32(40)


@compiled(fastmath=FAST, error_model="numpy")
def correct(
    raw: Bits, log_fill: FloatMap, largest_change: float, depth: FloatMap, scale: FloatMap, first: int, last: int
) -> None:
    """Mix two changes of a pre-fill, and apply the mix.

    Args:
        raw: (b, h / 2, w / 2, 16) in 16 or 32 bits: two changes, the logit of the first one's share and a scale, each
            for 2x2 pixels.
        log_fill: (b, >= h, >= w) logarithm of the pre-fill.
        largest_change: changes are held within this, up and down.
        depth: (b, h, w), written: exp(log_fill + change).
        scale: (b, h, w), written: as it is in raw.
        first: the first line of the b * h to do.
        last: one behind the last.
    """
    _, height, width = depth.shape
    for line in range(first, last):
        b, y = line // height, line % height
        given = raw[b, y // 2]
        cells = np.empty(given.size, np.float32)
        widen(given.reshape(-1), cells)
        logit, change, scratch = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
        for x in range(width):
            logit[x] = -min(max(cells[_place(x, y, 2)], -LARGEST_LOGIT), LARGEST_LOGIT)
        exponentiate(logit, scratch)
        for x in range(width):
            first, second = cells[_place(x, y, 0)], cells[_place(x, y, 1)]
            choice = cells[_place(x, y, 2)]
            mixed = (first + logit[x] * second) / (np.float32(1) + logit[x])  # no difference of large changes
            mixed = first if choice > LARGEST_LOGIT else second if choice < -LARGEST_LOGIT else mixed
            held = min(max(mixed, np.float32(-largest_change)), np.float32(largest_change))
            change[x] = log_fill[b, y, x] + (held if mixed == mixed else mixed)  # NaN is not held
            scale[b, y, x] = cells[_place(x, y, 3)]
        exponentiate(change, scratch)
        for x in range(width):
            depth[b, y, x] = change[x]


@compiled(inline="always")
def _place(x: int, y: int, what: int) -> int:
    """Return where a row of cells (w / 2, 16) holds something of pixel (x, y): the order of torch's pixel_shuffle."""
    return 16 * (x // 2) + 4 * what + 2 * (y % 2) + x % 2
