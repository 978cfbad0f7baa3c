"""Blending of a region, a tile of 16 pixels at a time, near to far, compiled. Equals nerf/twin/splat.py, `blend`."""

from typing import NamedTuple

import numpy as np

from nerf.gaussians.types import MOST_ALPHA
from nerf.kernels.cpu.lanes import floats, fma, ints, load_int, smaller, store, to_floats
from nerf.kernels.cpu.splat_lanes import kept, lanes, picked, power_of_two, spread, which
from nerf.kernels.cpu.splat_project import (
    BLUE,
    CAPPED,
    DEPTH,
    GREEN,
    LOG,
    RECORD,
    RED,
    REGION,
    TILE,
    XX,
    XY,
    YY,
    Numbers,
    View,
    X,
    Y,
)
from nerf.kernels.cpu.splat_region import TILES, Regions, Scratch, arrange
from priors.machine.compiled import compiled

CHECK = 8
"""After so many Gaussians a tile is asked whether it is finished."""


class Rules(NamedTuple):
    """How pixels are blended."""

    least_log: np.float32
    """Logarithm, base 2, of the least alpha that counts."""
    enough: np.float32
    """A pixel is finished when less of its light is left."""
    median: bool
    """Whether to find the median depth."""
    size: tuple[int, int]
    """(height, width), pixels."""


class Picture(NamedTuple):
    """What is seen, flat; filled in place."""

    rgb: Numbers
    depth_sum: Numbers
    opacity: Numbers
    median_m: Numbers
    background: Numbers
    """(h * w * 3,), or (3,) of all pixels."""


@compiled
def draw(view: View, regions: Regions, rules: Rules, scratch: Scratch, picture: Picture, first: int, last: int) -> None:
    """Arrange and blend regions first to last - 1."""
    for region in range(first, last):
        arrange(view, rules.size, regions, scratch, region)
        for tile in range(TILES):
            left, top, inside = corner(rules.size, region, tile)
            if inside:
                _tile(regions, rules, scratch, region, tile, left, top)
                _write(rules, scratch.words, picture, left, top)


@compiled
def corner(size, region, tile):  # type: ignore[no-untyped-def]
    """Return a tile's first column and row, and whether it has pixels of the image."""
    across, side = (size[1] + REGION - 1) // REGION, REGION // TILE
    left = (region % across) * REGION + (tile % side) * TILE
    top = (region // across) * REGION + (tile // side) * TILE
    return left, top, left < size[1] and top < size[0]


@compiled
def pixels(left, top):  # type: ignore[no-untyped-def]
    """Return the columns and rows of a tile's pixels, a pixel a lane."""
    lane = lanes()
    return to_floats(ints(np.int32(left)) + (lane & ints(3))), to_floats(ints(np.int32(top)) + (lane >> ints(2)))


@compiled
def light(size, x, y):  # type: ignore[no-untyped-def]
    """Return all of the light: 1 at pixels of the image, 0 beside it."""
    one = floats(np.float32(1))
    inside = kept(floats(np.float32(size[1] - 1)), x, one)
    return kept(floats(np.float32(size[0] - 1)), y, inside)


@compiled
def exponent(records, at, x, y):  # type: ignore[no-untyped-def]
    """Return the logarithm of a Gaussian's alpha, base 2, and where pixels are from its mean."""
    dx, dy = x - spread(records, at + X), y - spread(records, at + Y)
    along = fma(spread(records, at + XX), dx, spread(records, at + XY) * dy)
    return fma(along, dx, fma(spread(records, at + YY) * dy, dy, spread(records, at + LOG)))


@compiled
def alpha_of(log, left, rules):  # type: ignore[no-untyped-def]
    """Return the share of the light that is stopped, of what is left."""
    alpha = smaller(power_of_two(log), floats(np.float32(MOST_ALPHA)))
    return kept(left, floats(rules.enough), kept(log, floats(rules.least_log), alpha))


@compiled
def _tile(regions, rules, scratch, region, tile, left, top):  # type: ignore[no-untyped-def]
    """Blend a tile into the first 96 words: light left, red, green, blue, depth, median."""
    x, y = pixels(left, top)
    rest = light(rules.size, x, y)
    zero, half, enough = floats(np.float32(0)), floats(np.float32(0.5)), floats(rules.enough)
    red, green, blue, depth, middle = zero, zero, zero, zero, zero
    records, start = scratch.records, regions.first_entry[region]
    at = start + regions.ends[(TILES + 1) * region + tile]
    end = start + regions.ends[(TILES + 1) * region + tile + 1]
    while at < end:
        stop = min(at + CHECK, end)
        while at < stop:
            record = load_int(regions.entries, at) * RECORD
            alpha = alpha_of(exponent(records, record, x, y), rest, rules)
            weight = rest * alpha
            red = fma(weight, spread(records, record + RED), red)
            green = fma(weight, spread(records, record + GREEN), green)
            blue = fma(weight, spread(records, record + BLUE), blue)
            depth = fma(weight, spread(records, record + CAPPED), depth)
            after = rest - weight
            if rules.median:
                crossed = picked(half, after, spread(records, record + DEPTH), middle)
                middle = picked(half, rest, middle, crossed)
            rest = after
            at += 1
        if not which(rest, enough):
            break
    words = scratch.words
    store(words, np.int64(0), rest)
    store(words, np.int64(16), red)
    store(words, np.int64(32), green)
    store(words, np.int64(48), blue)
    store(words, np.int64(64), depth)
    store(words, np.int64(80), middle)


@compiled
def _write(rules, words, picture, left, top):  # type: ignore[no-untyped-def]
    """Write a tile's pixels into the picture, the background behind them."""
    height, width = rules.size
    for lane in range(16):
        x, y = left + (lane & 3), top + (lane >> 2)
        if x >= width or y >= height:
            continue
        pixel, rest = y * width + x, words[lane]
        behind = 3 * pixel if len(picture.background) > 3 else 0
        for c in range(3):
            picture.rgb[3 * pixel + c] = words[16 * (c + 1) + lane] + rest * picture.background[behind + c]
        picture.depth_sum[pixel] = words[64 + lane]
        picture.opacity[pixel] = 1 - rest
        picture.median_m[pixel] = words[80 + lane]
