"""How a function that only kernels call is compiled: to code that is inlined, and to no machine code of its own.

Numba takes every compiled function through all of LLVM: it inlines what the function calls, optimises, and makes
machine code that Python could call. A kernel is a chain of functions, each inlined into the next, so the innermost
would be translated once for every link of the chain, and all but the last thrown away. With
``pipeline_class=Inlined`` a function stops before that; who calls it takes it in.
"""

from __future__ import annotations

from typing import Any

import numba
from numba._dynfunc import make_function
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import LoweringPass, register_pass
from numba.core.typed_passes import NativeLowering

TRIED = ((0, 68),)
"""Versions of Numba whose passes are known to be what this file takes them for."""


class _ToBeInlined(JITCodeLibrary):
    """The code of a function and of what it calls, as LLVM text alone.

    It is optimised here as well as in its caller: which products are fused into sums depends on what was done before.
    """

    def _finalize_final_module(self) -> None:
        """Give nothing to the machine that translates."""
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(LoweringPass):
    """Numba's own lowering, whose code goes where other functions find it and nowhere else."""

    _name = "lowering_of_what_is_inlined"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        """Put the code of ``state`` within reach of other functions."""
        state.library = _ToBeInlined(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        NativeLowering().run_pass(state)
        lowered = state["cr"]
        description, address = lowered.fndesc, 0  # nobody calls it: the name by which compiled code finds the function
        found_by = make_function(
            description.lookup_module(), state.func_id.func_name, "", address, lowered.env, (state.library,)
        )
        state.targetctx.insert_user_function(found_by, description, [state.library])
        state["cr"] = lowered._replace(cfunc=found_by)
        return True


class _WithoutMachineCode(CompilerBase):
    """Numba's compiler, but for the last step."""

    def define_pipelines(self) -> list[Any]:
        """Return the passes, in order."""
        manager = DefaultPassBuilder.define_nopython_pipeline(self.state)
        manager.add_pass_after(_Lowering, NativeLowering)
        manager.passes = [(a, why) for a, why in manager.passes if a is not NativeLowering]
        manager.finalize()
        return [manager]


def compiler_for(version: tuple[int, int]) -> type[CompilerBase]:
    """Return how functions within kernels are compiled by a version of Numba."""
    chosen: type[CompilerBase] = _WithoutMachineCode if version in TRIED else Compiler
    return chosen


Inlined = compiler_for(numba.version_info.short)
