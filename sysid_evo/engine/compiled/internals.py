"""Use of Numba's internals: inlining of kernel functions, and passing of arrays between compiled functions.

Numba passes every compiled function through all of LLVM: it inlines its callees, optimises, and generates machine code
that Python can call. A kernel is a chain of functions, each inlined into the next, so the innermost function would be
translated once for every link, and all results but the last discarded. With ``pipeline_class=Inlined`` a function stops
before machine code; its caller inlines it.

An array has seven fields in Numba, and every call writes all of them. A kernel that is called once per step receives
only the `address` of each array and rebuilds the array with `array_at`.
"""

from __future__ import annotations

from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba._dynfunc import make_function
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import LoweringPass, register_pass
from numba.core.typed_passes import NativeLowering
from numba.extending import intrinsic

CHECKED_VERSIONS = ((0, 68),)
"""Versions of Numba whose passes were checked against the assumptions of this module."""


class _ToBeInlined(JITCodeLibrary):
    """The code of a function and its callees, as LLVM text without machine code.

    It is optimised here as well as in its caller, because the fusion of products into sums depends on earlier passes.
    """

    def _finalize_final_module(self) -> None:
        """Generate no machine code."""
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(LoweringPass):
    """Numba's lowering pass; its code is available to other compiled functions only."""

    _name = "lowering_of_what_is_inlined"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        """Make the code of ``state`` available to other functions."""
        state.library = _ToBeInlined(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        NativeLowering().run_pass(state)
        lowered = state["cr"]
        description, address = lowered.fndesc, 0  # never called: compiled code finds the function by its name
        found_by = make_function(
            description.lookup_module(), state.func_id.func_name, "", address, lowered.env, (state.library,)
        )
        state.targetctx.insert_user_function(found_by, description, [state.library])
        state["cr"] = lowered._replace(cfunc=found_by)
        return True


class _WithoutMachineCode(CompilerBase):
    """Numba's compiler without its last step."""

    def define_pipelines(self) -> list[Any]:
        """Return the passes, in order."""
        manager = DefaultPassBuilder.define_nopython_pipeline(self.state)
        manager.add_pass_after(_Lowering, NativeLowering)
        manager.passes = [(a, why) for a, why in manager.passes if a is not NativeLowering]
        manager.finalize()
        return [manager]


def compiler_for(version: tuple[int, int]) -> type[CompilerBase]:
    """Return the compiler of functions within kernels for a version of Numba."""
    chosen: type[CompilerBase] = _WithoutMachineCode if version in CHECKED_VERSIONS else Compiler
    return chosen


Inlined = compiler_for(numba.version_info.short)


@intrinsic
def address(typing_context, array):
    """Return the pointer to the first element of ``array``."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.make_array(signature.args[0])(context, builder, arguments[0]).data

    return types.CPointer(array.dtype)(array), generate


@intrinsic
def array_at(typing_context, pointer):
    """Return the array that begins at a `pointer`, without length or ownership: do not store it."""
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
