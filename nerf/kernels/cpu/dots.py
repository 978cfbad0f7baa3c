"""Products of tiles on vector registers: 16 samples side by side, a few outputs and groups of samples at a time.

Shapes as in tiles.py. The operands stay bfloat16 where the CPU multiplies pairs of them (A holds words of two).
Elsewhere A was widened to float32 beforehand, and B is widened as it is read: the same numbers, products and sums in
float32.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from nerf.kernels.cpu import x86
from nerf.kernels.cpu.lanes import (
    _F32,
    _FLOATS,
    _I32,
    _INTS,
    TILE,
    _call,
    _place,
    everywhere,
    high_float,
    low_float,
    store,
    store_pairs,
)
from priors.machine.compiled import compiled
from priors.machine.cpu import mode

PAIRED = mode() == "avx512_bf16"
"""Whether this mode has a product of pairs of bfloat16."""
OUTPUTS, GROUPS = {"avx512_bf16": (8, 2), "avx512": (8, 2), "avx2": (2, 2)}.get(mode(), (2, 1))
"""What a register block holds: the sums of so many outputs and groups of 16 samples; the fastest of those measured.

Groups divide 2: a layer's gradient may have no more columns of tiles.
"""
OPERAND: type[np.int32] | type[np.float32] = np.int32 if PAIRED else np.float32
"""The type of A: a word of two bfloat16, or two float32."""

_I64 = ir.IntType(64)


def _halves(builder: Any, words: Any) -> tuple[Any, Any]:
    """Emit the two bfloat16 of words as float32."""
    low, high = (
        builder.shl(words, ir.Constant(_INTS, [16] * 16)),
        builder.and_(words, ir.Constant(_INTS, [-65536] * 16)),
    )
    return builder.bitcast(low, _FLOATS), builder.bitcast(high, _FLOATS)


def _row(builder: Any, a: Any, place: Any, output: int) -> list[Any]:
    """Emit what A holds for an output and a pair of inputs, in all lanes; `a` tells the address of an index."""
    start = builder.add(place, _I64(16 * output))
    if PAIRED:
        return [everywhere(builder, builder.load(a(start, _I32), align=4), _INTS)]
    start = builder.shl(start, _I64(1))
    addresses = (a(builder.add(start, _I64(side)), _F32) for side in range(2))
    return [everywhere(builder, builder.load(address, align=4), _FLOATS) for address in addresses]


def _added(builder: Any, total: Any, row: list[Any], words: Any) -> Any:
    """Emit total + row x words."""
    if PAIRED:
        return x86.dot(builder, total, row[0], words)
    for weight, half in zip(row, _halves(builder, words), strict=True):
        total = _call(builder, "llvm.fmuladd.v16f32", _FLOATS, [weight, half, total])
    return total


def _blocker(adds: bool) -> Any:
    """Make the product of OUTPUTS rows and GROUPS groups: one loop over the inputs, all sums in registers."""

    def block(typing: Any, c: Any, start: Any, a: Any, first: Any, x: Any, place: Any, step: Any, pairs: Any) -> Any:
        def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            def address(number: int, index: Any, kind: Any) -> Any:
                return _place(context, builder, sig.args[number], args[number], index, kind)

            targets = [
                address(0, builder.add(args[1], _I64(TILE * group + 16 * output)), _FLOATS)
                for output in range(OUTPUTS)
                for group in range(GROUPS)
            ]
            none = ir.Constant(_FLOATS, [0.0] * 16)
            begin = [builder.load(target, align=4) if adds else none for target in targets]
            before, loop, end = builder.block, *(builder.append_basic_block(name) for name in ("pairs", "done"))
            builder.branch(loop)
            builder.position_at_end(loop)
            pair = builder.phi(_I64)
            pair.add_incoming(_I64(0), before)
            sums = [builder.phi(_FLOATS) for _ in begin]
            for total, value in zip(sums, begin, strict=True):
                total.add_incoming(value, before)
            # tiles of A follow each other, and in each a row has 16 words
            tile = builder.shl(builder.and_(pair, _I64(-16)), _I64(4))
            row = builder.add(builder.add(args[3], tile), builder.and_(pair, _I64(15)))
            column = builder.add(args[5], builder.shl(pair, _I64(4)))
            starts = [builder.add(column, builder.mul(args[6], _I64(group))) for group in range(GROUPS)]
            words = [builder.load(address(4, place, _INTS), align=4) for place in starts]
            found = []
            for output in range(OUTPUTS):
                weights = _row(builder, lambda index, kind: address(2, index, kind), row, output)
                found += [_added(builder, sums[output * GROUPS + g], weights, words[g]) for g in range(GROUPS)]
            after = builder.add(pair, _I64(1))
            for phi, value in zip([pair, *sums], [after, *found], strict=True):
                phi.add_incoming(value, builder.block)
            builder.cbranch(builder.icmp_signed("<", after, args[7]), loop, end)
            builder.position_at_end(end)
            for target, value in zip(targets, found, strict=True):
                builder.store(value, target, align=4)
            return context.get_dummy_value()

        whole = types.int64
        return types.void(c, whole, a, whole, x, whole, whole, whole), gen

    block.__doc__ = f"{'Add' if adds else 'Set'} a block of a product of tiles."
    return intrinsic(block)


_set_block, _add_block = _blocker(adds=False), _blocker(adds=True)


@compiled
def product(c, start, a, first, x, place, step, pairs, rows, groups):  # type: ignore[no-untyped-def]
    """C = A B for a row of tiles of A, from index `first` on, and `groups` groups of x, `step` words apart.

    pairs: of inputs, what follows is padding; rows: of C that are asked for.
    """
    for group in range(0, groups, GROUPS):
        for output in range(0, rows, OUTPUTS):
            to, row, column = start + group * TILE + 16 * output, first + 16 * output, place + group * step
            _set_block(c, to, a, row, x, column, step, pairs)


@compiled
def product_added(c, start, a, first, x, place, step, pairs, rows, groups):  # type: ignore[no-untyped-def]
    """C += A B; arguments as `product` has them."""
    for group in range(0, groups, GROUPS):
        for output in range(0, rows, OUTPUTS):
            to, row, column = start + group * TILE + 16 * output, first + 16 * output, place + group * step
            _add_block(c, to, a, row, x, column, step, pairs)


@compiled
def store_operand(a, place, words):  # type: ignore[no-untyped-def]
    """Write 16 words of two bfloat16 to A, from word `place` on."""
    if PAIRED:
        store(a, place, words)
    else:
        store_pairs(a, 2 * place, low_float(words), high_float(words))


@compiled
def begin():  # type: ignore[no-untyped-def]
    """Nothing has to be set up."""


@compiled
def end():  # type: ignore[no-untyped-def]
    """Nothing has to be given back."""
