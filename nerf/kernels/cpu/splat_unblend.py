"""The way back through blending, compiled: what a loss's derivatives by the picture say about each Gaussian's record.

A tile goes near to far once more. What lies behind a Gaussian is the whole less what came before it, so nothing but the
picture is kept from the way there. With alpha = e^p, a pixel's loss has the derivative by p

    g = w q - alpha / (1 - alpha) sum_behind w q,    q = d_rgb . colour + d_depth z + d_opacity

Every derivative by a Gaussian's shape is a sum of g over the pixels, times 1, dx, dy, dx^2, dx dy or dy^2. Sixteen
Gaussians are summed at a time: their g are transposed, so that a lane is a Gaussian, and the tile's pixels are added
up, whose places are known numbers.
"""

from typing import NamedTuple

import numpy as np

from nerf.gaussians.types import MOST_ALPHA
from nerf.kernels.cpu.lanes import floats, fma, load_floats, load_int, store, transpose
from nerf.kernels.cpu.splat_blend import Picture, Rules, alpha_of, corner, exponent, light, pixels
from nerf.kernels.cpu.splat_lanes import kept, power_of_two, spread, which
from nerf.kernels.cpu.splat_project import BLUE, CAPPED, GREEN, RECORD, RED, Numbers, View, X, Y
from nerf.kernels.cpu.splat_region import TILES, Regions, Scratch, fetch
from priors.machine.compiled import compiled

G, GX, GY, GXX, GXY, GYY, D_RED, D_GREEN, D_BLUE, D_DEPTH = range(10)
"""What stands where in a copy's sums: g times what, and the derivatives by the colour and by min(z, cap)."""
SLOPES, WEIGHTS, MEANS = 256, 512, 768
"""Where a tile's words hold g and w of 16 Gaussians and their means; before them the derivatives of its pixels."""
ALL = 80
"""Where they hold sum w q of all Gaussians."""


class Wanted(NamedTuple):
    """A loss's derivatives by the picture, flat."""

    rgb: Numbers
    depth_sum: Numbers
    """Or empty: 0."""
    opacity: Numbers
    """Or empty: 0."""


@compiled
def undraw(
    view: View,
    regions: Regions,
    rules: Rules,
    scratch: Scratch,
    picture: Picture,
    wanted: Wanted,
    parts: Numbers,
    first: int,
    last: int,
) -> None:
    """Set the sums of regions first to last - 1: parts (copies * RECORD,), 0 from 10 on."""
    for region in range(first, last):
        start = regions.first_member[region]
        count = regions.first_member[region + 1] - start
        fetch(view, regions, scratch, region)
        for k in range(count):
            store(scratch.sums, RECORD * k, floats(np.float32(0)))
        for tile in range(TILES):
            left, top, inside = corner(rules.size, region, tile)
            begin = regions.ends[(TILES + 1) * region + tile]
            if inside and regions.ends[(TILES + 1) * region + tile + 1] > begin:
                _read(rules, scratch.words, picture, wanted, left, top)
                _tile(regions, rules, scratch, region, tile, left, top)
        for k in range(count):
            copy = np.int64(regions.members[2 * (start + k) + 1])
            store(parts, RECORD * copy, load_floats(scratch.sums, RECORD * k))


@compiled
def _read(rules, words, picture, wanted, left, top):  # type: ignore[no-untyped-def]
    """Fill the first words: derivatives by red, green, blue, depth and opacity of the Gaussians alone, and sum w q."""
    height, width = rules.size
    for lane in range(16):
        x, y = left + (lane & 3), top + (lane >> 2)
        if x >= width or y >= height:
            for k in range(6):
                words[16 * k + lane] = 0
            continue
        pixel = y * width + x
        behind = 3 * pixel if len(picture.background) > 3 else 0
        rest = 1 - picture.opacity[pixel]
        stopped = wanted.opacity[pixel] if len(wanted.opacity) else np.float32(0)
        moment = wanted.depth_sum[pixel] if len(wanted.depth_sum) else np.float32(0)
        total = moment * picture.depth_sum[pixel]
        for c in range(3):
            d = wanted.rgb[3 * pixel + c]
            words[16 * c + lane] = d
            back = picture.background[behind + c]
            stopped -= d * back
            total += d * (picture.rgb[3 * pixel + c] - rest * back)
        words[48 + lane], words[64 + lane] = moment, stopped
        words[ALL + lane] = total + stopped * picture.opacity[pixel]


@compiled
def _tile(regions, rules, scratch, region, tile, left, top):  # type: ignore[no-untyped-def]
    """Add what a tile says to the sums."""
    x, y = pixels(left, top)
    rest, passed = light(rules.size, x, y), floats(np.float32(0))
    one, most, enough = floats(np.float32(1)), floats(np.float32(MOST_ALPHA)), floats(rules.enough)
    records, words, start = scratch.records, scratch.words, regions.first_entry[region]
    d_red, d_green, d_blue = (
        load_floats(words, np.int64(0)),
        load_floats(words, np.int64(16)),
        load_floats(words, np.int64(32)),
    )
    d_depth, d_opacity, total = (
        load_floats(words, np.int64(48)),
        load_floats(words, np.int64(64)),
        load_floats(words, np.int64(ALL)),
    )
    at = start + regions.ends[(TILES + 1) * region + tile]
    end = start + regions.ends[(TILES + 1) * region + tile + 1]
    while at < end and which(rest, enough):
        count = min(16, end - at)
        for k in range(count):
            record = load_int(regions.entries, at + k) * RECORD
            log = exponent(records, record, x, y)
            alpha = alpha_of(log, rest, rules)
            weight = rest * alpha
            q = fma(d_green, spread(records, record + GREEN), fma(d_red, spread(records, record + RED), d_opacity))
            q = fma(d_depth, spread(records, record + CAPPED), fma(d_blue, spread(records, record + BLUE), q))
            own = weight * q
            passed = passed + own
            slope = own - (total - passed) * alpha / (one - alpha)
            store(words, np.int64(SLOPES + 16 * k), kept(most, power_of_two(log), slope))
            store(words, np.int64(WEIGHTS + 16 * k), weight)
            words[MEANS + k], words[MEANS + 16 + k] = records[record + X], records[record + Y]
            rest = rest - weight
        for k in range(count, 16):
            store(words, np.int64(SLOPES + 16 * k), floats(np.float32(0)))
            store(words, np.int64(WEIGHTS + 16 * k), floats(np.float32(0)))
        _add_up(words, left, top)
        for k in range(count):
            place = load_int(regions.entries, at + k) * RECORD
            row = load_floats(words, np.int64(SLOPES + 16 * k))
            store(scratch.sums, place, load_floats(scratch.sums, place) + row)
        at += count


@compiled
def _add_up(words, left, top):  # type: ignore[no-untyped-def]
    """Replace 16 Gaussians' g by their sums over the tile's pixels, a Gaussian a row."""
    transpose(words, np.int64(SLOPES), np.int64(SLOPES))
    transpose(words, np.int64(WEIGHTS), np.int64(WEIGHTS))
    zero = floats(np.float32(0))
    m, mx, my, mxx, mxy, myy = zero, zero, zero, zero, zero, zero  # about the tile's middle
    red, green, blue, depth = zero, zero, zero, zero
    for row in range(4):
        at = SLOPES + 64 * row
        a, b = load_floats(words, np.int64(at)), load_floats(words, np.int64(at + 16))
        c, d = load_floats(words, np.int64(at + 32)), load_floats(words, np.int64(at + 48))
        outer, inner, y = a + d, b + c, floats(np.float32(row) - np.float32(1.5))
        line = outer + inner
        along = fma(floats(np.float32(1.5)), d - a, floats(np.float32(0.5)) * (c - b))
        mxx = fma(floats(np.float32(2.25)), outer, fma(floats(np.float32(0.25)), inner, mxx))
        m, mx = m + line, mx + along
        my, mxy, myy = fma(y, line, my), fma(y, along, mxy), fma(y * y, line, myy)
    for lane in range(16):
        weight = load_floats(words, np.int64(WEIGHTS + 16 * lane))
        red = fma(weight, spread(words, np.int64(lane)), red)
        green = fma(weight, spread(words, np.int64(16 + lane)), green)
        blue = fma(weight, spread(words, np.int64(32 + lane)), blue)
        depth = fma(weight, spread(words, np.int64(48 + lane)), depth)
    ox = floats(np.float32(left) + np.float32(1.5)) - load_floats(words, np.int64(MEANS))
    oy = floats(np.float32(top) + np.float32(1.5)) - load_floats(words, np.int64(MEANS + 16))
    gx, gy = fma(ox, m, mx), fma(oy, m, my)
    rows = SLOPES
    store(words, np.int64(rows + 16 * G), m)
    store(words, np.int64(rows + 16 * GX), gx)
    store(words, np.int64(rows + 16 * GY), gy)
    store(words, np.int64(rows + 16 * GXX), fma(ox, mx + gx, mxx))
    store(words, np.int64(rows + 16 * GXY), fma(ox, gy, fma(oy, mx, mxy)))
    store(words, np.int64(rows + 16 * GYY), fma(oy, my + gy, myy))
    store(words, np.int64(rows + 16 * D_RED), red)
    store(words, np.int64(rows + 16 * D_GREEN), green)
    store(words, np.int64(rows + 16 * D_BLUE), blue)
    store(words, np.int64(rows + 16 * D_DEPTH), depth)
    for k in range(10, 16):
        store(words, np.int64(rows + 16 * k), zero)
    transpose(words, np.int64(rows), np.int64(rows))
