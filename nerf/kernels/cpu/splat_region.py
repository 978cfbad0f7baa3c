"""A region's Gaussians in order of depth, and lists of those that reach each of its tiles, compiled."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.lanes import floats, fma, ints, larger, load_floats, root, smaller, store, to_floats, truncate
from nerf.kernels.cpu.splat_lanes import lanes, last_bit, low_bytes, spread
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
SIDE = REGION // TILE
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
    masks: npt.NDArray[np.uint64]
    """(most,)"""
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
    members, masks, order = regions.members, scratch.masks, scratch.order
    for k in range(count):
        row, copy = members[2 * (first + k)], members[2 * (first + k) + 1]
        masks[k] = np.uint64(row) << np.uint64(32) | np.uint64(copy)
    for k in range(count):
        both = masks[order[k]]
        members[2 * (first + k)] = np.int32(both >> np.uint64(32))
        members[2 * (first + k) + 1] = np.int32(both & np.uint64(0xFFFFFFFF))
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
    """Fill the lists of a region's tiles: those that a Gaussian's ellipse reaches. A bit of a word is a tile."""
    first, ends = regions.first_member[region], regions.ends[(TILES + 1) * region :]
    members, boxes, records, masks = regions.members, view.boxes, scratch.records, scratch.masks
    count, every = regions.first_member[region + 1] - first, np.uint64(0xFFFFFFFFFFFFFFFF)
    for tile in range(TILES + 1):
        ends[tile] = 0
    for k in range(count):
        left, right, top, bottom = box(boxes, members[np.uint64(2 * (first + k))])
        left, right = max(left - corner[0], 0) // TILE, min(right - corner[0], REGION - 1) // TILE
        low, high = max(top - corner[1], 0) // TILE, min(bottom - corner[1], REGION - 1) // TILE
        columns = (np.uint64(2) << np.uint64(right)) - (np.uint64(1) << np.uint64(left))
        mask = columns * np.uint64(0x0101010101010101)
        mask &= (every >> np.uint64(56 - 8 * high)) & (every << np.uint64(8 * low))
        if right > left and high > low:
            mask &= _reach(records, RECORD * k, corner)
        masks[k] = mask
        while mask:
            ends[np.uint64(last_bit(mask) + 1)] += 1
            mask &= mask - np.uint64(1)
    for tile in range(TILES):
        ends[tile + 1] += ends[tile]
    cursor, entries = np.empty(TILES, np.int64), regions.entries
    for tile in range(TILES):
        cursor[tile] = regions.first_entry[region] + ends[tile]
    for k in range(count):
        rest = masks[k]
        while rest:
            here = np.uint64(last_bit(rest))
            place = cursor[here]
            entries[np.uint64(place)] = k
            cursor[here] = place + 1
            rest &= rest - np.uint64(1)


@compiled
def _reach(records, at, corner):  # type: ignore[no-untyped-def]
    """Return a bit for each tile of a region whether an ellipse reaches it.

    The ellipse is xx dx^2 + xy dx dy + yy dy^2 = -reach, xx and yy below 0. Along a band of rows its end in x is its
    own where that lies in the band, else where the band's nearer side cuts it. A lane is a row of tiles.
    """
    xx, xy = spread(records, at + XX), spread(records, at + XY)
    wide, narrow = spread(records, at + WIDE), spread(records, at + NARROW)
    none, one, half = floats(np.float32(0)), floats(np.float32(1)), floats(np.float32(-0.5))
    mx = spread(records, at + X) - floats(np.float32(corner[0]))
    above = to_floats((lanes() & ints(SIDE - 1)) * ints(TILE)) - floats(SLACK_PX)
    above = above - (spread(records, at + Y) - floats(np.float32(corner[1])))
    below = above + floats(np.float32(TILE - 1) + np.float32(2) * SLACK_PX)
    turn = half * xy / spread(records, at + YY) * wide  # dy of the ellipse's right end
    slack = fma(floats(SLACK_SHARE), wide, floats(SLACK_PX))  # rounding must not lose a pixel
    inverse, base = one / xx, none - xx * spread(records, at + REACH)
    dy = smaller(larger(turn, above), below)
    right = (half * xy * dy - root(larger(base - narrow * dy * dy, none))) * inverse + slack
    dy = smaller(larger(none - turn, above), below)
    left = (half * xy * dy + root(larger(base - narrow * dy * dy, none))) * inverse - slack
    side, share = floats(np.float32(SIDE)), floats(np.float32(1 / TILE))
    stop = truncate(smaller(larger(fma(mx + right, share, one), none), side))
    start = smaller(larger(fma(mx + left, share, floats(np.float32(-(TILE - 1) / TILE))), none), side)
    start = ints(SIDE) - truncate(side - start)
    return low_bytes(larger((ints(1) << stop) - (ints(1) << start), ints(0)))
