"""x86 intrinsics without a general name in LLVM: AMX's matrix tiles, and AVX-512's dot product of bfloat16.

A product of tiles adds C (16 x 16 float32) += A (16 x 32 bfloat16) B (32 x 16 bfloat16), where a row of B holds two
rows of the matrix side by side: word (k, n) is (b[2k, n], b[2k + 1, n]). There are eight tile registers, 0 to 7, of 16
rows of 64 bytes; their numbers are literals. See Intel's "Architecture Instruction Set Extensions Programming
Reference", chapter 3. The dot product does the same for one row of A at a time.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from nerf.kernels.cpu.lanes import _INTS, Floats, Ints, _call, _place

_I8, _I64 = ir.IntType(8), ir.IntType(64)


def configuration() -> "np.ndarray[Any, np.dtype[np.uint8]]":
    """Return what `configure` takes: eight tiles of 16 rows of 64 bytes."""
    config = np.zeros(64, dtype=np.uint8)
    config[0] = 1  # the palette
    config[16:32].view(np.uint16)[:] = 64
    config[48:56] = 16
    return config


@intrinsic
def configure(typing: Any, config: Any) -> Any:
    """Set up this thread's tiles; `release` them afterwards."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = _place(context, builder, sig.args[0], args[0], _I64(0), _I8)
        _call(builder, "llvm.x86.ldtilecfg", ir.VoidType(), [place])
        return context.get_dummy_value()

    return types.void(config), gen


@intrinsic
def release(typing: Any) -> Any:
    """Give this thread's tiles back."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        _call(builder, "llvm.x86.tilerelease", ir.VoidType(), [])
        return context.get_dummy_value()

    return types.void(), gen


@intrinsic(prefer_literal=True)
def tile_zero(typing: Any, tile: Any) -> Any:
    """Clear a tile."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        _call(builder, "llvm.x86.tilezero", ir.VoidType(), [_I8(tile.literal_value)])
        return context.get_dummy_value()

    return types.void(tile), gen


def _mover(name: str, doc: str) -> Any:
    def move(typing: Any, tile: Any, array: Any, index: Any) -> Any:
        def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            place = _place(context, builder, sig.args[1], args[1], args[2], _I8)
            _call(builder, name, ir.VoidType(), [_I8(tile.literal_value), place, _I64(64)])
            return context.get_dummy_value()

        return types.void(tile, array, types.int64), gen

    move.__doc__ = doc
    return intrinsic(prefer_literal=True)(move)


tile_load = _mover("llvm.x86.tileloadd64", "Fill a tile with 256 words of a flat array, from an index on.")
tile_store = _mover("llvm.x86.tilestored64", "Write a tile to 256 words of a flat array, from an index on.")


@intrinsic(prefer_literal=True)
def tile_product(typing: Any, total: Any, left: Any, right: Any) -> Any:
    """Add the product of two tiles of bfloat16 to one of float32."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        numbers = [_I8(tile.literal_value) for tile in (total, left, right)]
        _call(builder, "llvm.x86.tdpbf16ps", ir.VoidType(), numbers)
        return context.get_dummy_value()

    return types.void(total, left, right), gen


@intrinsic
def pack_fast(typing: Any, low: Any, high: Any) -> Any:
    """Return two floats as bfloat16 in the halves of ints, as lanes.pack, but for denormals, which become 0."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        halves = ir.VectorType(ir.IntType(16), 32)
        rounded = _call(builder, "llvm.x86.avx512bf16.cvtne2ps2bf16.512", halves, [args[1], args[0]])
        order = [lane + side for lane in range(16) for side in (0, 16)]
        pairs = builder.shuffle_vector(rounded, rounded, ir.Constant(ir.VectorType(ir.IntType(32), 32), order))
        return builder.bitcast(pairs, _INTS)

    return Ints(Floats, Floats), gen


def dot(builder: Any, total: Any, left: Any, right: Any) -> Any:
    """Emit total + a b + c d of 16 float32 and of 16 words (a, c) and (b, d) of two bfloat16 each."""
    return _call(builder, "llvm.x86.avx512bf16.dpbf16ps.512", total.type, [total, left, right])
