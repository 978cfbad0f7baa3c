"""MLPs on CPUs: a chunk of samples goes through all layers in the core's cache.

Activations are words of two bfloat16, rows 2j and 2j + 1 of 16 samples side by side: (groups of 16 samples, row pairs,
16). That is what the grid writes and what a tile product reads; products and their sums are float32. The backward
pass computes the chunk's forward pass again rather than keep it. Row pairs are padded with zeros to a multiple of 16.
Every kind of CPU rounds at the same places, those of nerf/twin/field.py with `half`; only its products differ.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nerf.kernels.cpu.lanes import (
    exponential,
    floats,
    from_bits,
    gather,
    ints,
    larger,
    load_floats,
    load_ints,
    smaller,
    store,
    transpose,
    where_nonzero,
)
from nerf.kernels.cpu.layers import Net, Operands, Totals
from nerf.kernels.cpu.products import OPERAND, TILE, begin, end, pack, product, product_added, store_operand
from priors.machine.compiled import compiled

Words = npt.NDArray[np.int32]
Numbers = npt.NDArray[np.float32]
CHUNK_GROUPS = 16  # of 16 samples in a chunk; a multiple of 4
WORDS = 1 if OPERAND is np.int32 else 2
"""Numbers of an operand for a word."""
PARTS = 32  # the samples' parts, whose weight gradients are added in order, whoever did them

# Arguments of compiled functions are wrapped, np.int64(1): a bare literal would have them compiled once more.


class Inputs(NamedTuple):
    """What a field is inputs."""

    features: Words
    """(levels, m) words of two features."""
    basis: Words
    """(8 r,) words of two harmonics of each ray's direction; empty: no colour."""
    ray: Words
    """(m,) index of the sample's ray; below 0: any."""


class Work(NamedTuple):
    """A thread's room for a chunk: inputs and rectified outputs of the layers, gradients, operands."""

    x: Words
    first: Words
    seen: Words
    second: Words
    third: Words
    last: Words
    d_one: Words
    d_two: Words
    left: Operands
    right: Words
    sums: Numbers
    triples: Words


@compiled
def _aligned(count, kind):  # type: ignore[no-untyped-def]
    """Return zeros that start at a cache line."""
    array = np.zeros(count + 16, dtype=kind)
    start = (64 - array.ctypes.data % 64) % 64 // 4
    return array[start : start + count]


@compiled
def _multiply(weights, tile, pairs, rows, x, group, sums):  # type: ignore[no-untyped-def]
    """Multiply a row of weight tiles with 4 groups of samples: sums (4, 16 outputs, 16 samples), of which `rows` count.

    pairs: of inputs that are not padding.
    """
    step = (pairs + 15) // 16 * TILE
    product(sums, np.int64(0), weights, tile * step, x, group * step, step, pairs, rows, np.int64(4))


@compiled
def _rectified(weights, tiles, pairs, x, out, groups, sums):  # type: ignore[no-untyped-def]
    """out = max(weights x, 0)."""
    zero = floats(0.0)
    step = (tiles + 1) // 2 * TILE
    for group in range(0, groups, 4):
        for tile in range(tiles):
            _multiply(weights, tile, pairs, np.int64(16), x, group, sums)
            for g in range(4):
                place = (group + g) * step + tile * 128
                for j in range(8):
                    low = larger(zero, load_floats(sums, g * TILE + 32 * j))  # NaN stays: the second is kept
                    high = larger(zero, load_floats(sums, g * TILE + 32 * j + 16))
                    store(out, place + 16 * j, pack(low, high))


@compiled
def _returned(weights, tiles, pairs, d_out, x, d_x, groups, sums):  # type: ignore[no-untyped-def]
    """d_x = weights^T d_out where x, which was rectified, is not 0; `weights` are the transpose's tiles."""
    step = (tiles + 1) // 2 * TILE
    for group in range(0, groups, 4):
        for tile in range(tiles):
            _multiply(weights, tile, pairs, np.int64(16), d_out, group, sums)
            for g in range(4):
                place = (group + g) * step + tile * 128
                for j in range(8):
                    was = load_ints(x, place + 16 * j)
                    low = where_nonzero(was & ints(0xFFFF), load_floats(sums, g * TILE + 32 * j))
                    high = where_nonzero(was & ints(-65536), load_floats(sums, g * TILE + 32 * j + 16))
                    store(d_x, place + 16 * j, pack(low, high))


@compiled
def _pair_samples(x, depth, tile, group, row):  # type: ignore[no-untyped-def]
    """Return rows 2 row and 2 row + 1 of 16, of 2 groups, as words of two samples: lane s of one and of the other."""
    place = group * depth * TILE + tile * 128 + 16 * row
    one, two = load_ints(x, place), load_ints(x, place + depth * TILE)
    return (one & ints(0xFFFF)) | (two << ints(16)), (one >> ints(16)) | (two & ints(-65536))


@compiled
def _accumulate(d_out, tiles, rows, x, depth, groups, left, right, total):  # type: ignore[no-untyped-def]
    """total += d_out x^T: tiles (out / 16, in / 16) of 16 x 16 float32, of whose outputs `rows` are no padding."""
    pairs, columns = groups // 2, 2 * depth
    for tile in range(tiles):
        for p in range(pairs):
            place = (tile * pairs + p) * TILE
            for row in range(8):
                even, odd = _pair_samples(d_out, (tiles + 1) // 2, tile, 2 * p, row)
                store_operand(left, place + 32 * row, even)
                store_operand(left, place + 32 * row + 16, odd)
    for tile in range(columns):
        for p in range(pairs):
            place = (tile * pairs + p) * TILE
            for row in range(8):
                even, odd = _pair_samples(x, depth, tile, 2 * p, row)
                store(right, place + 32 * row, even)
                store(right, place + 32 * row + 16, odd)
            transpose(right, place, place)
    step = pairs * TILE
    for tile in range(tiles):
        start = tile * columns * TILE
        product_added(total, start, left, tile * step, right, np.int64(0), step, 16 * pairs, rows, columns)


@compiled
def _densities(weights, pairs, hidden, seen, groups, initial, sums, sigma, first):  # type: ignore[no-untyped-def]
    """Write densities, and the geometry to the upper half of the colour's input."""
    for group in range(0, groups, 4):
        _multiply(weights, np.int64(0), pairs, np.int64(16), hidden, group, sums)
        for g in range(4):
            logit = smaller(floats(12.0), load_floats(sums, g * TILE))  # LOGIT_MAX of the twin
            store(sigma, first + 16 * (group + g), exponential(logit) * floats(np.float32(initial)))
            for j in range(8):
                low, high = load_floats(sums, g * TILE + 32 * j), load_floats(sums, g * TILE + 32 * j + 16)
                store(seen, (group + g) * TILE + 128 + 16 * j, pack(low, high))


@compiled
def _colours(weights, pairs, hidden, groups, sums, rgb, first):  # type: ignore[no-untyped-def]
    """Write colours (m, 3): the sigmoid of the last layer."""
    one, zero = floats(1.0), floats(0.0)
    for group in range(0, groups, 4):
        _multiply(weights, np.int64(0), pairs, np.int64(4), hidden, group, sums)
        for g in range(4):
            start = 3 * (first + 16 * (group + g))
            for channel in range(3):
                place = g * TILE + 16 * channel
                store(sums, place, one / (one + exponential(zero - load_floats(sums, place))))
                for lane in range(16):
                    rgb[start + 3 * lane + channel] = sums[place + lane]


@compiled
def _forward(net, inputs, initial, first, groups, work, sigma, rgb, target):  # type: ignore[no-untyped-def]
    """Take a chunk through both networks; results go to `target` on, activations stay in `work`."""
    levels, hidden = inputs.features.shape[0], 8 * net.tiles  # pairs of inputs
    for group in range(groups):
        for level in range(levels):
            store(work.x, group * TILE + 16 * level, load_ints(inputs.features[level], first + 16 * group))
    _rectified(net.density0, net.tiles, levels, work.x, work.first, groups, work.sums)
    _densities(net.density1, hidden, work.first, work.seen, groups, initial, work.sums, sigma, target)
    if inputs.basis.size:
        for group in range(groups):
            row = larger(load_ints(inputs.ray, first + 16 * group), ints(0)) << ints(3)
            for j in range(8):
                store(work.seen, group * TILE + 16 * j, gather(inputs.basis, np.int64(j), row))
        _rectified(net.colour0, net.tiles, np.int64(16), work.seen, work.second, groups, work.sums)
        _rectified(net.colour1, net.tiles, hidden, work.second, work.third, groups, work.sums)
        _colours(net.colour2, hidden, work.third, groups, work.sums, rgb, target)


@compiled
def _colours_back(net, back, work, total, d_rgb, rgb, first, groups):  # type: ignore[no-untyped-def]
    """Take the gradient of a chunk's colours back to the first layer that only colour has; `rgb` is the chunk's own."""
    depth = (net.tiles + 1) // 2
    one, zero, triples = floats(1.0), floats(0.0), load_ints(work.triples, 0)
    for group in range(groups):
        for j in range(2):
            low = high = zero
            for channel in range(2 * j, min(2 * j + 2, 3)):
                y = from_bits(gather(rgb, np.int64(48 * group + channel), triples))
                d = from_bits(gather(d_rgb, np.int64(3 * (first + 16 * group) + channel), triples)) * y * (one - y)
                low, high = (low, d) if channel % 2 else (d, high)
            store(work.last, group * TILE + 16 * j, pack(low, high))
    _accumulate(work.last, np.int64(1), np.int64(4), work.third, depth, groups, work.left, work.right, total.colour2)
    _returned(back.colour2, net.tiles, np.int64(2), work.last, work.third, work.d_one, groups, work.sums)
    _accumulate(work.d_one, net.tiles, np.int64(16), work.second, depth, groups, work.left, work.right, total.colour1)
    _returned(back.colour1, net.tiles, 8 * net.tiles, work.d_one, work.second, work.d_two, groups, work.sums)
    _accumulate(
        work.d_two, net.tiles, np.int64(16), work.seen, np.int64(1), groups, work.left, work.right, total.colour0
    )


@compiled
def _geometry_back(net, back, work, d_sigma, sigma, coloured, first, groups):  # type: ignore[no-untyped-def]
    """Write the gradient of the first network's outputs: of the geometry, from colour, and of the logit."""
    for group in range(0, groups, 4):
        if coloured:
            _multiply(back.colour0, np.int64(1), 8 * net.tiles, np.int64(16), work.d_two, group, work.sums)
        else:
            work.sums[:] = 0
        for g in range(4):
            place = 16 * (group + g)
            d_logit = load_floats(d_sigma, first + place) * load_floats(sigma, place)
            store(work.sums, g * TILE, load_floats(work.sums, g * TILE) + d_logit)
            for j in range(8):
                low = load_floats(work.sums, g * TILE + 32 * j)
                high = load_floats(work.sums, g * TILE + 32 * j + 16)
                store(work.last, (group + g) * TILE + 16 * j, pack(low, high))


@compiled
def _features_back(net, back, work, first, groups, d_features):  # type: ignore[no-untyped-def]
    """Write the gradient of the features, (levels, m)."""
    for group in range(0, groups, 4):
        for level in range(d_features.shape[0]):
            if level % 8 == 0:
                _multiply(back.density0, level // 8, 8 * net.tiles, np.int64(16), work.d_one, group, work.sums)
            for g in range(4):
                low = load_floats(work.sums, g * TILE + level % 8 * 32)
                high = load_floats(work.sums, g * TILE + level % 8 * 32 + 16)
                store(d_features[level], first + 16 * (group + g), pack(low, high))


@compiled
def _workspace(tiles):  # type: ignore[no-untyped-def]
    """Return a thread's room for a chunk."""
    wide = (tiles + 1) // 2 * CHUNK_GROUPS * TILE
    narrow = CHUNK_GROUPS * TILE
    return Work(
        x=_aligned(narrow, np.int32),
        first=_aligned(wide, np.int32),
        seen=_aligned(narrow, np.int32),
        second=_aligned(wide, np.int32),
        third=_aligned(wide, np.int32),
        last=_aligned(narrow, np.int32),
        d_one=_aligned(wide, np.int32),
        d_two=_aligned(wide, np.int32),
        left=_aligned(wide * WORDS, OPERAND),
        right=_aligned(wide, np.int32),
        sums=_aligned(4 * TILE, np.float32),
        triples=np.arange(0, 48, 3).astype(np.int32),
    )


@compiled
def forward(net: Net, inputs: Inputs, initial: float, sigma: Numbers, rgb: Numbers, first: int, last: int) -> None:
    """Write densities (m,) and, if there is a basis, colours (3 m,) of samples first to last, multiples of 64."""
    begin()
    work = _workspace(net.tiles)
    for start in range(first, last, 16 * CHUNK_GROUPS):
        groups = min(CHUNK_GROUPS, (last - start) // 16)
        _forward(net, inputs, initial, start, groups, work, sigma, rgb, start)
    end()


@compiled
def backward(
    net: Net,
    back: Net,
    inputs: Inputs,
    initial: float,
    d_outputs: tuple[Numbers, Numbers],
    d_features: Words,
    totals: Totals,
    stretch: int,
    first: int,
    last: int,
) -> None:
    """Write the gradient of the features (levels, m) of parts first to last, and that of the weights by each part.

    `back`: the transposes of `net`; d_outputs: by density (m,) and by colour (3 m,), or empty; `stretch`: samples of a
    part, a multiple of 64. The gradient's sum goes chunk by chunk: other parts, another rounding.
    """
    begin()
    work = _workspace(net.tiles)
    sigma = np.empty(16 * CHUNK_GROUPS, dtype=np.float32)
    rgb = np.empty(48 * CHUNK_GROUPS, dtype=np.float32)
    for part in range(first, last):
        total = _part(totals, part)
        end_of_part = min((part + 1) * stretch, inputs.features.shape[1])
        for start in range(part * stretch, end_of_part, 16 * CHUNK_GROUPS):
            groups = min(CHUNK_GROUPS, (end_of_part - start) // 16)
            _forward(net, inputs, initial, start, groups, work, sigma, rgb, np.int64(0))
            _chunk_back(net, back, work, total, d_outputs, (sigma, rgb), start, groups, d_features)
    end()


@compiled
def _part(totals, part):  # type: ignore[no-untyped-def]
    """Return a part's totals, set to zero."""
    total = Totals(
        totals.density0[part], totals.density1[part], totals.colour0[part], totals.colour1[part], totals.colour2[part]
    )
    for each in total:
        each[:] = 0
    return total


@compiled
def _chunk_back(net, back, work, total, d_outputs, outputs, start, groups, d_features):  # type: ignore[no-untyped-def]
    """Take a chunk's gradient back through both networks; `outputs`: its densities and colours."""
    (d_sigma, d_rgb), (sigma, rgb), depth = d_outputs, outputs, (net.tiles + 1) // 2
    coloured = d_rgb.size > 0
    if coloured:
        work.last[:] = 0
        _colours_back(net, back, work, total, d_rgb, rgb, start, groups)
    _geometry_back(net, back, work, d_sigma, sigma, coloured, start, groups)
    _accumulate(work.last, np.int64(1), np.int64(16), work.first, depth, groups, work.left, work.right, total.density1)
    _returned(back.density1, net.tiles, np.int64(8), work.last, work.first, work.d_one, groups, work.sums)
    _accumulate(work.d_one, net.tiles, np.int64(16), work.x, np.int64(1), groups, work.left, work.right, total.density0)
    _features_back(net, back, work, start, groups, d_features)
