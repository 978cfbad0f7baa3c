"""What a frame shows, compiled: Gaussians before the sky, in the frame's colours. Equals nerf/twin/shown.py.

A task has every BANDS-th row, however many threads there are: each has a sky's gradient of its own, and those are
added up in order.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nerf.gaussians.types import Behind, Rasterised, Shown, ShownGradients
from priors.machine import threads
from priors.machine.compiled import compiled

BANDS = 8
"""Tasks of a picture; the sky is above, so each has rows from everywhere."""
Numbers = npt.NDArray[np.float32]
_1, _2, _3, _4, _5 = (np.uint64(k) for k in range(1, 6))
"""Unsigned places: a signed one would be asked each time whether it counts from the end."""


class Picture(NamedTuple):
    """What was rasterised, and what lies behind it; flat."""

    rgb: Numbers
    opacity: Numbers
    units: Numbers
    """(h * w * 3,)"""
    rotation: Numbers
    """(9,)"""
    texels: Numbers
    """(t * 3,)"""
    sizes: tuple[int, ...]
    change: Numbers
    """(12,), or empty: none."""
    clear: np.float32
    size: tuple[int, int]


class Seen(NamedTuple):
    """What is shown, flat; filled in place."""

    shown: Numbers
    """(h * w * 3,) in the frame's colours ..."""
    whole: Numbers
    """... and before the change; the same array where there is none."""
    sky: Numbers
    """(h * w * 3,) set where it is seen."""


class Slopes(NamedTuple):
    """Derivatives, flat; filled in place."""

    shown: Numbers
    """(h * w * 3,) given."""
    rgb: Numbers
    opacity: Numbers
    texels: Numbers
    """(BANDS * t * 3,) zeros before."""
    change: npt.NDArray[np.float64]
    """(BANDS * 12,) zeros before."""


def show(seen: Rasterised, behind: Behind) -> Shown:
    """Return what a frame shows of what was rasterised."""
    picture, shape = _picture(seen, behind), seen.rgb.shape
    rgb, sky = torch.empty(shape), torch.empty(shape)
    whole = rgb if behind.change is None else torch.empty(shape)
    out = Seen(_flat(rgb), _flat(whole), _flat(sky))
    threads.run(BANDS, lambda band: _show(picture, out, band))
    return Shown(rgb, behind, (picture, out))


def unshow(seen: Rasterised, shown: Shown, d_rgb: Tensor) -> ShownGradients:
    """Return a loss's derivatives from those (h, w, 3) by what is shown."""
    picture, out = shown.kept
    d_seen, d_opacity = torch.empty_like(d_rgb), torch.empty_like(seen.opacity)
    texels, change = np.zeros(BANDS * len(picture.texels), np.float32), np.zeros(BANDS * 12)
    slopes = Slopes(_flat(d_rgb), _flat(d_seen), _flat(d_opacity), texels, change)
    threads.run(BANDS, lambda band: _unshow(picture, out, slopes, band))
    by_change = torch.from_numpy(change.reshape(BANDS, 3, 4).sum(0)).float()
    by_texels = torch.from_numpy(texels.reshape(BANDS, -1, 3).sum(0))
    return ShownGradients(d_seen, d_opacity, by_texels, None if shown.behind.change is None else by_change)


def _picture(seen: Rasterised, behind: Behind) -> Picture:
    change = np.empty(0, np.float32) if behind.change is None else _flat(behind.change)
    arrays = [_flat(x) for x in (seen.rgb, seen.opacity, behind.units, behind.rotation, behind.texels)]
    height, width = seen.opacity.shape
    return Picture._make([*arrays, behind.sizes, change, np.float32(behind.clear), (height, width)])


def _flat(tensor: Tensor) -> Numbers:
    if tensor.dtype != torch.float32:  # the loops know no other numbers
        raise ValueError(f"expected float32, found {tensor.dtype}")
    return tensor.detach().contiguous().numpy().reshape(-1)


@compiled(error_model="numpy", inline="always")
def _place(picture, at):  # type: ignore[no-untyped-def]
    """Return where the direction of a pixel lies in the sky's pictures, [0, 1] x [0, 1]: nerf/twin/sky.py."""
    units, turn, one, half = picture.units, picture.rotation, np.float32(1), np.float32(0.5)
    a, b, c = units[at], units[at + 1], units[at + 2]
    x = turn[0] * a + turn[1] * b + turn[2] * c
    y = turn[3] * a + turn[4] * b + turn[5] * c
    z = turn[6] * a + turn[7] * b + turn[8] * c
    scale = one / (abs(x) + abs(y) + abs(z))
    x, y = x * scale, y * scale
    if z < 0:
        x, y = (one - abs(y)) * (-one if x < 0 else one), (one - abs(x)) * (-one if y < 0 else one)
    return x * half + half, y * half + half


@compiled(error_model="numpy", inline="always")
def _corner(u, v, start, size):  # type: ignore[no-untyped-def]
    """Return where the first of four texels stands in a flat picture, and how near a place is to the others."""
    last = np.float32(size - 1)
    x, y = u * last, v * last
    left, top = min(np.int64(x), size - 2), min(np.int64(y), size - 2)  # neither is below 0
    return np.uint64(3 * (start + top * size + left)), x - np.float32(left), y - np.float32(top)


@compiled(error_model="numpy", inline="always")
def _sky(picture, at):  # type: ignore[no-untyped-def]
    """Return what the sky's pictures sum up to in the direction of a pixel."""
    u, v = _place(picture, at)
    red, green, blue, start = np.float32(0), np.float32(0), np.float32(0), 0
    one, texels = np.float32(1), picture.texels
    for size in picture.sizes:
        first, right, down = _corner(u, v, start, size)
        other = first + np.uint64(3 * size)
        a, b, c, d = (one - right) * (one - down), right * (one - down), (one - right) * down, right * down
        red += a * texels[first] + b * texels[first + _3] + c * texels[other] + d * texels[other + _3]
        green += a * texels[first + _1] + b * texels[first + _4] + c * texels[other + _1] + d * texels[other + _4]
        blue += a * texels[first + _2] + b * texels[first + _5] + c * texels[other + _2] + d * texels[other + _5]
        start += size * size
    return red, green, blue


@compiled(error_model="numpy", inline="always")
def _paint(picture, at, d_sums, d_texels, zero):  # type: ignore[no-untyped-def]
    """Add to the texels' gradient, from `zero` on, from that of the sums in the direction of a pixel."""
    u, v = _place(picture, at)
    one, start = np.float32(1), 0
    for size in picture.sizes:
        first, right, down = _corner(u, v, start, size)
        first += zero
        other = first + np.uint64(3 * size)
        for c in range(3):
            k, d = np.uint64(c), d_sums[c]
            low, high = d * (one - down), d * down
            d_texels[first + k] += low * (one - right)
            d_texels[first + _3 + k] += low * right
            d_texels[other + k] += high * (one - right)
            d_texels[other + _3 + k] += high * right
        start += size * size


@compiled(error_model="numpy")
def _show(picture: Picture, out: Seen, band: int) -> None:
    """Fill the rows of a band."""
    (height, width), change, one = picture.size, picture.change, np.float32(1)
    for row in range(band, height, BANDS):
        for pixel in range(row * width, (row + 1) * width):
            at, passes = 3 * pixel, one - picture.opacity[pixel]
            red, green, blue = picture.rgb[at], picture.rgb[at + 1], picture.rgb[at + 2]
            if passes > picture.clear:
                r, g, b = _sky(picture, at)
                r, g, b = one / (one + np.exp(-r)), one / (one + np.exp(-g)), one / (one + np.exp(-b))
                out.sky[at], out.sky[at + 1], out.sky[at + 2] = r, g, b
                red, green, blue = red + passes * r, green + passes * g, blue + passes * b
            out.whole[at], out.whole[at + 1], out.whole[at + 2] = red, green, blue
            if len(change):
                out.shown[at] = red + change[0] * red + change[1] * green + change[2] * blue + change[3]
                out.shown[at + 1] = green + change[4] * red + change[5] * green + change[6] * blue + change[7]
                out.shown[at + 2] = blue + change[8] * red + change[9] * green + change[10] * blue + change[11]


@compiled(error_model="numpy")
def _unshow(picture: Picture, out: Seen, slopes: Slopes, band: int) -> None:
    """Go back through the rows of a band."""
    (height, width), change, one = picture.size, picture.change, np.float32(1)
    d_sums, line, zero = np.empty(3, np.float32), np.zeros(12, np.float32), np.uint64(band * len(picture.texels))
    for row in range(band, height, BANDS):
        for pixel in range(row * width, (row + 1) * width):
            at, passes = 3 * pixel, one - picture.opacity[pixel]
            for c in range(3):
                slopes.rgb[at + c] = slopes.shown[at + c]
            if len(change):
                for c in range(3):
                    d = slopes.shown[at + c]
                    for k in range(3):
                        slopes.rgb[at + k] += d * change[4 * c + k]
                        line[4 * c + k] += d * out.whole[at + k]
                    line[4 * c + 3] += d
            slopes.opacity[pixel] = 0
            if passes > picture.clear:
                moved = np.float32(0)
                for c in range(3):
                    sky, d = out.sky[at + c], slopes.rgb[at + c]
                    d_sums[c] = d * passes * sky * (one - sky)
                    moved -= d * sky
                slopes.opacity[pixel] = moved
                _paint(picture, at, d_sums, slopes.texels, zero)
        for k in range(12):  # a row in float32, all of them in float64
            slopes.change[12 * band + k] += line[k]
            line[k] = 0
