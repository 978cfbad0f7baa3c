"""What splatting needs of sixteen numbers side by side beyond lanes.py: masks, broadcasts, logarithms."""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from nerf.kernels.cpu.lanes import (
    _F32,
    _FLOATS,
    _I32,
    _INTS,
    WIDTH,
    Floats,
    Ints,
    _call,
    _place,
    bits,
    everywhere,
    floats,
    fma,
    from_bits,
    ints,
    to_floats,
)
from priors.machine.compiled import compiled


@intrinsic
def spread(typing: Any, array: Any, index: Any) -> Any:
    """Return one float32 of a flat array in all 16 places."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        value = builder.load(_place(context, builder, sig.args[0], args[0], args[1], _F32), align=4)
        return everywhere(builder, value, _FLOATS)

    return Floats(array, types.int64), gen


@intrinsic
def lanes(typing: Any) -> Any:
    """Return the ints 0 to 15."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return ir.Constant(_INTS, list(range(WIDTH)))

    return Ints(), gen


@intrinsic
def kept(typing: Any, a: Any, least: Any, value: Any) -> Any:
    """Return values where a >= least, else 0; 0 too where either is not a number."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        there = builder.fcmp_ordered(">=", args[0], args[1])
        return builder.select(there, args[2], ir.Constant(_FLOATS, [0.0] * WIDTH))

    return Floats(Floats, Floats, Floats), gen


@intrinsic
def picked(typing: Any, a: Any, least: Any, value: Any, other: Any) -> Any:
    """Return values where a >= least, else the others."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered(">=", args[0], args[1]), args[2], args[3])

    return Floats(Floats, Floats, Floats, Floats), gen


@intrinsic
def which(typing: Any, a: Any, least: Any) -> Any:
    """Return a bit a lane, the first the lowest: whether a >= least."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        there = builder.fcmp_ordered(">=", args[0], args[1])
        return builder.zext(builder.bitcast(there, ir.IntType(WIDTH)), ir.IntType(64))

    return types.int64(Floats, Floats), gen


@intrinsic
def low_bytes(typing: Any, value: Any) -> Any:
    """Return the low bytes of the first 8 ints, the first the lowest."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        small = builder.trunc(args[0], ir.VectorType(ir.IntType(8), WIDTH))
        first = ir.Constant(ir.VectorType(_I32, 8), list(range(8)))
        return builder.bitcast(builder.shuffle_vector(small, small, first), ir.IntType(64))

    return types.uint64(Ints), gen


@intrinsic
def last_bit(typing: Any, value: Any) -> Any:
    """Return the place of the lowest bit of a word that is not 0."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        known = ir.Constant(ir.IntType(1), 1)
        return _call(builder, "llvm.cttz.i64", ir.IntType(64), [args[0], known])

    return types.int64(types.uint64), gen


@intrinsic
def load_some(typing: Any, array: Any, index: Any, count: Any) -> Any:
    """Return at most 16 float32 of a flat array, from an index on; the other lanes are 0, and not read."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = _place(context, builder, sig.args[0], args[0], args[1], _FLOATS)
        rest = ir.Constant(_FLOATS, [0.0] * WIDTH)
        arguments = [place, ir.Constant(_I32, 4), _first(builder, args[2]), rest]
        return _call(builder, "llvm.masked.load.v16f32.p0", _FLOATS, arguments)

    return Floats(array, types.int64, types.int64), gen


@intrinsic
def store_some(typing: Any, array: Any, index: Any, count: Any, value: Any) -> Any:
    """Write the first floats, at most 16, to a flat array, from an index on."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = _place(context, builder, sig.args[0], args[0], args[1], _FLOATS)
        arguments = [args[3], place, ir.Constant(_I32, 4), _first(builder, args[2])]
        _call(builder, "llvm.masked.store.v16f32.p0", ir.VoidType(), arguments)
        return context.get_dummy_value()

    return types.void(array, types.int64, types.int64, Floats), gen


def _first(builder: Any, count: Any) -> Any:
    """Emit a mask of the first lanes."""
    most = everywhere(builder, builder.trunc(count, _I32), _INTS)
    return builder.icmp_signed("<", ir.Constant(_INTS, list(range(WIDTH))), most)


@compiled
def power_of_two(x):  # type: ignore[no-untyped-def]
    """Return 2^x for x in [-126, 127], relative error below 3e-7; beyond, anything. Minimax polynomial."""
    magic = floats(12582912.0)  # 1.5 * 2^23: what is added to it is rounded to a whole number
    shifted = x + magic
    f = x - (shifted - magic)
    p = fma(f, floats(1.32765e-3), floats(9.67554e-3))
    p = fma(f, p, floats(5.550713e-2))
    p = fma(f, p, floats(2.402212e-1))
    p = fma(f, p, floats(6.9314697e-1))
    p = fma(f, p, floats(1.00000007))
    return from_bits(bits(p) + (bits(shifted) << ints(23)))


@compiled
def binary_logarithm(x):  # type: ignore[no-untyped-def]
    """Return log2(x) of normal numbers above 0, error below 3e-7 (1 + |log2 x|); the series of artanh."""
    pattern = bits(x)
    exponent = (pattern - ints(0x3F3504F3)) >> ints(23)  # of a mantissa in [sqrt(1/2), sqrt(2))
    exponent = exponent - ((exponent >> ints(8)) << ints(9))  # the shift is logical: bring the sign back
    m = from_bits(pattern - (exponent << ints(23)))
    s = (m - floats(1.0)) / (m + floats(1.0))
    square = s * s
    p = fma(square, floats(0.32059889), floats(0.41219858))
    p = fma(square, p, floats(0.57707802))
    p = fma(square, p, floats(0.96179669))
    p = fma(square, p, floats(2.88539008))
    return fma(s, p, to_floats(exponent))
