"""Gaussians into an image, compiled: a record, a box and a place in the regions of each that is in view.

Gaussians are taken in chunks of CHUNK. Those of a chunk that are in view have the rows from chunk * CHUNK on.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.lanes import (
    floats,
    fma,
    gather,
    ints,
    larger,
    load_floats,
    root,
    smaller,
    store,
    to_floats,
    transpose,
    truncate,
)
from nerf.kernels.cpu.splat_colour import direction, shade, zero
from nerf.kernels.cpu.splat_lanes import binary_logarithm, lanes, picked, which
from nerf.kernels.cpu.splat_shape import (
    covariance,
    logistic,
    pick,
    place,
    quaternion,
    rows,
    scaled,
    scales,
    slopes,
    turned,
)
from nerf.kernels.lens import Lens
from nerf.twin.splat import BOX_MARGIN_PX
from priors.machine.compiled import compiled

CHUNK = 1024
REGION = 32
"""Pixels along a side of a region: what a thread draws at a time."""
TILE = 4
"""Pixels along a side of a tile: 16 lanes."""
RECORD = 16
X, Y, XX, XY, YY, LOG, RED, GREEN, BLUE, CAPPED, DEPTH, WIDE, REACH, NARROW = range(14)
"""What stands where in a record: the mean, pixels; the exponent's coefficients and the opacity's logarithm, base 2, so
that alpha = 2^(XX dx^2 + XY dx dy + YY dy^2 + LOG); the colour; min(z, cap) and z; half the box's width; LOG less the
least alpha's; XX YY - XY^2 / 4 without cancellation."""
BOX = 256
"""Where a buffer of 16 has their boxes, behind the records."""
LEAST_DET = 1.2e-38
TO_BASE_2 = np.float32(1.4426950408889634)
Numbers = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int32]


class Scene(NamedTuple):
    """The parameters of n Gaussians, flat."""

    means_m: Numbers
    log_scales: Numbers
    rotations: Numbers
    opacities: Numbers
    harmonics: Numbers
    stored: int
    """Coefficients of a Gaussian's harmonics: stored ..."""
    used: int
    """... and counted."""


class View(NamedTuple):
    """What is in view, by row."""

    records: Numbers
    """(rows * RECORD,)"""
    boxes: Indices
    """(rows * 4,) first and last column, first and last row of pixels."""
    gaussian: Indices
    """(rows,) which Gaussian."""
    found: Indices
    """(chunks,) how many of each chunk are in view."""
    copies: Indices
    """(chunks * regions,) how many of each chunk reach each region."""
    entries: Indices
    """(chunks * regions,) how many tiles their boxes have there."""


class Lists(NamedTuple):
    """Who is in which region; a Gaussian has a copy in each that it reaches."""

    first_index: npt.NDArray[np.int64]
    """(chunks,) how many are in view before each chunk."""
    first_copy: npt.NDArray[np.int64]
    """(chunks,) how many copies there are before each chunk."""
    cursor: npt.NDArray[np.int64]
    """(chunks * regions,) where the next member of each region from each chunk goes."""
    gaussians: npt.NDArray[np.int64]
    """(v,) which Gaussians are in view."""
    radii_px: Numbers
    """(v,) half the larger sides of their boxes."""
    copies: Indices
    """(v,) the first copy of each."""
    members: Indices
    """(copies * 2,) row and copy, by region."""


@compiled
def project(scene: Scene, lens: Lens, view: View, first: int, last: int) -> None:
    """Project chunks first to last - 1."""
    n, boxes, records, which = len(scene.opacities), view.boxes, view.records, view.gaussian
    buffer, words = np.empty(BOX + 64, np.float32), np.empty(256, np.float32)
    for chunk in range(first, last):
        row = np.int64(chunk * CHUNK)
        for i in range(chunk * CHUNK, min(n, (chunk + 1) * CHUNK), 16):
            seen = _sixteen(scene, lens, i, buffer)
            lane = np.int64(0)
            while seen:
                if seen & 1:
                    store(records, RECORD * row, load_floats(buffer, RECORD * lane))
                    for k in range(4):
                        boxes[np.uint64(4 * row + k)] = np.int32(buffer[np.uint64(BOX + 16 * k + lane)])
                    which[np.uint64(row)] = i + lane
                    row += 1
                lane += 1
                seen >>= 1
        view.found[chunk] = row - chunk * CHUNK
        _shade(scene, lens, records, which, chunk * CHUNK, row, words)
        _count(lens, view, chunk)


@compiled
def _shade(scene, lens, records, which, first, last, words):  # type: ignore[no-untyped-def]
    """Write the colours of rows first to last - 1."""
    for row in range(first, last, 16):
        i = gather(which, np.int64(0), smaller(ints(np.int32(row)) + lanes(), ints(np.int32(last - 1))))
        unit = zero(), zero(), zero()
        if scene.used > 1:
            _, away = place(scene.means_m, lens, i)
            unit, _ = direction(away)
        red, green, blue = shade(scene.harmonics, scene.stored, scene.used, i, unit, words)
        store(words, np.int64(0), red)
        store(words, np.int64(16), green)
        store(words, np.int64(32), blue)
        for lane in range(min(16, last - row)):
            at = np.uint64(RECORD * (row + lane) + RED)
            for c in range(3):
                records[at + np.uint64(c)] = words[np.uint64(16 * c + lane)]


@compiled
def _sixteen(scene, lens, first, buffer):  # type: ignore[no-untyped-def]
    """Project 16 Gaussians into a buffer: their records, then their boxes. Returns a bit for each that is in view."""
    n, none, one = len(scene.opacities), zero(), floats(np.float32(1))
    i = smaller(ints(np.int32(first)) + lanes(), ints(np.int32(n - 1)))
    p, _ = place(scene.means_m, lens, i)
    near = floats(lens.near_m)
    seen = which(p[2], near) & ((1 << min(16, n - first)) - 1)
    if not seen:
        return seen
    z = picked(p[2], near, p[2], one)
    tx, ty, x, y = slopes(lens, (p[0], p[1], z))
    q, _ = quaternion(scene.rotations, i)
    s = scales(scene.log_scales, i)
    row0, row1, _ = rows(lens, z, tx, ty, scaled(turned(lens, q), s))
    a, b, c, area, det, _ = covariance(lens, row0, row1)
    opacity = logistic(pick(scene.opacities, 1, 0, i))
    if lens.compensate:
        opacity = opacity * root(area / det)
    least = floats(lens.least_alpha)
    log = binary_logarithm(opacity)
    reach = larger(log - binary_logarithm(least), none)
    mx = fma(x, floats(lens.focal[0]), floats(lens.middle[0]))
    my = fma(y, floats(lens.focal[1]), floats(lens.middle[1]))
    double, margin = floats(np.float32(2) / TO_BASE_2) * reach, floats(np.float32(BOX_MARGIN_PX))
    wide = root(double * a) + margin
    left, right = _span(mx, wide, lens.size[1])
    top, bottom = _span(my, root(double * c) + margin, lens.size[0])
    scale, half = floats(TO_BASE_2) / det, floats(np.float32(-0.5))
    _store_four(buffer, 0, mx, my, half * scale * c, scale * b)
    _store_four(buffer, 4, half * scale * a, log, one, one)
    _store_four(buffer, 8, one, smaller(z, floats(lens.cap_m)), z, wide)
    _store_four(buffer, 12, reach, floats(np.float32(0.25) * TO_BASE_2) * scale, none, none)
    _store_four(buffer, 16, left, right, top, bottom)
    transpose(buffer, np.int64(0), np.int64(0))
    seen &= which(opacity, least) & which(det, floats(np.float32(LEAST_DET)))
    return seen & which(right, left) & which(bottom, top)


@compiled
def _store_four(buffer, k, a, b, c, d):  # type: ignore[no-untyped-def]
    store(buffer, np.int64(16 * k), a)
    store(buffer, np.int64(16 * k + 16), b)
    store(buffer, np.int64(16 * k + 32), c)
    store(buffer, np.int64(16 * k + 48), d)


@compiled
def _span(middle, half, size):  # type: ignore[no-untyped-def]
    """Return the first and the last pixel within half of the middle, as floats; last < first: none."""
    low = smaller(larger(middle - half, floats(np.float32(0))), floats(np.float32(size)))
    high = larger(smaller(middle + half, floats(np.float32(size - 1))), floats(np.float32(-1)))
    down = to_floats(truncate(low))
    low = picked(down, low, down, down + floats(np.float32(1)))
    # towards zero is down but for what lies left of the image: there is nothing, and -1 < 0 says so
    return low, picked(high, floats(np.float32(0)), to_floats(truncate(high)), floats(np.float32(-1)))


@compiled
def _count(lens, view, chunk):  # type: ignore[no-untyped-def]
    """Count in which regions a chunk's Gaussians are, and in how many tiles there."""
    across = (lens.size[1] + REGION - 1) // REGION
    start = chunk * (across * ((lens.size[0] + REGION - 1) // REGION))
    boxes, copies, entries = view.boxes, view.copies, view.entries
    for row in range(chunk * CHUNK, chunk * CHUNK + view.found[chunk]):
        left, right, top, bottom = box(boxes, row)
        for v in range(top // REGION, bottom // REGION + 1):
            tall = min(bottom, v * REGION + REGION - 1) // TILE - max(top, v * REGION) // TILE + 1
            for u in range(left // REGION, right // REGION + 1):
                wide = min(right, u * REGION + REGION - 1) // TILE - max(left, u * REGION) // TILE + 1
                at = np.uint64(start + v * across + u)
                copies[at] += 1
                entries[at] += wide * tall


@compiled
def box(boxes, row):  # type: ignore[no-untyped-def]
    """Return the first and last column, the first and last row of a Gaussian's pixels."""
    at = np.uint64(4 * row)
    left, right = boxes[at], boxes[at + np.uint64(1)]
    return left, right, boxes[at + np.uint64(2)], boxes[at + np.uint64(3)]


@compiled
def spread_over_regions(view: View, size: tuple[int, int], lists: Lists, first: int, last: int) -> None:
    """Write the Gaussians of chunks first to last - 1 into the regions' lists, in order."""
    across = (size[1] + REGION - 1) // REGION
    regions = across * ((size[0] + REGION - 1) // REGION)
    for chunk in range(first, last):
        copy, place = lists.first_copy[chunk], lists.first_index[chunk]
        for row in range(chunk * CHUNK, chunk * CHUNK + view.found[chunk]):
            lists.gaussians[place] = view.gaussian[row]
            lists.copies[place] = copy
            left, right, top, bottom = box(view.boxes, row)
            lists.radii_px[place] = np.float32(0.5) * max(right - left, bottom - top)
            place += 1
            for v in range(top // REGION, bottom // REGION + 1):
                for u in range(left // REGION, right // REGION + 1):
                    at = chunk * regions + v * across + u
                    lists.members[2 * lists.cursor[at]] = row
                    lists.members[2 * lists.cursor[at] + 1] = copy
                    lists.cursor[at] += 1
                    copy += 1
