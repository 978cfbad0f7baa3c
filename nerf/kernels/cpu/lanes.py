"""SIMD: sixteen numbers side by side as values of compiled code: LLVM's own vectoriser makes no gathers.

`Floats` and `Ints` (16 x float32, 16 x int32) can be added, multiplied and combined bitwise in `@compiled` functions;
the functions below load, store, gather and convert them. LLVM turns each into one instruction with AVX-512 and into a
few with AVX2 or NEON, so kernels written with them run everywhere. Indices are not checked.
"""

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import datamodel
from numba.core.errors import TypingError
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from priors.machine.compiled import compiled

WIDTH = 16
TILE = WIDTH * WIDTH
"""Words of a tile: 16 rows of 16."""

_I32, _F32 = ir.IntType(32), ir.FloatType()
_INTS, _FLOATS = ir.VectorType(_I32, WIDTH), ir.VectorType(_F32, WIDTH)


class _Lanes(types.Type):  # type: ignore[misc]
    """The numba type of sixteen numbers side by side."""


class _FloatLanes(_Lanes):
    def __init__(self) -> None:
        super().__init__(name="Floats")


class _IntLanes(_Lanes):
    def __init__(self) -> None:
        super().__init__(name="Ints")


Floats, Ints = _FloatLanes(), _IntLanes()


@register_model(_FloatLanes)
class _FloatsModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: datamodel.DataModelManager, kind: types.Type) -> None:
        super().__init__(manager, kind, _FLOATS)


@register_model(_IntLanes)
class _IntsModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: datamodel.DataModelManager, kind: types.Type) -> None:
        super().__init__(manager, kind, _INTS)


def _operator(function: Callable[..., Any], float_name: str | None, int_name: str) -> None:
    """Let an operator work on two Floats (if LLVM has a name for it) and on two Ints."""
    kinds = [(Ints, int_name)] + ([(Floats, float_name)] if float_name else [])
    cases = [signature(kind, kind, kind) for kind, _ in kinds]
    infer_global(function)(type("Template", (ConcreteTemplate,), {"key": function, "cases": cases}))
    for kind, name in kinds:

        def lower(context: Any, builder: Any, sig: Any, args: Any, name: str = name) -> Any:
            return getattr(builder, name)(*args)

        lower_builtin(function, kind, kind)(lower)


_operator(operator.add, "fadd", "add")
_operator(operator.sub, "fsub", "sub")
_operator(operator.mul, "fmul", "mul")
_operator(operator.truediv, "fdiv", "sdiv")
_operator(operator.and_, None, "and_")
_operator(operator.or_, None, "or_")
_operator(operator.xor, None, "xor")
_operator(operator.lshift, None, "shl")
_operator(operator.rshift, None, "lshr")  # logical: zeros come in from the left


def _call(builder: Any, name: str, result: Any, args: list[Any]) -> Any:
    """Call an LLVM intrinsic by name."""
    kind = ir.FunctionType(result, [value.type for value in args])
    known = builder.module.globals.get(name)
    return builder.call(known or ir.Function(builder.module, kind, name), args)


def _place(context: Any, builder: Any, array_type: Any, array: Any, index: Any, element: Any) -> Any:
    """Return the address of an element of a flat array, as a pointer to `element`.

    Raises TypingError for an array whose numbers do not lie side by side: its strides would be overlooked.
    """
    if array_type.ndim != 1 or array_type.layout != "C":
        raise TypingError(f"expected a flat contiguous array, found {array_type}: make it contiguous first")
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), element.as_pointer())


def _loader(kind: Any, vector: Any, doc: str) -> Any:
    def load(typing: Any, array: Any, index: Any) -> Any:
        def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            place = _place(context, builder, sig.args[0], args[0], args[1], vector)
            return builder.load(place, align=4)

        return kind(array, types.int64), gen

    load.__doc__ = doc
    return intrinsic(load)


load_floats = _loader(Floats, _FLOATS, "Return 16 float32 of a flat array, from an index on.")
load_ints = _loader(Ints, _INTS, "Return 16 int32 of a flat array, from an index on.")


@intrinsic
def load_int(typing: Any, array: Any, index: Any) -> Any:
    """Return one int32 of a flat array as int64."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        value = builder.load(_place(context, builder, sig.args[0], args[0], args[1], _I32), align=4)
        return builder.sext(value, ir.IntType(64))

    return types.int64(array, types.int64), gen


@intrinsic
def store(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """Write 16 float32 or int32 to a flat array, from an index on."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = _place(context, builder, sig.args[0], args[0], args[1], args[2].type)
        builder.store(args[2], place, align=4)
        return context.get_dummy_value()

    return types.void(array, types.int64, value), gen


@intrinsic
def store_halves(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """Write the low 16 bits of 16 ints to a flat array of int16, from an index on."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        halves = builder.trunc(args[2], ir.VectorType(ir.IntType(16), WIDTH))
        place = _place(context, builder, sig.args[0], args[0], args[1], halves.type)
        builder.store(halves, place, align=2)
        return context.get_dummy_value()

    return types.void(array, types.int64, Ints), gen


def everywhere(builder: Any, value: Any, vector: Any) -> Any:
    """Emit a vector of 16 times one value."""
    lane = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(_I32, 0))
    return builder.shuffle_vector(lane, ir.Constant(vector, ir.Undefined), ir.Constant(_INTS, [0] * WIDTH))


def _splatter(kind: Any, scalar: Any, vector: Any, doc: str) -> Any:
    def splat(typing: Any, value: Any) -> Any:
        def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return everywhere(builder, args[0], vector)

        return kind(scalar), gen

    splat.__doc__ = doc
    return intrinsic(splat)


floats = _splatter(Floats, types.float32, _FLOATS, "Return one float32 in all 16 places.")
ints = _splatter(Ints, types.int32, _INTS, "Return one int32 in all 16 places.")


def _converter(argument: Any, kind: Any, vector: Any, name: str, doc: str) -> Any:
    def convert(typing: Any, value: Any) -> Any:
        def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return getattr(builder, name)(args[0], vector)

        return kind(argument), gen

    convert.__doc__ = doc
    return intrinsic(convert)


truncate = _converter(Floats, Ints, _INTS, "fptosi", "Round floats towards zero to ints.")
to_floats = _converter(Ints, Floats, _FLOATS, "sitofp", "Convert ints to floats.")
bits = _converter(Floats, Ints, _INTS, "bitcast", "Return the bit patterns of floats.")
from_bits = _converter(Ints, Floats, _FLOATS, "bitcast", "Return the floats with these bit patterns.")


@intrinsic
def fma(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a * b + c of floats, rounded once where the CPU does that as fast as twice."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _call(builder, "llvm.fmuladd.v16f32", _FLOATS, list(args))

    return Floats(Floats, Floats, Floats), gen


@intrinsic
def root(typing: Any, a: Any) -> Any:
    """Return the square roots of floats."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _call(builder, "llvm.sqrt.v16f32", _FLOATS, list(args))

    return Floats(Floats), gen


def _picker(compare: str, doc: str) -> Any:
    def pick(typing: Any, a: Any, b: Any) -> Any:
        def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            if args[0].type == _FLOATS:
                first = builder.fcmp_ordered(compare, args[0], args[1])
            else:
                first = builder.icmp_signed(compare, args[0], args[1])
            return builder.select(first, args[0], args[1])

        return a(a, a), gen

    pick.__doc__ = doc
    return intrinsic(pick)


smaller = _picker("<", "Return the smaller of two, lane by lane; the second where either is not a number.")
larger = _picker(">", "Return the larger of two, lane by lane; the second where either is not a number.")


@intrinsic
def where_nonzero(typing: Any, test: Any, value: Any) -> Any:
    """Return floats where the ints are not 0, else 0."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        test = builder.icmp_signed("!=", args[0], ir.Constant(_INTS, [0] * WIDTH))
        return builder.select(test, args[1], ir.Constant(_FLOATS, [0.0] * WIDTH))

    return Floats(Ints, Floats), gen


@intrinsic
def shared_bits(typing: Any, a: Any) -> Any:
    """Return the bits that all 16 ints have, as int64: below 0 where all of them are."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.sext(_call(builder, "llvm.vector.reduce.and.v16i32", _I32, list(args)), ir.IntType(64))

    return types.int64(Ints), gen


@intrinsic
def gather(typing: Any, array: Any, base: Any, index: Any) -> Any:
    """Return the int32 of a flat array at base + 16 indices."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = _place(context, builder, sig.args[0], args[0], args[1], _I32)
        places = ir.instructions.GEPInstr(builder.block, place, [args[2]], False, "", source_etype=_I32)
        places.type = ir.VectorType(place.type, WIDTH)
        builder._insert(places)
        everywhere = ir.Constant(ir.VectorType(ir.IntType(1), WIDTH), [1] * WIDTH)
        arguments = [places, ir.Constant(_I32, 4), everywhere, ir.Constant(_INTS, ir.Undefined)]
        return _call(builder, "llvm.masked.gather.v16i32.v16p0", _INTS, arguments)

    return Ints(array, types.int64, Ints), gen


@intrinsic
def store_pairs(typing: Any, array: Any, index: Any, first: Any, second: Any) -> Any:
    """Write 16 pairs (first, second) to a flat array of float32, from an index on."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        order = [side + lane for lane in range(WIDTH) for side in (0, WIDTH)]
        pairs = builder.shuffle_vector(args[2], args[3], ir.Constant(ir.VectorType(_I32, 2 * WIDTH), order))
        builder.store(pairs, _place(context, builder, sig.args[0], args[0], args[1], pairs.type), align=4)
        return context.get_dummy_value()

    return types.void(array, types.int64, Floats, Floats), gen


@intrinsic
def add_pair(typing: Any, array: Any, row: Any, pairs: Any, index: Any) -> Any:
    """Add pair `index` of a flat array of pairs to pair `row` of another."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = ir.VectorType(_F32, 2)
        one = ir.Constant(args[1].type, 1)
        place = _place(context, builder, sig.args[0], args[0], builder.shl(args[1], one), kind)
        other = _place(context, builder, sig.args[2], args[2], builder.shl(args[3], one), kind)
        added = builder.fadd(builder.load(place, align=4), builder.load(other, align=4))
        builder.store(added, place, align=4)
        return context.get_dummy_value()

    return types.void(array, types.int64, pairs, types.int64), gen


@intrinsic
def transpose(typing: Any, array: Any, source: Any, target: Any) -> Any:
    """Transpose 16 x 16 words of a flat array of int32, from index source on, to index target on."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        def place(start: Any, row: int) -> Any:
            return _place(context, builder, sig.args[0], args[0], builder.add(start, start.type(WIDTH * row)), _INTS)

        rows = [builder.load(place(args[1], row), align=4) for row in range(WIDTH)]
        for step in (8, 4, 2, 1):  # swap the off-diagonal blocks of this size
            lanes = range(WIDTH)
            upper = ir.Constant(_INTS, [lane if not lane & step else WIDTH + lane - step for lane in lanes])
            lower = ir.Constant(_INTS, [lane + step if not lane & step else WIDTH + lane for lane in lanes])
            for row in (row for row in range(WIDTH) if not row & step):
                pair = rows[row], rows[row + step]
                rows[row] = builder.shuffle_vector(*pair, upper)
                rows[row + step] = builder.shuffle_vector(*pair, lower)
        for row, value in enumerate(rows):
            builder.store(value, place(args[2], row), align=4)
        return context.get_dummy_value()

    return types.void(array, types.int64, types.int64), gen


@compiled
def round_bfloat(value):  # type: ignore[no-untyped-def]
    """Return the bits of floats rounded to bfloat16 (nearest, ties to even), in the low half of ints."""
    pattern = bits(value)
    half = ints(0x7FFF) + ((pattern >> ints(16)) & ints(1))
    return (pattern + half) >> ints(16)


@compiled
def low_float(word):  # type: ignore[no-untyped-def]
    """Return the bfloat16 in the low half of ints, as floats."""
    return from_bits(word << ints(16))


@compiled
def high_float(word):  # type: ignore[no-untyped-def]
    """Return the bfloat16 in the high half of ints, as floats."""
    return from_bits(word & ints(-65536))


@compiled
def pack(low, high):  # type: ignore[no-untyped-def]
    """Return two floats as bfloat16 in the halves of ints."""
    return round_bfloat(low) | (round_bfloat(high) << ints(16))


@compiled
def exponential(x):  # type: ignore[no-untyped-def]
    """Return e^x, relative error below 3e-7; x is clamped to [-87, 88], NaN stays. Cody-Waite reduction, polynomial."""
    x = smaller(floats(88.0), larger(floats(-87.0), x))
    turns = truncate(x * floats(1.44269504) + floats(256.5)) - ints(256)  # nearest integer
    n = to_floats(turns)
    r = fma(n, floats(2.12194440e-4), fma(n, floats(-0.693359375), x))
    p = fma(r, floats(1.3981999507e-3), floats(8.3334519073e-3))
    p = fma(r, p, floats(4.1665795894e-2))
    p = fma(r, p, floats(1.6666665459e-1))
    p = fma(r, p, floats(5.0000001201e-1))
    p = fma(r * r, p, r + floats(1.0))
    return p * from_bits((turns + ints(127)) << ints(23))
