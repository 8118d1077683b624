"""How an array passes from one compiled function to another that it is given.

To Numba an array is seven numbers, all of which are written for every call. A kernel that is called once a step
gets only the `address` of each array and makes the array again with `array_at`.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


@intrinsic
def address(typing_context, array):
    """Return the pointer to the first element of ``array``."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.make_array(signature.args[0])(context, builder, arguments[0]).data

    return types.CPointer(array.dtype)(array), generate


@intrinsic
def array_at(typing_context, pointer):
    """Return the array that begins at a `pointer`, without length or ownership: never keep it."""
    array = types.Array(pointer.dtype, 1, "C")

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        made = context.make_array(array)(context, builder)
        size = context.get_abi_sizeof(context.get_data_type(array.dtype))
        made.data = arguments[0]
        made.itemsize = ir.Constant(made.itemsize.type, size)
        made.strides = ir.Constant(made.strides.type, [size])
        made.nitems = ir.Constant(made.nitems.type, 0)
        made.shape = ir.Constant(made.shape.type, [0])
        made.meminfo = ir.Constant(made.meminfo.type, None)
        made.parent = ir.Constant(made.parent.type, None)
        return made._getvalue()

    return array(pointer), generate
