"""What kernels do with rows of 64 lanes as values, so that a sum over many rows stays in registers.

Here stands what the words of `sysid_evo.kernels` mean for 64 lanes, or for sixteen; `view` and `power_of_two`
(`sysid_evo.engine.compiled.row_mathematics`) are words too.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from llvmlite import ir
from llvmlite.binding import get_host_cpu_features
from numba import config as numba_settings
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from sysid_evo.engine.compiled.rows import LanesType, broadcast, call_named
from sysid_evo.kernels import LANES, QUARTER


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
        return broadcast(builder, arguments[0], context.get_value_type(lanes))

    return lanes(number), generate


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


def _choice(comparison: str) -> Any:
    """Return a function of rows, of numbers, or of both: the third where the first two compare, else the fourth."""

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
    """Return x in the lanes whose bit is set, else y; of a quarter, the lowest sixteen bits count."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = arguments[0] if x.count == LANES else builder.trunc(arguments[0], ir.IntType(x.count))
        chosen = builder.bitcast(bits, ir.VectorType(ir.IntType(1), x.count))
        return builder.select(chosen, *arguments[1:])

    return x(types.int64, x, y), generate


@intrinsic
def lanes_differ(typing_context, a, b):
    """Return an integer whose bit i says whether lane i of two rows differs; what is no number differs from all."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(builder.fcmp_unordered("!=", *arguments), ir.IntType(LANES))

    return types.int64(a, b), generate


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
        everywhere = broadcast(builder, least, context.get_value_type(row))
        bits = _bits(builder, builder.fcmp_ordered("==", arguments[0], everywhere), row.count)
        return _first_bit(builder, builder.or_(bits, ir.Constant(bits.type, 1 << (row.count - 1))))

    return types.int64(row), generate


def _marks(comparison: str) -> Any:
    """Return a function of two rows (or quarters): an integer whose bit i says whether lane i compares."""

    @intrinsic
    def marks(typing_context, a, b):
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return _bits(builder, builder.fcmp_ordered(comparison, *arguments), a.count)

        return types.int64(a, b), generate

    return marks


lanes_less = _marks("<")
"""Return an integer whose bit i says whether a < b in lane i of two rows or quarters."""
lanes_at_most = _marks("<=")
"""Return an integer whose bit i says whether a <= b in lane i of two rows or quarters."""


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
def look_up(typing_context, table, place):
    """Return for each lane of a quarter the number of ``table`` (another quarter) at ``place``, from 0.0 to 15.0."""

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
    """`look_up` with an instruction that takes one of eight numbers for each of eight lanes."""
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
    """Whether this processor has a feature by LLVM's name, and compiled code may use it."""
    return bool(get_host_cpu_features().get(feature)) and not numba_settings.CPU_NAME


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
