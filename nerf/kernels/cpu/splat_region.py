"""A region's Gaussians in order of depth, and lists of those that reach each of its tiles, compiled."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.lanes import load_floats, store
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

SLACK_PX = np.float32(0.01)
"""Ellipses reach so much farther: rounding must not lose a pixel."""


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
    first, ends = regions.first_member[region], (TILES + 1) * region
    for tile in range(TILES + 1):
        regions.ends[ends + tile] = 0
    spans = 0
    for k in range(regions.first_member[region + 1] - first):
        left, right, top, bottom = box(view.boxes, regions.members[2 * (first + k)])
        left, right = max(left - corner[0], 0) // TILE, min(right - corner[0], REGION - 1) // TILE
        low, high = max(top - corner[1], 0) // TILE, min(bottom - corner[1], REGION - 1) // TILE
        for v in range(low, high + 1):
            start, stop = left, right
            if right > left and bottom // TILE > top // TILE:
                start, stop = _reach(scratch.records, k, corner, v, left, right)
            for u in range(start, stop + 1):
                regions.ends[ends + MOST_SPANS * v + u + 1] += 1
            if stop >= start:
                scratch.spans[spans] = start | stop << 3 | v << 6 | k << 9
                spans += 1
    for tile in range(TILES):
        regions.ends[ends + tile + 1] += regions.ends[ends + tile]
    cursor = np.empty(TILES, np.int64)
    for tile in range(TILES):
        cursor[tile] = regions.first_entry[region] + regions.ends[ends + tile]
    for k in range(spans):
        span = scratch.spans[k]
        v = span >> 6 & 7
        for u in range(span & 7, (span >> 3 & 7) + 1):
            tile = MOST_SPANS * v + u
            regions.entries[cursor[tile]] = span >> 9
            cursor[tile] += 1


@compiled(error_model="numpy")
def _reach(records, k, corner, v, left, right):  # type: ignore[no-untyped-def]
    """Return the first and last tile of a row of tiles that an ellipse reaches, of those from left to right.

    The ellipse is xx dx^2 + xy dx dy + yy dy^2 + log = log of the least alpha. Along a band of dy its ends in x are its
    own where they lie in the band, else those of the band's nearer side.
    """
    at = np.uint64(RECORD) * np.uint64(k)
    mx, my = records[at + np.uint64(X)] - corner[0], records[at + np.uint64(Y)] - corner[1]
    xx, xy, yy = records[at + np.uint64(XX)], records[at + np.uint64(XY)], records[at + np.uint64(YY)]
    wide, reach, narrow = records[at + np.uint64(WIDE)], records[at + np.uint64(REACH)], records[at + np.uint64(NARROW)]
    above, below = TILE * v - my - SLACK_PX, TILE * v + (TILE - 1) - my + SLACK_PX
    turn = np.float32(-0.5) * xy / yy * wide  # dy of the ellipse's right end
    low, high = -wide, wide
    if not above <= -turn <= below:
        low = _side(xx, xy, narrow, reach, above if -turn < above else below, np.float32(-1))
    if not above <= turn <= below:
        high = _side(xx, xy, narrow, reach, above if turn < above else below, np.float32(1))
    if not low <= high:  # lost to rounding: the whole box
        return left, right
    start = min(max(np.ceil((mx + low - SLACK_PX - (TILE - 1)) / TILE), np.float32(left)), np.float32(right + 1))
    stop = max(min(np.floor((mx + high + SLACK_PX) / TILE), np.float32(right)), np.float32(left - 1))
    return int(start), int(stop)


@compiled(error_model="numpy", inline="always")
def _side(xx, xy, narrow, reach, dy, sign):  # type: ignore[no-untyped-def]
    """Return where a row at dy leaves the ellipse: xx dx^2 + xy dx dy + yy dy^2 = -reach, xx below 0."""
    root = np.sqrt(max(-xx * reach - narrow * dy * dy, np.float32(0)))
    return (np.float32(-0.5) * xy * dy - sign * root) / xx
