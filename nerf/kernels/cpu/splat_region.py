"""A region's Gaussians in order of depth, and lists of those that reach each of its tiles, compiled."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.lanes import floats, fma, ints, larger, load_floats, root, smaller, store, to_floats, truncate
from nerf.kernels.cpu.splat_lanes import lanes, picked, spread
from nerf.kernels.cpu.splat_project import (
    DEPTH,
    NARROW,
    REACH,
    RECORD,
    REGION,
    TILE,
    WIDE,
    XX,
    XY,
    YY,
    Indices,
    Numbers,
    View,
    X,
    Y,
    box,
)
from priors.machine.compiled import compiled

TILES = (REGION // TILE) ** 2
MOST_SPANS = REGION // TILE
"""Rows of tiles of a region."""

SLACK_PX, SLACK_SHARE = np.float32(0.01), np.float32(5e-4)
"""Ellipses reach so much farther, and such a share of their half width."""


class Regions(NamedTuple):
    """Who is where in the image; regions and their tiles are numbered row by row."""

    members: Indices
    """(copies * 2,) row and copy of each member; by region, near to far once it is arranged."""
    first_member: npt.NDArray[np.int64]
    """(regions + 1,)"""
    entries: Indices
    """Places in a region's list of members, by tile, near to far."""
    first_entry: npt.NDArray[np.int64]
    """(regions + 1,) where a region's entries begin."""
    ends: Indices
    """(regions * (TILES + 1),) where each tile's entries begin and end, from the region's first on."""


class Scratch(NamedTuple):
    """What a thread needs for the largest region."""

    records: Numbers
    """(most * RECORD,) of the members, near to far."""
    keys: npt.NDArray[np.uint32]
    """(2 * most,)"""
    order: Indices
    """(2 * most,)"""
    spans: Indices
    """(most * MOST_SPANS,)"""
    sums: Numbers
    """(most * RECORD,) what a region adds to its members' gradients."""
    words: Numbers
    """(1024,) of a tile."""


@compiled
def fetch(view: View, regions: Regions, scratch: Scratch, region: int) -> None:
    """Copy the records of a region's members, in their order."""
    first = regions.first_member[region]
    for k in range(regions.first_member[region + 1] - first):
        store(
            scratch.records, RECORD * k, load_floats(view.records, np.int64(RECORD) * regions.members[2 * (first + k)])
        )


@compiled
def arrange(view: View, size: tuple[int, int], regions: Regions, scratch: Scratch, region: int) -> None:
    """Sort a region's members by depth, those of one depth by number, and fill the lists of its tiles."""
    first = regions.first_member[region]
    count = regions.first_member[region + 1] - first
    for k in range(count):
        scratch.order[k] = k
    _sort(_take_keys(view, regions, scratch, first, count), scratch, count)
    for k in range(2 * count):
        scratch.spans[k] = regions.members[2 * first + k]
    for k in range(count):
        member = scratch.order[k]
        regions.members[2 * (first + k)] = scratch.spans[2 * member]
        regions.members[2 * (first + k) + 1] = scratch.spans[2 * member + 1]
    fetch(view, regions, scratch, region)
    across = (size[1] + REGION - 1) // REGION
    corner = (region % across) * REGION, (region // across) * REGION
    _list(view, regions, scratch, region, corner)


@compiled
def _take_keys(view, regions, scratch, first, count):  # type: ignore[no-untyped-def]
    """Set the keys to the depths' bits, which ascend as the depths do, less the least; returns the largest."""
    bits = view.records.view(np.uint32)
    least, most = np.uint32(0xFFFFFFFF), np.uint32(0)
    for k in range(count):
        key = bits[np.int64(RECORD) * regions.members[2 * (first + k)] + DEPTH]
        scratch.keys[k] = key
        least, most = min(least, key), max(most, key)
    for k in range(count):
        scratch.keys[k] -= least
    return most - least if count else np.uint32(0)


@compiled
def _sort(most, scratch, count):  # type: ignore[no-untyped-def]
    """Sort `order` by the keys, stably: radix sort, a byte at a time."""
    keys, order, counts = scratch.keys, scratch.order, np.empty(256, np.int64)
    half = len(keys) // 2
    source, target, shift = 0, half, np.uint32(0)
    while shift < 32 and most >> shift:
        for digit in range(256):
            counts[digit] = 0
        for k in range(count):
            counts[(keys[source + k] >> shift) & np.uint32(255)] += 1
        total = target
        for digit in range(256):
            here = counts[digit]
            counts[digit] = total
            total += here
        for k in range(count):
            digit = (keys[source + k] >> shift) & np.uint32(255)
            place = counts[digit]
            keys[place], order[place] = keys[source + k], order[source + k]
            counts[digit] = place + 1
        source, target, shift = target, source, shift + np.uint32(8)
    if source:
        for k in range(count):
            order[k] = order[source + k]


@compiled
def _list(view, regions, scratch, region, corner):  # type: ignore[no-untyped-def]
    """Fill the lists of a region's tiles: those that a Gaussian's ellipse reaches."""
    first, ends, words = regions.first_member[region], regions.ends[(TILES + 1) * region :], scratch.words
    members, boxes, records, every = regions.members, view.boxes, scratch.records, scratch.spans
    for tile in range(TILES + 1):
        ends[tile] = 0
    spans = np.uint64(0)
    for k in range(regions.first_member[region + 1] - first):
        left, right, top, bottom = box(boxes, members[np.uint64(2 * (first + k))])
        left, right = max(left - corner[0], 0) // TILE, min(right - corner[0], REGION - 1) // TILE
        low, high = max(top - corner[1], 0) // TILE, min(bottom - corner[1], REGION - 1) // TILE
        bent = right > left and high > low
        if bent:
            _reach(records, RECORD * k, corner, words)
        for v in range(low, high + 1):
            start, stop = left, right
            if bent:
                start = max(left, np.int64(words[np.uint64(v)]))
                stop = min(right, np.int64(words[np.uint64(v + MOST_SPANS)]))
            for u in range(start, stop + 1):
                ends[np.uint64(MOST_SPANS * v + u + 1)] += 1
            if stop >= start:
                every[spans] = start | stop << 3 | v << 6 | k << 9
                spans += np.uint64(1)
    for tile in range(TILES):
        ends[tile + 1] += ends[tile]
    cursor, entries = np.empty(TILES, np.int64), regions.entries
    for tile in range(TILES):
        cursor[tile] = regions.first_entry[region] + ends[tile]
    for k in range(spans):
        span = every[k]
        row = MOST_SPANS * (span >> 6 & 7)
        for tile in range(np.uint64(row + (span & 7)), np.uint64(row + (span >> 3 & 7) + 1)):
            place = cursor[tile]
            entries[np.uint64(place)] = span >> 9
            cursor[tile] = place + 1


@compiled
def _reach(records, at, corner, words):  # type: ignore[no-untyped-def]
    """Set the first and the last tile of each row of tiles that an ellipse reaches: 8 words each.

    The ellipse is xx dx^2 + xy dx dy + yy dy^2 = -reach, xx and yy below 0. Along a band of rows its end in x is its
    own where that lies in the band, else where the band's nearer side cuts it. Lanes: left ends, then right ends.
    """
    lane = lanes()
    band = to_floats((lane & ints(MOST_SPANS - 1)) * ints(TILE))
    sign = to_floats((lane >> ints(3)) * ints(2) - ints(1))
    xx, xy = spread(records, at + XX), spread(records, at + XY)
    wide, reach, narrow = spread(records, at + WIDE), spread(records, at + REACH), spread(records, at + NARROW)
    mx = spread(records, at + X) - floats(np.float32(corner[0]))
    above = band - (spread(records, at + Y) - floats(np.float32(corner[1]))) - floats(SLACK_PX)
    below = above + floats(np.float32(TILE - 1) + np.float32(2) * SLACK_PX)
    turn = sign * floats(np.float32(-0.5)) * xy / spread(records, at + YY) * wide  # dy of the ellipse's own ends
    dy = smaller(larger(turn, above), below)
    inside = larger(floats(np.float32(0)) - fma(xx, reach, narrow * dy * dy), floats(np.float32(0)))
    slack = fma(floats(SLACK_SHARE), wide, floats(SLACK_PX))  # rounding must not lose a pixel
    dx = (floats(np.float32(-0.5)) * xy * dy - sign * root(inside)) / xx + sign * slack
    side = floats(np.float32(MOST_SPANS))
    tile = (mx + dx) * floats(np.float32(1 / TILE))
    none, one = floats(np.float32(0)), floats(np.float32(1))
    last = to_floats(truncate(smaller(larger(tile + one, none), side))) - one
    start = smaller(larger(tile - floats(np.float32((TILE - 1) / TILE)), none), side)
    start = side - to_floats(truncate(side - start))
    store(words, np.int64(0), picked(sign, none, last, start))
