"""Mathematics with a row of lanes as with a number.

Square roots are one instruction. What float32 kernels do instead of the mathematics library
(`sysid_evo.engine.compiled.elementary`) is arithmetic and `power_of_two`; in float64 the library is asked lane by lane.
"""

from __future__ import annotations

import math
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

from sysid_evo.engine.compiled.lanes import pick
from sysid_evo.engine.compiled.rows import LanesType, call_elementwise


@intrinsic
def power_of_two(typing_context, exponent):
    """Return 2 to the power of whole numbers, one or a row, given as real ones, by writing the bits of exponents."""
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


@intrinsic
def _put(typing_context, row, lane, number):
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector, place, value = arguments
        return builder.insert_element(vector, value, place)

    return row(row, types.int64, row.dtype), generate


@intrinsic
def _root(typing_context, row):
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return call_elementwise(builder, "sqrt", context.get_value_type(row), arguments)

    return row(row), generate


@overload(math.sqrt)
def _lanes_sqrt(x):
    return (lambda x: _root(x)) if isinstance(x, LanesType) else None


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
