"""Implementation of the words of the kernel language for CPUs: rows of 64 lanes, or of 16, as LLVM vectors.

A row is a value, so that a sum over many rows stays in registers. The words of `sysid_evo.kernels` have the same names
here. In a kernel ``+ - * /``, ``-row``, ``abs``, ``min`` and ``max`` accept rows, or a row and a number, which is
broadcast to all lanes. Functions of `math` accept rows, too: a square root is one instruction, the others call the
library for each lane. In float32, `sysid_evo.engine.compiled.elementary` replaces them.

Only generated files import this module, see `sysid_evo.engine.compiled.compiler`.
"""

from __future__ import annotations

import math
import operator
from functools import cache
from typing import Any

from llvmlite import ir
from llvmlite.binding import get_host_cpu_features
from numba import config as numba_settings
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

from sysid_evo.engine.compiled.internals import Inlined
from sysid_evo.kernels import LANES, QUARTER

FASTMATH = ("contract", "arcp", "nsz")
"""Optimisations of real arithmetic that the compiler may use: fusion, reciprocals, no signed zeros."""

WITHIN = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": Inlined}
"""Compiler options of an operation that only kernels call."""


class LanesType(types.Type):
    """A vector of ``count`` numbers of one precision."""

    def __init__(self, dtype: types.Type, count: int) -> None:
        self.dtype, self.count = dtype, count
        super().__init__(name=f"Lanes({dtype}, {count})")


@register_model(LanesType)
class LanesModel(models.PrimitiveModel):
    """Representation of the lanes as one LLVM vector."""

    def __init__(self, manager: Any, lanes: LanesType) -> None:
        scalar = ir.FloatType() if lanes.dtype == types.float32 else ir.DoubleType()
        super().__init__(manager, lanes, ir.VectorType(scalar, lanes.count))


@intrinsic
def view(typing_context, array, first):
    """Return ``array`` from element ``first`` on, without length or ownership: do not store it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        moved = context.make_array(signature.args[0])(context, builder, arguments[0])
        moved.data = builder.gep(moved.data, [arguments[1]])
        moved.meminfo = ir.Constant(moved.meminfo.type, None)
        moved.parent = ir.Constant(moved.parent.type, None)
        return moved._getvalue()

    return array(array, types.int64), generate


@intrinsic
def load(typing_context, array, offset):
    """Return the row of ``array`` that begins at ``offset``."""
    return _load(array, LANES)


@intrinsic
def load_quarter(typing_context, array, offset):
    """Return a quarter of a row of ``array`` that begins at ``offset``."""
    return _load(array, QUARTER)


def _load(array: Any, count: int) -> Any:
    lanes = LanesType(array.dtype, count)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = context.get_value_type(lanes)
        row = builder.load(_pointer(context, builder, signature.args[0], *arguments, vector))
        row.align = array.dtype.bitwidth // 8
        return row

    return lanes(array, types.int64), generate


@intrinsic
def splat(typing_context, number):
    """Return a row with ``number`` in every lane."""
    return _splat(number, LANES)


@intrinsic
def splat_quarter(typing_context, number):
    """Return a quarter of a row with ``number`` in every lane."""
    return _splat(number, QUARTER)


def _splat(number: Any, count: int) -> Any:
    lanes = LanesType(number, count)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return broadcast(builder, arguments[0], context.get_value_type(lanes))

    return lanes(number), generate


@intrinsic
def store(typing_context, array, offset, row):
    """Write ``row`` into ``array`` from ``offset`` on."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = context.get_value_type(signature.args[2])
        pointer = _pointer(context, builder, signature.args[0], arguments[0], arguments[1], vector)
        builder.store(arguments[2], pointer).align = array.dtype.bitwidth // 8
        return context.get_dummy_value()

    return types.void(array, types.int64, row), generate


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, offset: Any, vector: Any) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [offset]), ir.PointerType(vector))


@intrinsic
def pick(typing_context, row, lane):
    """Return the number in one lane of a row."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.extract_element(*arguments)

    return row.dtype(row, types.int64), generate


def _choice(comparison: str) -> Any:
    """Return a function of rows or numbers (a, b, x, y): x where the comparison of a and b holds, else y."""

    @intrinsic
    def choice(typing_context, a, b, x, y):
        row = next((kind for kind in (a, b, x, y) if isinstance(kind, LanesType)), a)
        number = row.dtype if isinstance(row, LanesType) else row
        kinds = [kind if isinstance(kind, LanesType) else number for kind in (a, b, x, y)]

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            vector = context.get_value_type(row)
            first, second, yes, no = (
                value if kind == row else broadcast(builder, value, vector)
                for kind, value in zip(kinds, arguments, strict=True)
            )
            return builder.select(builder.fcmp_ordered(comparison, first, second), yes, no)

        return row(*kinds), generate

    return choice


where_less = _choice("<")
"""Return x in the lanes where a < b, else y."""
where_at_most = _choice("<=")
"""Return x in the lanes where a <= b, else y."""


@intrinsic
def where_bits(typing_context, bits, x, y):
    """Return x in the lanes whose bit is set, else y; a quarter uses the lowest 16 bits."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = arguments[0] if x.count == LANES else builder.trunc(arguments[0], ir.IntType(x.count))
        chosen = builder.bitcast(bits, ir.VectorType(ir.IntType(1), x.count))
        return builder.select(chosen, *arguments[1:])

    return x(types.int64, x, y), generate


def _marks(comparison: str) -> Any:
    """Return a function of two rows (or quarters): an integer with bit i set where the comparison holds in lane i."""

    @intrinsic
    def marks(typing_context, a, b):
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return _bits(builder, builder.fcmp_ordered(comparison, *arguments), a.count)

        return types.int64(a, b), generate

    return marks


lanes_less = _marks("<")
"""Return an integer with bit i set where a < b in lane i of two rows or quarters."""
lanes_at_most = _marks("<=")
"""Return an integer with bit i set where a <= b in lane i of two rows or quarters."""


@intrinsic
def lanes_differ(typing_context, a, b):
    """Return an integer with bit i set where lane i of two rows differs; nan differs from every number."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(builder.fcmp_unordered("!=", *arguments), ir.IntType(LANES))

    return types.int64(a, b), generate


@intrinsic
def first_lane(typing_context, bits):
    """Return the index of the lowest bit that is set; at least one must be set."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _first_bit(builder, *arguments)

    return types.int64(types.int64), generate


def _first_bit(builder: Any, bits: Any) -> Any:
    name = "llvm.cttz.i64"
    number = ir.IntType(64)
    count = cgutils.get_or_insert_function(builder.module, ir.FunctionType(number, [number, ir.IntType(1)]), name)
    return builder.call(count, [bits, ir.Constant(ir.IntType(1), 1)])


def _bits(builder: Any, chosen: Any, count: int) -> Any:
    """Return ``count`` truth values as the lowest bits of an int64."""
    return builder.zext(builder.bitcast(chosen, ir.IntType(count)), ir.IntType(64))


@intrinsic
def lowest(typing_context, row):
    """Return the smallest number of a row (or quarter) without nan."""
    return row.dtype(row), _lowest


@intrinsic
def lane_of_lowest(typing_context, row):
    """Return the first lane of a quarter with its smallest number; the last lane if all are nan."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        least = _lowest(context, builder, signature, arguments)
        everywhere = broadcast(builder, least, context.get_value_type(row))
        bits = _bits(builder, builder.fcmp_ordered("==", arguments[0], everywhere), row.count)
        return _first_bit(builder, builder.or_(bits, ir.Constant(bits.type, 1 << (row.count - 1))))

    return types.int64(row), generate


def _lowest(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    row = signature.args[0]
    vector = context.get_value_type(row)
    kind = "f32" if row.dtype == types.float32 else "f64"
    name = f"llvm.vector.reduce.fmin.v{row.count}{kind}"
    reduce = cgutils.get_or_insert_function(builder.module, ir.FunctionType(vector.element, [vector]), name)
    return builder.call(reduce, arguments, fastmath=("nnan",))


@intrinsic
def look_up(typing_context, table, place):
    """Return, for each lane of a quarter, the number of ``table`` (a quarter) at ``place`` (0.0 to 15.0)."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        numbers, places = arguments
        whole = ir.VectorType(ir.IntType(32), QUARTER)
        index = builder.fptosi(places, whole)
        single = table.dtype == types.float32
        if single and _host_has("avx512f"):
            return call_named(builder, "llvm.x86.avx512.permvar.sf.512", numbers.type, [numbers, index])
        if single and _host_has("avx2"):
            return _look_up_eights(builder, numbers, index)
        found = ir.Constant(numbers.type, ir.Undefined)
        for lane in range(QUARTER):
            here = ir.Constant(ir.IntType(32), lane)
            value = builder.extract_element(numbers, builder.extract_element(index, here))
            found = builder.insert_element(found, value, here)
        return found

    return table(table, place), generate


def _look_up_eights(builder: Any, numbers: Any, index: Any) -> Any:
    """`look_up` by an instruction that selects one of eight numbers for each of eight lanes."""
    whole, eight = ir.IntType(32), QUARTER // 2
    halves = [ir.Constant(ir.VectorType(whole, eight), list(range(first, first + eight))) for first in (0, eight)]
    low, high = (builder.shuffle_vector(numbers, numbers, half) for half in halves)
    found = []
    for half in halves:
        places = builder.shuffle_vector(index, index, half)
        first, second = (call_named(builder, "llvm.x86.avx2.permps", low.type, [part, places]) for part in (low, high))
        bound = ir.Constant(places.type, [eight] * eight)
        found.append(builder.select(builder.icmp_signed("<", places, bound), first, second))
    return builder.shuffle_vector(*found, ir.Constant(ir.VectorType(whole, QUARTER), list(range(QUARTER))))


@cache
def _host_has(feature: str) -> bool:
    """True if this processor has the LLVM ``feature`` and compiled code may use it."""
    return bool(get_host_cpu_features().get(feature)) and not numba_settings.CPU_NAME


@intrinsic
def power_of_two(typing_context, exponent):
    """Return 2 to the power of integers given as real numbers (one or a row), by writing the exponent bits."""
    number = exponent.dtype if isinstance(exponent, LanesType) else exponent
    whole, mantissa, bias = (32, 23, 127) if number == types.float32 else (64, 52, 1023)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        integer = ir.IntType(whole)
        if isinstance(exponent, LanesType):
            integer = ir.VectorType(integer, exponent.count)

        def constant(value: int) -> Any:
            return ir.Constant(integer, [value] * exponent.count if isinstance(exponent, LanesType) else value)

        biased = builder.add(builder.fptosi(arguments[0], integer), constant(bias))
        return builder.bitcast(builder.shl(biased, constant(mantissa)), context.get_value_type(exponent))

    return exponent(exponent), generate


def _overload_with_numbers(function: Any, operation: Any) -> None:
    """Let ``function`` accept two rows, or a row and a number, which is broadcast to all lanes."""

    @overload(function, jit_options=WITHIN)
    def with_lanes(a, b):
        if isinstance(a, LanesType) and isinstance(b, LanesType):
            return lambda a, b: operation(a, b)
        if isinstance(a, LanesType) and isinstance(b, types.Number):
            return lambda a, b: operation(a, _like(a, b))
        if isinstance(a, types.Number) and isinstance(b, LanesType):
            return lambda a, b: operation(_like(b, a), b)
        return None


@intrinsic
def _like(typing_context, row, number):
    """Return a row like ``row`` with ``number`` in every lane."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return broadcast(builder, arguments[1], context.get_value_type(signature.args[0]))

    return row(row, row.dtype), generate


def _operation(name: str) -> Any:
    """Return a function of two rows that is one LLVM instruction, lane by lane."""

    @intrinsic
    def operation(typing_context, a, b):
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, name)(*arguments, flags=FASTMATH)

        return a(a, b), generate

    return operation


for _symbol, _instruction in (
    (operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"), (operator.truediv, "fdiv"),
):  # fmt: skip
    _overload_with_numbers(_symbol, _operation(_instruction))


@intrinsic
def _least(typing_context, a, b):
    """The minimum; b if one of them is nan, like Numba's built-in function of two numbers."""
    return a(a, b), _smaller("<")


@intrinsic
def _most(typing_context, a, b):
    return a(a, b), _smaller(">")


def _smaller(comparison: str) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first, second = arguments
        return builder.select(builder.fcmp_ordered(comparison, second, first), second, first)

    return generate


_overload_with_numbers(min, _least)


_overload_with_numbers(max, _most)


@overload(operator.neg, jit_options=WITHIN)
def _lanes_neg(a):
    if isinstance(a, LanesType):
        return lambda a: _negative(a)
    return None


@intrinsic
def _negative(typing_context, a):
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fneg(arguments[0])

    return a(a), generate


@overload(abs, jit_options=WITHIN)
def _lanes_abs(a):
    if isinstance(a, LanesType):
        return lambda a: _magnitude(a)
    return None


@intrinsic
def _magnitude(typing_context, a):
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return call_elementwise(builder, "fabs", context.get_value_type(signature.args[0]), arguments)

    return a(a), generate


@overload(math.sqrt)
def _lanes_sqrt(x):
    return (lambda x: _root(x)) if isinstance(x, LanesType) else None


@intrinsic
def _root(typing_context, row):
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return call_elementwise(builder, "sqrt", context.get_value_type(row), arguments)

    return row(row), generate


def _lane_by_lane(function: Any) -> None:
    @overload(function)
    def of_lanes(x):
        if not isinstance(x, LanesType):
            return None
        count = x.count

        def applied(x):
            for lane in range(count):
                x = _put(x, lane, function(pick(x, lane)))
            return x

        return applied


for _function in (math.cos, math.exp, math.sin, math.tanh):
    _lane_by_lane(_function)


@overload(math.atan2)
def _lanes_atan2(y, x):
    if not isinstance(x, LanesType) or not isinstance(y, LanesType):
        return None
    count = x.count

    def applied(y, x):
        for lane in range(count):
            x = _put(x, lane, math.atan2(pick(y, lane), pick(x, lane)))
        return x

    return applied


@intrinsic
def _put(typing_context, row, lane, number):
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector, place, value = arguments
        return builder.insert_element(vector, value, place)

    return row(row, types.int64, row.dtype), generate


def broadcast(builder: Any, number: Any, vector: Any) -> Any:
    """Return ``number`` in every lane of a ``vector``."""
    empty = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(empty, number, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), vector.count), [0] * vector.count)
    return builder.shuffle_vector(first, empty, zeros)


def call_elementwise(builder: Any, name: str, vector: Any, arguments: Any) -> Any:
    """Call LLVM's elementwise function ``name``."""
    kind = "f32" if isinstance(vector.element, ir.FloatType) else "f64"
    return call_named(builder, f"llvm.{name}.v{vector.count}{kind}", vector, arguments)


def call_named(builder: Any, name: str, result: Any, arguments: Any) -> Any:
    """Call the LLVM function ``name``."""
    kind = ir.FunctionType(result, [argument.type for argument in arguments])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), arguments)
