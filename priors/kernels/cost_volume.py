"""Cost volumes for inference: from features as they are stored to what a convolution reads, in one pass over memory.

The readable twins are nets/cost_volume.unit and .lookup in plain torch, which take a dozen passes. Features come in 16
or 32 bits, are brought to unit length and multiplied in float32, and leave as they came. Rows are independent; inside
one, loops are short and straight, so that they become vectors.
"""

import numpy as np
import numpy.typing as npt

from priors.kernels.floats import Bits, narrow, widen
from priors.machine.compiled import FAST, compiled
from priors.types import FloatMap

ONE = np.float32(1)
SOFT = np.float32(1e-4)
"""Added to the square of a group's length."""
LARGEST_SQUARE = np.float32(1e30)
"""From here on float32's largest number is not far."""
CHUNK = 2048
"""Products that are held at a time: 8 KB, which the fastest cache has."""


@compiled(fastmath=FAST, error_model="numpy")
def match(
    left: Bits, right: Bits, disparity_px: FloatMap, groups: int, also: FloatMap, out: Bits, first: int, last: int
) -> None:
    """Match features (rows, w, c) at disparities (rows, w, planes), for 3D convolutions.

    Written are (rows, w, planes, groups), or one more channel where there is something else to tell each plane:
    also (rows, w, planes), or (0, 0, 0). The channels of a group are a power of two.
    Done are rows first to last - 1.
    """
    _, width, planes = disparity_px.shape
    told = out.shape[3]
    line = np.empty((width, planes * told), np.float32)
    for row in range(first, last):
        _match_row(left[row], right[row], disparity_px[row], groups, (told, 1), line)
        if also.size:
            for x in range(width):
                for plane in range(planes):
                    line[x, plane * told + groups] = also[row, x, plane]
        narrow(line.reshape(-1), out[row].reshape(-1))


@compiled(fastmath=FAST, error_model="numpy")
def match_beside(
    before: Bits,
    left: Bits,
    right: Bits,
    disparity_px: FloatMap,
    groups: int,
    after: FloatMap,
    out: Bits,
    begin: int,
    end: int,
) -> None:
    """Match as `match` does, for 2D convolutions: into out (rows, w, channels), the planes faster than the groups.

    Before the matches stands before (rows, w, b), behind them after (rows, w, a). Done are rows begin to end - 1.
    """
    _, width, planes = disparity_px.shape
    first, matches, more = before.shape[2], planes * groups, after.shape[2]
    line, bits = np.empty((width, matches + more), np.float32), np.empty((width, matches + more), out.dtype)
    for row in range(begin, end):
        _match_row(left[row], right[row], disparity_px[row], groups, (1, planes), line)
        for x in range(width):
            for k in range(more):
                line[x, matches + k] = after[row, x, k]
        narrow(line.reshape(-1), bits.reshape(-1))
        for x in range(width):
            for k in range(first):
                out[row, x, k] = before[row, x, k]
            for k in range(matches + more):
                out[row, x, first + k] = bits[x, k]


@compiled(fastmath=FAST, error_model="numpy")
def units(features: Bits, groups: int, out: FloatMap, first: int, last: int) -> None:
    """Write features (rows, w, c) with every group of channels of length 1, rows first to last - 1."""
    for row in range(first, last):
        normalised, line = unit(features[row], groups).reshape(-1), out[row].reshape(-1)
        for k in range(line.size):
            line[k] = normalised[k]


@compiled(fastmath=FAST, error_model="numpy")
def _match_row(
    left: Bits, right: Bits, disparity_px: FloatMap, groups: int, steps: tuple[int, int], out: FloatMap
) -> None:
    """Write the products of a row's features (w, c) at its disparities (w, planes) into out (w, ...).

    steps: how far apart in out[x] neighbouring planes are, and neighbouring groups.
    """
    width, channels = left.shape
    planes = disparity_px.shape[1]
    ours, theirs = unit(left, groups), unit(right, groups)
    most = max(1, CHUNK // (planes * channels))
    column, share = np.empty(most * planes, np.int32), np.empty(most * planes, np.float32)
    inside, product = np.empty(most * planes, np.float32), np.empty(most * planes * channels, np.float32)
    for start in range(0, width, most):
        count = min(most, width - start)
        _place(disparity_px[start : start + count], start, width, column, share, inside)
        _multiply(ours[start : start + count], planes, theirs, column, share, inside, product.reshape((-1, channels)))
        _add_up(product, count * planes * channels, channels // groups)
        if steps == (groups, 1) and out.shape[1] == planes * groups:
            flat = out[start : start + count].reshape(-1)
            for k in range(flat.size):  # assigning a slice would compile numpy's rules of shapes and their errors
                flat[k] = product[k]
            continue
        for x in range(count):
            line = out[start + x]
            for plane in range(planes):
                n = (x * planes + plane) * groups
                for group in range(groups):
                    line[plane * steps[0] + group * steps[1]] = product[n + group]


@compiled(fastmath=FAST, error_model="numpy")
def _place(
    disparity_px: FloatMap, start: int, width: int, column: npt.NDArray[np.int32], share: FloatMap, inside: FloatMap
) -> None:
    """Tell for pixels from `start` on between which columns of the right row they look, and whether it is one."""
    count, planes = disparity_px.shape
    last, before_last = np.float32(width - 1), np.float32(max(0, width - 2))
    for x in range(count):
        for plane in range(planes):
            asked = np.float32(start + x) - disparity_px[x, plane]
            held = min(max(asked, np.float32(0)), last)
            first = min(np.floor(held), before_last)
            column[x * planes + plane] = min(max(np.int32(first), np.int32(0)), np.int32(before_last))  # NaN too
            share[x * planes + plane] = held - first
            inside[x * planes + plane] = np.float32(asked == held)


@compiled(fastmath=FAST, error_model="numpy")
def _multiply(
    ours: FloatMap,
    planes: int,
    theirs: FloatMap,
    column: npt.NDArray[np.int32],
    share: FloatMap,
    inside: FloatMap,
    product: FloatMap,
) -> None:
    """Write left features (n, c) times the right row's (w, c), read between columns: (n * planes, c)."""
    count, channels = ours.shape
    last = theirs.shape[0] - 1
    for x in range(count):
        mine = ours[x]
        for n in range(x * planes, (x + 1) * planes):
            near, far = theirs[np.uintp(column[n])], theirs[np.uintp(min(column[n] + 1, last))]
            out, part = product[np.uintp(n)], share[n]
            if inside[n] > 0:
                for k in range(channels):
                    out[k] = mine[k] * (near[k] + part * (far[k] - near[k]))
            else:  # not a product with 0: of what is not finite it would be none
                for k in range(channels):
                    out[k] = 0


@compiled(fastmath=FAST, error_model="numpy")
def _add_up(values: FloatMap, count: int, size: int) -> None:
    """Add every `size` (a power of two) of the first `count` values to one, in place: halves, quarters, ..."""
    while size > 1:
        size, count = size // 2, count // 2
        for n in range(count):
            values[n] = values[2 * n] + values[2 * n + 1]


@compiled(fastmath=FAST, error_model="numpy")
def unit(features: Bits, groups: int) -> FloatMap:
    """Return a row's features (w, c) as float32, every group of channels of length 1."""
    width, channels = features.shape
    size = channels // groups
    flat, squares = np.empty(width * channels, np.float32), np.empty(width * channels, np.float32)
    widen(features.reshape(-1), flat)
    for k in range(flat.size):
        squares[k] = flat[k] * flat[k]
    _add_up(squares, squares.size, size)
    largest = np.float32(0)
    for n in range(width * groups):
        largest = max(largest, squares[n])
    if not largest < LARGEST_SQUARE:
        _shorten(flat, squares, width * groups, size)
    for n in range(width * groups):
        squares[n] = ONE / np.sqrt(squares[n] + SOFT)
    scale = _repeat(squares, width * groups, size)
    for k in range(flat.size):
        flat[k] *= scale[k]
    return flat.reshape((width, channels))


@compiled(error_model="numpy")
def _shorten(flat: FloatMap, squares: FloatMap, count: int, size: int) -> None:
    """Bring groups whose squares are too large for float32 to length 1, in float64; what is not finite becomes NaN."""
    for n in range(count):
        if squares[n] < LARGEST_SQUARE:
            continue
        total = 0.0
        for k in range(n * size, (n + 1) * size):
            total += np.float64(flat[k]) ** 2
        length = np.sqrt(total)
        for k in range(n * size, (n + 1) * size):
            flat[k] = np.float32(flat[k] / length)
        squares[n] = ONE - SOFT  # they have the length 1


@compiled(fastmath=FAST, error_model="numpy")
def _repeat(values: FloatMap, count: int, size: int) -> FloatMap:
    """Return each of the first `count` values `size` (a power of two) times: pairs, pairs of pairs, ..."""
    given, written, spare = values, np.empty(count * size, np.float32), np.empty(count * size, np.float32)
    while size > 1:
        for n in range(count):
            written[2 * n] = given[n]
            written[2 * n + 1] = given[n]
        given, written, spare = written, spare, written
        size, count = size // 2, count * 2
    return given[:count]
