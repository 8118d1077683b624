"""What stands where in a kernel's parameters, and in which order it is called, is said once."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo.engine.compiled.compiler import compile_kernel
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import DYNAMICS, NUMBER, REALS, WHOLES, KernelSource, Layout, Signature, padded
from tests.sysid_evo.engine.running import call_block

HEAD = Layout("n", "gain", align=4)


def amplify(x, p):
    for i in range(int(p[HEAD.n])):
        x[i] *= p[HEAD.gain] * p[HEAD.size]


def loop(dynamics, sizes, first, x):
    x[0] = 1.0


def test_a_layout_packs_by_name_and_a_kernel_reads_by_name() -> None:
    parameters = HEAD.pack([5.0], gain=3.0, n=2)
    np.testing.assert_array_equal(parameters, [2.0, 3.0, 0.0, 0.0, 5.0])
    x = call_block(amplify, Signature(x=REALS, p=REALS), "float64", [np.ones(3), parameters])[0]
    np.testing.assert_array_equal(x, [15.0, 15.0, 1.0])


def test_a_layout_takes_its_names_and_no_others() -> None:
    with pytest.raises(InvalidArgument, match="layout: expected n, gain, got n"):
        HEAD.pack(n=1)
    with pytest.raises(InvalidArgument, match="layout: expected n, gain, got n, gain, bias"):
        HEAD.pack(n=1, gain=1.0, bias=0.0)
    with pytest.raises(AttributeError, match="layout: no 'bias'; its names are n, gain"):
        _ = HEAD.bias
    for names in (("n", "n"), ("size",)):
        with pytest.raises(InvalidArgument, match="expected different names, none of them 'size'"):
            Layout(*names)


def test_what_is_padded_ends_on_a_whole_line() -> None:
    assert [len(padded(np.ones(n))) for n in (0, 1, 16, 17)] == [0, 16, 16, 32]


def test_a_signature_is_the_type_and_the_order_of_a_call() -> None:
    signature = Signature.of(loop, dynamics=DYNAMICS, sizes=WHOLES, first=NUMBER)
    inner = f"types.FunctionType(types.void({', '.join(['types.CPointer(R.dtype)'] * 5)}))"
    assert str(signature) == f"types.void({inner}, I, types.int64, R)"
    assert signature.ordered(x="d", first="c", sizes="b", dynamics="a") == ("a", "b", "c", "d")


def test_a_kernel_that_is_passed_takes_arrays_alone() -> None:
    with pytest.raises(InvalidArgument, match="takes arrays alone, got first"):
        str(Signature(kernel=Signature(x=REALS, first=NUMBER)))


def test_a_call_with_other_names_is_refused() -> None:
    signature = Signature(x=REALS, y=REALS)
    with pytest.raises(InvalidArgument, match="missing arguments: y; unknown ones: z"):
        signature.ordered(x=1, z=2)
    with pytest.raises(InvalidArgument, match="signature of loop: no argument is called speed"):
        Signature.of(loop, speed=NUMBER)


def test_a_kernel_function_with_too_few_arguments_is_refused_in_a_sentence() -> None:
    with pytest.raises(
        InvalidArgument,
        match=r"amplify: expected 5 arguments \(carry, control, noise, parameters, scratch\), got 2 \(x, p\)",
    ):
        compile_kernel(KernelSource(amplify), DYNAMICS, "float32")
