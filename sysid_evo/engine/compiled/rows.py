"""A row of lanes as a value: its Numba type, and what arithmetic with rows and numbers becomes.

In a kernel ``+ - * /``, ``-row``, ``abs``, ``min`` and ``max`` take rows, or a row and a number, which then stands in
every lane. What makes rows, compares and stores them is in `sysid_evo.engine.compiled.lanes`.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

from sysid_evo.engine.compiled.inlined import Inlined

FASTMATH = ("contract", "arcp", "nsz")
"""What the compiler may do with real numbers: fuse, divide by a reciprocal, take -0 for 0."""

WITHIN = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": Inlined}
"""How what an operation becomes is compiled: only kernels call it."""


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


def broadcast(builder: Any, number: Any, vector: Any) -> Any:
    """Return ``number`` in every lane of a ``vector``."""
    empty = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(empty, number, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), vector.count), [0] * vector.count)
    return builder.shuffle_vector(first, empty, zeros)


def _operation(name: str) -> Any:
    """Return a function of two rows that is one LLVM instruction, lane by lane."""

    @intrinsic
    def operation(typing_context, a, b):
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, name)(*arguments, flags=FASTMATH)

        return a(a, b), generate

    return operation


_add, _sub, _mul, _div = _operation("fadd"), _operation("fsub"), _operation("fmul"), _operation("fdiv")


def _are_lanes(a: Any, b: Any) -> bool:
    return isinstance(a, LanesType) and isinstance(b, LanesType)


@intrinsic
def _like(typing_context, row, number):
    """Return a row like ``row`` with ``number`` in every lane."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return broadcast(builder, arguments[1], context.get_value_type(signature.args[0]))

    return row(row, row.dtype), generate


def _overload_with_numbers(function: Any, operation: Any) -> None:
    """Let ``function`` take two rows, or a row and a number, which then stands in every lane."""

    @overload(function, jit_options=WITHIN)
    def with_lanes(a, b):
        if _are_lanes(a, b):
            return lambda a, b: operation(a, b)
        if isinstance(a, LanesType) and isinstance(b, types.Number):
            return lambda a, b: operation(a, _like(a, b))
        if isinstance(a, types.Number) and isinstance(b, LanesType):
            return lambda a, b: operation(_like(b, a), b)
        return None


for _function, _instruction in (
    (operator.add, _add), (operator.sub, _sub), (operator.mul, _mul), (operator.truediv, _div),
):  # fmt: skip
    _overload_with_numbers(_function, _instruction)


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


def call_elementwise(builder: Any, name: str, vector: Any, arguments: Any) -> Any:
    """Call LLVM's own elementwise function ``name``."""
    kind = "f32" if isinstance(vector.element, ir.FloatType) else "f64"
    return call_named(builder, f"llvm.{name}.v{vector.count}{kind}", vector, arguments)


def call_named(builder: Any, name: str, result: Any, arguments: Any) -> Any:
    """Call the function that LLVM knows by ``name``."""
    kind = ir.FunctionType(result, [argument.type for argument in arguments])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), arguments)


@intrinsic
def _least(typing_context, a, b):
    """The second where they do not compare, as the built-in function of two numbers."""
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
