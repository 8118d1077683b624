"""A vector of 64 lanes as a Numba type, so that a sum over many rows stays in registers.

Block kernels hold 64 rollouts side by side: row i of a quantity is ``array[i * LANES : (i + 1) *
LANES]``. Plain loops over lanes vectorise by themselves; what they cannot do is keep an accumulator
in registers across an inner loop. A row as a value can: `load` and `splat` make one, ``+ - *`` and
`where_less` combine them, `store` writes one; `load_quarter` and `splat_quarter` make rows of sixteen.
For a search, `lowest` and `lane_of_lowest` reduce a row, `pick` takes one lane of it, and `lanes_less`
marks lanes as the bits of an integer, whose lowest `first_lane` finds.

`view` moves the beginning of an array: an index that is a loop's own counter is known not to be
negative, ``start + i`` is not, and Numba's test for it would keep the loop from vectorising; a slice
would count references in the loop.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

LANES = 64
QUARTER = LANES // 4


class LanesType(types.Type):
    """A vector of ``count`` numbers of one precision."""

    def __init__(self, dtype: types.Type, count: int) -> None:
        self.dtype, self.count = dtype, count
        super().__init__(name=f"Lanes({dtype}, {count})")


@register_model(LanesType)
class LanesModel(models.PrimitiveModel):
    """Represents the lanes as one LLVM vector."""

    def __init__(self, manager: Any, lanes: LanesType) -> None:
        scalar = ir.FloatType() if lanes.dtype == types.float32 else ir.DoubleType()
        super().__init__(manager, lanes, ir.VectorType(scalar, lanes.count))


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, offset: Any, vector: Any) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [offset]), ir.PointerType(vector))


def _load(array: Any, count: int) -> Any:
    lanes = LanesType(array.dtype, count)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = context.get_value_type(lanes)
        row = builder.load(_pointer(context, builder, signature.args[0], *arguments, vector))
        row.align = array.dtype.bitwidth // 8
        return row

    return lanes(array, types.int64), generate


def _splat(number: Any, count: int) -> Any:
    lanes = LanesType(number, count)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _broadcast(builder, arguments[0], context.get_value_type(lanes))

    return lanes(number), generate


def _broadcast(builder: Any, number: Any, vector: Any) -> Any:
    empty = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(empty, number, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), vector.count), [0] * vector.count)
    return builder.shuffle_vector(first, empty, zeros)


@intrinsic
def load(typing_context, array, offset):
    """Return the row of ``array`` that begins at ``offset``."""
    return _load(array, LANES)


@intrinsic
def load_quarter(typing_context, array, offset):
    """Return a quarter of a row of ``array`` that begins at ``offset``."""
    return _load(array, QUARTER)


@intrinsic
def splat(typing_context, number):
    """Return a row with ``number`` in every lane."""
    return _splat(number, LANES)


@intrinsic
def splat_quarter(typing_context, number):
    """Return a quarter of a row with ``number`` in every lane."""
    return _splat(number, QUARTER)


@intrinsic
def store(typing_context, array, offset, row):
    """Write ``row`` into ``array`` from ``offset`` on."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = context.get_value_type(signature.args[2])
        pointer = _pointer(context, builder, signature.args[0], arguments[0], arguments[1], vector)
        builder.store(arguments[2], pointer).align = array.dtype.bitwidth // 8
        return context.get_dummy_value()

    return types.void(array, types.int64, row), generate


def _operation(name: str) -> Any:
    """Return a function of two rows that is one LLVM instruction, lane by lane."""

    @intrinsic
    def operation(typing_context, a, b):
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, name)(*arguments, flags=("contract",))

        return a(a, b), generate

    return operation


_add, _sub, _mul = _operation("fadd"), _operation("fsub"), _operation("fmul")


@intrinsic
def where_less(typing_context, a, b, x, y):
    """Return x in the lanes where a < b, else y."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", *arguments[:2]), *arguments[2:])

    return x(a, b, x, y), generate


def _are_lanes(a: Any, b: Any) -> bool:
    return isinstance(a, LanesType) and isinstance(b, LanesType)


@overload(operator.add)
def _lanes_add(a, b):
    if _are_lanes(a, b):
        return lambda a, b: _add(a, b)
    return None


@overload(operator.sub)
def _lanes_sub(a, b):
    if _are_lanes(a, b):
        return lambda a, b: _sub(a, b)
    return None


@overload(operator.mul)
def _lanes_mul(a, b):
    if _are_lanes(a, b):
        return lambda a, b: _mul(a, b)
    return None


def _lowest(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    row = signature.args[0]
    vector = context.get_value_type(row)
    kind = "f32" if row.dtype == types.float32 else "f64"
    name = f"llvm.vector.reduce.fmin.v{row.count}{kind}"
    reduce = cgutils.get_or_insert_function(builder.module, ir.FunctionType(vector.element, [vector]), name)
    return builder.call(reduce, arguments, fastmath=("nnan",))


@intrinsic
def lowest(typing_context, row):
    """Return the smallest number of a row (or of a quarter); none may be nan."""
    return row.dtype(row), _lowest


def _bits(builder: Any, chosen: Any, count: int) -> Any:
    """Return ``count`` truth values as the lowest bits of an int64."""
    return builder.zext(builder.bitcast(chosen, ir.IntType(count)), ir.IntType(64))


def _first_bit(builder: Any, bits: Any) -> Any:
    name = "llvm.cttz.i64"
    number = ir.IntType(64)
    count = cgutils.get_or_insert_function(builder.module, ir.FunctionType(number, [number, ir.IntType(1)]), name)
    return builder.call(count, [bits, ir.Constant(ir.IntType(1), 1)])


@intrinsic
def lane_of_lowest(typing_context, row):
    """Return the first lane of a quarter that holds its smallest number; the last lane if none compares."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        least = _lowest(context, builder, signature, arguments)
        everywhere = _broadcast(builder, least, context.get_value_type(row))
        bits = _bits(builder, builder.fcmp_ordered("==", arguments[0], everywhere), row.count)
        return _first_bit(builder, builder.or_(bits, ir.Constant(bits.type, 1 << (row.count - 1))))

    return types.int64(row), generate


@intrinsic
def lanes_less(typing_context, a, b):
    """Return an integer whose bit i says whether a < b in lane i of two quarters."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _bits(builder, builder.fcmp_ordered("<", *arguments), a.count)

    return types.int64(a, b), generate


@intrinsic
def first_lane(typing_context, bits):
    """Return the number of the lowest bit that is set; there must be one."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _first_bit(builder, *arguments)

    return types.int64(types.int64), generate


@intrinsic
def pick(typing_context, row, lane):
    """Return the number in one lane of a row."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.extract_element(*arguments)

    return row.dtype(row, types.int64), generate


@intrinsic
def power_of_two(typing_context, exponent):
    """Return 2 to the power of a whole number given as a real one, by writing its exponent bits."""
    whole, mantissa, bias = (32, 23, 127) if exponent == types.float32 else (64, 52, 1023)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        integer = ir.IntType(whole)
        biased = builder.add(builder.fptosi(arguments[0], integer), ir.Constant(integer, bias))
        bits = builder.shl(biased, ir.Constant(integer, mantissa))
        return builder.bitcast(bits, context.get_value_type(exponent))

    return exponent(exponent), generate


@intrinsic
def view(typing_context, array, first):
    """Return ``array`` from element ``first`` on, without length or ownership: never keep it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        moved = context.make_array(signature.args[0])(context, builder, arguments[0])
        moved.data = builder.gep(moved.data, [arguments[1]])
        moved.meminfo = ir.Constant(moved.meminfo.type, None)
        moved.parent = ir.Constant(moved.parent.type, None)
        return moved._getvalue()

    return array(array, types.int64), generate
