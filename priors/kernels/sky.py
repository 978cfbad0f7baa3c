"""Sky mask: its loops. Block means of the image, refinement at full resolution."""

import numpy as np
import numpy.typing as npt

from priors.machine import threads
from priors.machine.compiled import FAST, compiled
from priors.types import Image, Mask

Floats = npt.NDArray[np.float32]


def shrink(image: Image, factor: int) -> Floats:
    """Average blocks of factor x factor pixels of an RGB image; blocks at the right and bottom edge may be smaller.

    Returns:
        colour (rows, columns, 3) in [0, 1].
    """
    rows, columns = -(-image.shape[0] // factor), -(-image.shape[1] // factor)
    colour = np.empty((rows, columns, 3), np.float32)
    block = threads.worth(1.5 * factor * image.shape[1])
    threads.over(rows, lambda first, last: _shrink(image, factor, colour, first, last), block)
    return colour


@compiled(error_model="numpy")
def _shrink(image: Image, factor: int, colour: Floats, first: int, last: int) -> None:
    height, width, _ = image.shape
    for i in range(first, last):
        top, bottom = i * factor, min(height, (i + 1) * factor)
        for j in range(colour.shape[1]):
            left, right = j * factor, min(width, (j + 1) * factor)
            red, green, blue = 0, 0, 0
            for y in range(top, bottom):
                for x in range(left, right):
                    red += int(image[y, x, 0])
                    green += int(image[y, x, 1])
                    blue += int(image[y, x, 2])
            count = (bottom - top) * (right - left)
            colour[i, j, 0] = red / (255.0 * count)
            colour[i, j, 1] = green / (255.0 * count)
            colour[i, j, 2] = blue / (255.0 * count)


def fit_linear(moments: Floats, smoothing: float) -> Floats:
    """Solve the guided filter's 3x3 systems by Cramer's rule.

    Args:
        moments: (13, rows, columns) local means of r, g, b, t, rr, rg, rb, gg, gb, bb, rt, gt, bt.
        smoothing: added to the variances.

    Returns:
        (rows, columns, 4): a for r, g, b, then b of t = a . colour + b.
    """
    rows, columns = moments.shape[1:]
    model = np.empty((rows, columns, 4), np.float32)
    block = threads.worth(25 * columns)
    threads.over(rows, lambda first, last: _fit_linear(moments, smoothing, model, first, last), block)
    return model


@compiled(error_model="numpy")
def _fit_linear(moments: Floats, smoothing: float, model: Floats, first: int, last: int) -> None:
    m = np.empty(13, np.float64)
    for i in range(first, last):
        for j in range(model.shape[1]):
            for k in range(13):
                m[k] = moments[k, i, j]
            r, g, b, t = m[0], m[1], m[2], m[3]
            rr, rg, rb = m[4] - r * r + smoothing, m[5] - r * g, m[6] - r * b
            gg, gb, bb = m[7] - g * g + smoothing, m[8] - g * b, m[9] - b * b + smoothing
            rt, gt, bt = m[10] - r * t, m[11] - g * t, m[12] - b * t
            c0, c1, c2 = gg * bb - gb * gb, gb * rb - rg * bb, rg * gb - gg * rb
            scale = 1 / (rr * c0 + rg * c1 + rb * c2)
            a0 = (c0 * rt + c1 * gt + c2 * bt) * scale
            a1 = (c1 * rt + (rr * bb - rb * rb) * gt + (rg * rb - rr * gb) * bt) * scale
            a2 = (c2 * rt + (rg * rb - rr * gb) * gt + (rr * gg - rg * rg) * bt) * scale
            model[i, j, 0], model[i, j, 1], model[i, j, 2] = a0, a1, a2
            model[i, j, 3] = t - a0 * r - a1 * g - a2 * b


def apply_linear(image: Image, model: Floats, factor: int) -> Mask:
    """Evaluate a blockwise linear model at every pixel: a . colour + b > 0.5, coefficients interpolated bilinearly.

    Args:
        image: (height, width, 3).
        model: (rows, columns, 4): a for red, green and blue in [0, 1], then b; rows and columns as `shrink` gives them.
        factor: the blocks' side, pixels.
    """
    mask = np.empty(image.shape[:2], np.bool_)
    block = threads.worth(5 * image.shape[1])
    threads.over(len(image), lambda first, last: _apply_linear(image, model, factor, mask, first, last), block)
    return mask


@compiled(fastmath=FAST, error_model="numpy")
def _apply_linear(image: Image, model: Floats, factor: int, mask: Mask, first: int, last: int) -> None:
    width = image.shape[1]
    rows, columns, _ = model.shape
    block = np.empty(width, np.int64)
    part = np.empty(width, np.float32)
    for x in range(width):
        u = min(max((x + 0.5) / factor - 0.5, 0.0), columns - 1.0)
        block[x] = min(int(u), max(columns - 2, 0))
        part[x] = u - block[x]
    scale = np.float32(1 / 255)
    line = np.empty((columns, 4), np.float32)
    for y in range(first, last):
        v = min(max((y + 0.5) / factor - 0.5, 0.0), rows - 1.0)
        i = min(int(v), max(rows - 2, 0))
        below, f = min(i + 1, rows - 1), np.float32(v - i)
        for j in range(columns):
            for c in range(4):
                line[j, c] = model[i, j, c] + f * (model[below, j, c] - model[i, j, c])
        for x in range(width):
            j, f = block[x], part[x]
            right = min(j + 1, columns - 1)
            value = line[j, 3] + f * (line[right, 3] - line[j, 3])
            for c in range(3):
                value += (line[j, c] + f * (line[right, c] - line[j, c])) * (np.float32(image[y, x, c]) * scale)
            mask[y, x] = value > np.float32(0.5)
