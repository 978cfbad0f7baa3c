"""L1 and SSIM of pictures with their derivative, compiled. Equals nerf/twin/colour_loss.py.

Both passes filter rows of 3 w numbers, a pixel's channels side by side, so a window's taps lie 3 apart. Rows are copied
to buffers that are longer than they are, so that 16 lanes never leave them.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.lanes import floats, fma, load_floats, store, to_floats
from nerf.kernels.cpu.splat_lanes import kept, lanes, picked, spread
from priors.machine.compiled import compiled

TAPS = 11
RIM = 3 * (TAPS - 1)
"""Numbers by which a filtered row is shorter."""
MARGIN = RIM + 32
"""How much longer buffers are than rows."""
Numbers = npt.NDArray[np.float32]


class Pair(NamedTuple):
    """Two pictures, flat, and how they are weighed."""

    rgb: Numbers
    truth: Numbers
    weight: Numbers
    """(h * w * 3,) or empty: 1."""
    taps: Numbers
    """(TAPS,) of sum 1."""
    size: tuple[int, int]
    """(height, width), pixels."""
    per_window: np.float32
    """What a window counts in the total."""
    per_number: np.float32
    """What |rgb - truth| of a pixel's channel counts in the total."""
    c1: np.float32
    c2: np.float32


@compiled
def compare(pair: Pair, maps: Numbers, unlike: npt.NDArray[np.float64], first: int, last: int) -> None:
    """Compare the windows of rows first to last - 1.

    Fills unlike (h - 10,), sums of per_window (1 - SSIM), and maps (3, h - 10, 3 w + MARGIN): the derivatives by the
    windows' mean of rgb, of its square and of rgb times truth, spread over the windows' columns.
    """
    length = 3 * pair.size[1]
    padded = length + MARGIN
    lines, ring, out = (
        np.zeros(4 * padded, np.float32),
        np.zeros(4 * TAPS * padded, np.float32),
        np.zeros(3 * padded, np.float32),
    )
    for row in range(first, last + TAPS - 1):
        _take(pair, lines, row, length, padded)
        at = 4 * padded * (row % TAPS)
        for i in range(0, length - RIM, 16):
            for m in range(4):
                store(ring, np.int64(at + m * padded + i), _across(lines, m * padded + i, pair.taps))
        window = row - (TAPS - 1)
        if window >= first:
            unlike[window] = _windows(pair, ring, out, window, length, padded)
            for m in range(3):
                start = (m * (pair.size[0] - TAPS + 1) + window) * padded
                for i in range(0, length, 16):
                    store(maps, np.int64(start + i), _across(out, m * padded + i, pair.taps))


@compiled
def _take(pair, lines, row, length, padded):  # type: ignore[no-untyped-def]
    """Copy a row of both pictures, and set the sums of squares and the products."""
    for i in range(length):
        x, y = pair.rgb[row * length + i], pair.truth[row * length + i]
        lines[i], lines[padded + i] = x, y
        lines[2 * padded + i], lines[3 * padded + i] = x * x + y * y, x * y


@compiled
def _across(line, at, taps):  # type: ignore[no-untyped-def]
    """Return 16 sums along a row."""
    total = spread(taps, np.int64(0)) * load_floats(line, np.int64(at))
    for k in range(1, TAPS):
        total = fma(spread(taps, np.int64(k)), load_floats(line, np.int64(at + 3 * k)), total)
    return total


@compiled
def _down(ring, at, step, row, taps):  # type: ignore[no-untyped-def]
    """Return 16 sums down TAPS rows of a ring, the first of them `row`."""
    total = floats(np.float32(0))
    for k in range(TAPS):
        total = fma(spread(taps, np.int64(k)), load_floats(ring, np.int64(at + step * ((row + k) % TAPS))), total)
    return total


@compiled
def _windows(pair, ring, out, window, length, padded):  # type: ignore[no-untyped-def]
    """Set a row's derivatives, from RIM on, and return its sum of per_window (1 - SSIM)."""
    one, two, c1, c2 = floats(np.float32(1)), floats(np.float32(2)), floats(pair.c1), floats(pair.c2)
    total, step = floats(np.float32(0)), 4 * padded
    middle = (window + TAPS // 2) * length + RIM // 2
    for i in range(0, length - RIM, 16):
        weight = floats(pair.per_window)
        if len(pair.weight):
            weight = weight * load_floats(pair.weight, np.int64(middle + i))
        lane = to_floats(lanes()) + floats(np.float32(i))
        weight = kept(floats(np.float32(length - RIM - 1)), lane, weight)
        mx, my = _down(ring, i, step, window, pair.taps), _down(ring, padded + i, step, window, pair.taps)
        both, cross = (
            _down(ring, 2 * padded + i, step, window, pair.taps),
            _down(ring, 3 * padded + i, step, window, pair.taps),
        )
        common, squares = mx * my, fma(mx, mx, my * my)
        a1, a2 = fma(two, common, c1), fma(two, cross - common, c2)
        b1, b2 = squares + c1, both - squares + c2
        inverse = one / (b1 * b2)
        ssim = a1 * a2 * inverse
        total = fma(weight, one - ssim, total)
        # of 1 - SSIM
        d_mean = two * (mx * ssim * (b2 - b1) - my * (a2 - a1)) * inverse
        store(out, np.int64(RIM + i), weight * d_mean)
        store(out, np.int64(padded + RIM + i), weight * ssim * b1 * inverse)
        store(out, np.int64(2 * padded + RIM + i), weight * (floats(np.float32(-2)) * a1 * inverse))
    return _sum(total, out, 3 * padded - 16)


@compiled
def _sum(values, room, at):  # type: ignore[no-untyped-def]
    """Add up 16 floats; the last places of a buffer are zeroed again."""
    store(room, np.int64(at), values)
    total = 0.0
    for lane in range(16):
        total += room[at + lane]
        room[at + lane] = 0
    return total


@compiled
def differ(pair: Pair, maps: Numbers, d_rgb: Numbers, apart: npt.NDArray[np.float64], first: int, last: int) -> None:
    """Fill rows first to last - 1 of d_rgb (h * w * 3,), and apart (h,), sums of weight |rgb - truth|.

    maps: of `compare`, or empty.
    """
    height, length = pair.size[0], 3 * pair.size[1]
    padded, windows = length + MARGIN, height - TAPS + 1
    x, y, weight = np.zeros(padded, np.float32), np.zeros(padded, np.float32), np.zeros(padded, np.float32)
    zero, two, scale = floats(np.float32(0)), floats(np.float32(2)), floats(pair.per_number)
    buffer = np.empty(padded, np.float32)
    for row in range(first, last):
        for i in range(length):
            x[i], y[i] = pair.rgb[row * length + i], pair.truth[row * length + i]
            weight[i] = pair.weight[row * length + i] if len(pair.weight) else np.float32(1)
        total = zero
        for i in range(0, length, 16):
            vx, vy = load_floats(x, np.int64(i)), load_floats(y, np.int64(i))
            off, w = vx - vy, load_floats(weight, np.int64(i))
            total = fma(w, picked(off, zero, off, zero - off), total)
            d = kept(off, zero, w) - kept(zero, off, w)
            d = d * scale
            if len(maps):
                a, b, c = zero, zero, zero
                for k in range(max(0, row - windows + 1), min(TAPS, row + 1)):
                    tap, at = spread(pair.taps, np.int64(k)), (row - k) * padded + i
                    a = fma(tap, load_floats(maps, np.int64(at)), a)
                    b = fma(tap, load_floats(maps, np.int64(windows * padded + at)), b)
                    c = fma(tap, load_floats(maps, np.int64(2 * windows * padded + at)), c)
                d = d + fma(two * vx, b, fma(vy, c, a))
            store(buffer, np.int64(i), d)
        for i in range(length):
            d_rgb[row * length + i] = buffer[i]
        apart[row] = _sum(total, buffer, padded - 16)
