"""Warping by a disparity map: the right view that a left view makes; and maps resized without mixing surfaces."""

import numpy as np
import numpy.typing as npt

from priors.machine.compiled import compiled

Map = npt.NDArray[np.float32]
Flags = npt.NDArray[np.uint8]
NEITHER = np.float32(-1)


@compiled
def resize(
    values: Map, flags: Flags, top: int, left: int, window: tuple[int, int], size: tuple[int, int], step: float
) -> tuple[Map, Flags]:
    """Resize a window of a map: linear inside a surface, the nearest pixel's value where surfaces or flags meet.

    Args:
        values: (h, w).
        flags: (h, w); pixels of different flags never mix.
        top: first row of the window.
        left: first column.
        window: its height and width, inside the map.
        size: height and width of the result; pixel centres as cv2.resize has them.
        step: values that differ by more are of different surfaces.

    Returns:
        values and flags (size).
    """
    height, width = size
    out, kinds = np.empty((height, width), np.float32), np.empty((height, width), np.uint8)
    for v in range(height):
        y = min(max((v + 0.5) * window[0] / height - 0.5, 0.0), window[0] - 1.0)
        y0 = min(int(y), max(window[0] - 2, 0))
        fy = np.float32(y - y0)
        y1 = top + min(y0 + 1, window[0] - 1)
        y0 += top
        for u in range(width):
            x = min(max((u + 0.5) * window[1] / width - 0.5, 0.0), window[1] - 1.0)
            x0 = min(int(x), max(window[1] - 2, 0))
            fx = np.float32(x - x0)
            x1 = left + min(x0 + 1, window[1] - 1)
            x0 += left
            yn, xn = (y1 if fy >= 0.5 else y0), (x1 if fx >= 0.5 else x0)
            kind = flags[yn, xn]
            a, b, c, d = values[y0, x0], values[y0, x1], values[y1, x0], values[y1, x1]
            alike = flags[y0, x0] == kind and flags[y0, x1] == kind and flags[y1, x0] == kind and flags[y1, x1] == kind
            if alike and max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) <= step:
                upper, lower = a + fx * (b - a), c + fx * (d - c)
                out[v, u] = upper + fy * (lower - upper)
            else:
                out[v, u] = values[yn, xn]
            kinds[v, u] = kind
    return out, kinds


@compiled
def see_right(disparity_px: Map, step: float) -> tuple[Map, Map]:
    """Find what the right view sees of the surfaces that the left view's disparities describe; the nearest wins.

    Neighbours in a row whose disparities differ by at most `step` are one surface, linear between their centres;
    surfaces end half a pixel beyond their last centre.

    Args:
        disparity_px: (h, w) of the left view, finite and >= 0.
        step: px, below 1.

    Returns:
        For the right view's pixels (h, w): the column of the left view seen there, and the disparity; both -1 where
        the left view sees nothing of what is there.
    """
    height, width = disparity_px.shape
    column, seen_px = np.full((height, width), NEITHER), np.full((height, width), NEITHER)
    for y in range(height):
        for x in range(width):
            here = disparity_px[y, x]
            joined = x + 1 < width and abs(disparity_px[y, x + 1] - here) <= step
            if joined:
                slope = disparity_px[y, x + 1] - here
                _draw(column[y], seen_px[y], float(x), 1.0, here, slope)
            else:
                _draw(column[y], seen_px[y], float(x), 0.5, here, np.float32(0))
            if x == 0 or abs(disparity_px[y, x - 1] - here) > step:
                _draw(column[y], seen_px[y], x - 0.5, 0.5, here, np.float32(0))
    return column, seen_px


@compiled(inline="always")
def _draw(column: Map, seen_px: Map, start: float, length: float, first_px: float, slope: float) -> None:
    """Draw the piece of a row that begins at column `start`; on it the disparity is first + slope * way."""
    begin = start - first_px
    pace = 1.0 - slope  # of the right view's columns along the left view's
    for u in range(max(0, int(np.ceil(begin))), min(len(column) - 1, int(np.floor(begin + length * pace))) + 1):
        way = (u - begin) / pace
        px = first_px + slope * way
        if px > seen_px[u]:
            seen_px[u] = px
            column[u] = start + way


@compiled
def paint(image: npt.NDArray[np.uint8], column: Map, seen_px: Map, step: float, out: npt.NDArray[np.uint8]) -> None:
    """Look the left view's colours up, between its pixels by a cubic (Catmull-Rom) where four are of one surface.

    Args:
        image: (h, w, c).
        column: (h, w) what `see_right` gave; pixels below 0 keep what `out` has.
        seen_px: likewise; tells where four neighbours are one surface.
        step: as in `see_right`.
        out: (h, w, c) the right view.
    """
    height, width, channels = image.shape
    for y in range(height):
        for u in range(width):
            x = column[y, u]
            if x < 0 and seen_px[y, u] < 0:
                continue
            x = min(max(x, np.float32(0)), np.float32(width - 1))
            x0 = min(int(x), width - 2)
            f = x - x0
            smooth = 0 < x0 < width - 2 and 0 < u < width - 1
            smooth = smooth and abs(seen_px[y, u] - seen_px[y, u - 1]) <= step
            smooth = smooth and abs(seen_px[y, u] - seen_px[y, u + 1]) <= step
            for c in range(channels):
                b, d = np.float32(image[y, x0, c]), np.float32(image[y, x0 + 1, c])
                value = b + f * (d - b)
                if smooth:
                    a, e = np.float32(image[y, x0 - 1, c]), np.float32(image[y, x0 + 2, c])
                    bend = 2 * a - 5 * b + 4 * d - e
                    value = b + 0.5 * f * (d - a + f * (bend + f * (3 * (b - d) + e - a)))
                out[y, u, c] = np.uint8(min(max(value + np.float32(0.5), np.float32(0)), np.float32(255)))
