"""What the lane functions of kernels mean on a device: one thread is one lane, and a row is a number.

With NUMBA_ENABLE_CUDASIM=1 the same names are plain Python functions, for Numba's simulator.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, cuda, types
from numba.cuda.extending import intrinsic

from sysid_evo.engine.cuda import one_lane

SIMULATED = bool(config.ENABLE_CUDASIM)

FUNCTIONS = (
    "first_lane", "lane_of_lowest", "lanes_at_most", "lanes_differ", "lanes_less", "load", "load_quarter", "lowest",
    "pick", "power_of_two", "splat", "splat_quarter", "store", "view", "where_at_most", "where_bits", "where_less",
)  # fmt: skip
"""The lane functions that have a meaning for one lane."""


def device(function: Any) -> Any:
    """Return ``function`` for other functions of the device to call; the simulator calls it as it is."""
    return function if SIMULATED else cuda.jit(function, device=True, forceinline=True)


load, store, splat, pick = (device(f) for f in (one_lane.load, one_lane.store, one_lane.splat, one_lane.pick))
load_quarter, splat_quarter, lowest = load, splat, splat
first_lane, lane_of_lowest = device(one_lane.first_lane), device(one_lane.lane_of_lowest)
where_less, where_at_most, where_bits = (
    device(f) for f in (one_lane.where_less, one_lane.where_at_most, one_lane.where_bits)
)
lanes_less, lanes_at_most, lanes_differ = (
    device(f) for f in (one_lane.lanes_less, one_lane.lanes_at_most, one_lane.lanes_differ)
)

if SIMULATED:
    float32, float64 = np.float32, np.float64

    def view(array, first):
        """Return ``array`` from element ``first`` on."""
        return array[first:]

    def power_of_two(exponent):
        """Return 2 to the power of a whole number given as a real one."""
        return type(exponent)(2.0) ** exponent
else:
    float32, float64 = types.float32, types.float64

    @intrinsic
    def view(typing_context, array, first):
        """Return ``array`` from element ``first`` on, without its length."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            moved = context.make_array(signature.args[0])(context, builder, arguments[0])
            moved.data = builder.gep(moved.data, [arguments[1]])
            return moved._getvalue()

        return array(array, types.int64), generate

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
