"""Products of 16 x 16 tiles on matrix tiles, C = A B: what both small networks consist of.

A tile of A is 16 outputs x 16 words of two bfloat16 (32 inputs), of B 16 words (32 inputs) x 16 samples, of C 16
outputs x 16 samples of float32; each is 256 words of a flat array. Where ROADPRIOR_CPU says amx_emulated, the one
instruction that multiplies is replaced by ordinary code that does the same, and the tile registers by memory.
"""

import numpy as np

from nerf.kernels.cpu.lanes import (
    TILE,
    floats,
    fma,
    high_float,
    ints,
    load_floats,
    load_int,
    load_ints,
    low_float,
    store,
)
from nerf.kernels.cpu.x86 import configuration, configure, release, tile_load, tile_product, tile_store, tile_zero
from priors.machine.compiled import compiled
from priors.machine.cpu import mode

OPERAND: type[np.int32] | type[np.float32] = np.int32
EMULATED = mode() == "amx_emulated"
_SETUP = configuration()


@compiled
def _emulated(c, start, a, first, x, place):  # type: ignore[no-untyped-def]
    """Add the product of two tiles: what TDPBF16PS does, word by word."""
    for output in range(16):
        total = load_floats(c, start + 16 * output)
        for k in range(16):
            weights = ints(np.int32(load_int(a, first + 16 * output + k)))
            words = load_ints(x, place + 16 * k)
            total = fma(low_float(weights), low_float(words), total)
            total = fma(high_float(weights), high_float(words), total)
        store(c, start + 16 * output, total)


@compiled
def _emulated_product(c, start, a, first, x, place, step, depth, groups):  # type: ignore[no-untyped-def]
    for group in range(groups):
        for k in range(depth):
            _emulated(c, start + group * TILE, a, first + k * TILE, x, place + group * step + k * TILE)


@compiled
def product(c, start, a, first, x, place, step, pairs, rows, groups):  # type: ignore[no-untyped-def]
    """C = A B for a row of tiles of A, from index `first` on, and `groups` groups of x, `step` words apart.

    C has `groups` tiles, from index `start` on. pairs: of inputs, what follows is padding; rows: of C that are asked
    for, the others cost nothing; groups: a multiple of 4.
    """
    depth = (pairs + 15) // 16
    if EMULATED:
        for i in range(start, start + groups * TILE, 16):
            store(c, i, floats(0.0))
        _emulated_product(c, start, a, first, x, place, step, depth, groups)
        return
    for group in range(0, groups, 4):
        tile_zero(0)
        tile_zero(1)
        tile_zero(2)
        tile_zero(3)
        for k in range(depth):
            tile_load(4, a, first + k * TILE)
            at = place + group * step + k * TILE
            tile_load(5, x, at)
            tile_product(0, 4, 5)
            tile_load(6, x, at + step)
            tile_product(1, 4, 6)
            tile_load(7, x, at + 2 * step)
            tile_product(2, 4, 7)
            tile_load(5, x, at + 3 * step)
            tile_product(3, 4, 5)
        to = start + group * TILE
        tile_store(0, c, to)
        tile_store(1, c, to + TILE)
        tile_store(2, c, to + 2 * TILE)
        tile_store(3, c, to + 3 * TILE)


@compiled
def product_added(c, start, a, first, x, place, step, pairs, rows, groups):  # type: ignore[no-untyped-def]
    """C += A B; arguments as `product` has them, but groups: a multiple of 2."""
    depth = (pairs + 15) // 16
    if EMULATED:
        _emulated_product(c, start, a, first, x, place, step, depth, groups)
        return
    for group in range(0, groups, 2):
        to = start + group * TILE
        tile_load(0, c, to)
        tile_load(1, c, to + TILE)
        for k in range(depth):
            at = place + group * step + k * TILE
            tile_load(2, a, first + k * TILE)
            tile_load(3, x, at)
            tile_product(0, 2, 3)
            tile_load(4, x, at + step)
            tile_product(1, 2, 4)
        tile_store(0, c, to)
        tile_store(1, c, to + TILE)


@compiled
def store_operand(a, place, words):  # type: ignore[no-untyped-def]
    """Write 16 words of two bfloat16 to A, from word `place` on."""
    store(a, place, words)


@compiled
def begin():  # type: ignore[no-untyped-def]
    """Set up this thread's tiles."""
    if not EMULATED:
        configure(_SETUP)


@compiled
def end():  # type: ignore[no-untyped-def]
    """Give this thread's tiles back."""
    if not EMULATED:
        release()
