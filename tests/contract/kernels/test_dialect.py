"""Kernel functions: what they may use, the generated code, calls, and errors."""

import importlib.util
import math
import os
import subprocess
import sys
import threading
from pathlib import Path

import numba
import numpy as np
import pytest
from filelock import FileLock
from numba.core.compiler import Compiler

from sysid_evo.engine.compiled.compiler import _compiled_before, compile_kernel, compiled_loop, imported, module_name
from sysid_evo.engine.compiled.internals import CHECKED_VERSIONS, compiler_for
from sysid_evo.engine.compiled.language import generate
from sysid_evo.errors import InvalidArgument
from sysid_evo.files import cache_folder
from sysid_evo.kernels import DYNAMICS, INTEGER, INTEGERS, REALS, Arrays, KernelSource, Layout, Signature, padded
from tests.fixtures import same_name
from tests.fixtures.lanes import call_block

SIGNATURE = Signature(x=REALS, y=REALS)
HEAD = Layout("n", "gain", align=4)
GAIN = 0.1
COUNT = 3
SWITCH = True
NUMPY_NUMBER = np.float64(0.25)
TABLE = np.zeros(3)
ENTRIES = [1.0, 2.0]


def call(function, x, precision="float64", **bindings):
    compiled = compile_kernel(KernelSource(function, bindings), SIGNATURE, precision, pointer=False)
    y = np.zeros(6, dtype=precision)
    compiled(np.array([x], dtype=precision), y)
    return y.tolist()


def text(function, precision="float32"):
    return generate(KernelSource(function), SIGNATURE, precision, pointer=False)


@numba.njit
def decorated(x):
    return x + GAIN


def helper(x):
    return 100.0 * same_name.helper(x)


def with_numbers(x, y):
    y[0] = GAIN * x[0]
    y[1] = COUNT
    y[2] = 1.0 if SWITCH else 0.0
    y[3] = NUMPY_NUMBER * math.pi
    y[4] = decorated(x[0])
    y[5] = helper(x[0])


def with_names(x, y):
    real, types, entry = x[0], 2.0, 3.0
    _real = helper_1 = helper_2 = 4.0
    y[0] = real * types * entry * helper_1 * 0.125 * _real
    y[1] = float(3) * 0.1
    y[2] = helper(x=x[0]) + helper_2


def with_a_bound_function(x, y):
    y[0] = inner(x[0])  # bound in the test


def test_numbers_of_a_module_become_literals_and_functions_are_taken_also_three_of_one_name():
    assert call(with_numbers, 2.0) == [0.2, 3.0, 1.0, 0.25 * math.pi, 2.1, 3000.0]


@pytest.mark.parametrize(("precision", "number"), [("float64", 3 * 0.1), ("float32", np.float32(3) * np.float32(0.1))])
def test_names_never_clash_and_literals_have_the_precision_of_the_kernel(precision, number):
    """Locals are called as the generated text calls its own, and the functions that it names."""
    assert call(with_names, 2.0, precision)[:3] == [24.0, number, 3004.0]


def test_free_names_refer_to_the_bindings():
    assert call(with_a_bound_function, 2.0, inner=decorated)[0] == 2.1
    assert call(with_a_bound_function, 2.0, inner=KernelSource(same_name.helper))[0] == 30.0
    with pytest.raises(InvalidArgument, match=r"with_a_bound_function uses 'inner': the name is not defined"):
        call(with_a_bound_function, 2.0)


def test_a_closure_over_a_number_is_taken():
    factor = 7.0

    def times(x, y):
        y[0] = factor * x[0]

    assert call(times, 2.0)[0] == 14.0


def mathematics(x, y):
    y[0] = math.sin(x[0]) + math.cos(x[0]) + math.tanh(x[0])
    y[1] = math.exp(x[0]) + math.sqrt(x[0]) + math.log(x[0])
    y[2] = math.atan2(x[0], 2.0) + math.hypot(x[0], 3.0)
    y[3] = abs(-x[0]) + min(x[0], 1.0) + max(x[0], 5.0)


@pytest.mark.parametrize(("precision", "rtol"), [("float64", 1e-15), ("float32", 3e-7)])
def test_mathematics_is_the_library_in_float64_and_good_to_float32_in_float32(precision, rtol):
    expected = np.zeros(4)
    mathematics([0.7], expected)
    np.testing.assert_allclose(call(mathematics, 0.7, precision)[:4], expected, rtol=rtol)
    assert ("math.tanh" in text(mathematics, precision)) == (precision == "float64")


def uses_numpy(x, y):
    y[0] = np.sum(x)


def uses_an_attribute(x, y):
    y[0] = x.sum()


def uses_a_lambda(x, y):
    twice = lambda a: 2.0 * a  # noqa: E731  # what is tested
    y[0] = twice(x[0])


def uses_a_function_within(x, y):
    def twice(a):
        return 2.0 * a

    y[0] = twice(x[0])


def uses_an_array(x, y):
    y[0] = TABLE[0]


def uses_a_list(x, y):
    y[0] = ENTRIES[0]


def uses_an_unknown_name(x, y):
    y[0] = nowhere  # what is tested


def uses_an_object(x, y):
    y[0] = Path(x[0])


def uses_a_builtin(x, y):
    y[0] = sum(x)


@pytest.mark.parametrize(
    "function, name",
    [
        (uses_numpy, "np.sum"),
        (uses_an_attribute, "x.sum"),
        (uses_a_lambda, "lambda a: 2.0 * a"),
        (uses_a_function_within, "twice"),
        (uses_an_array, "TABLE"),
        (uses_a_list, "ENTRIES"),
        (uses_an_unknown_name, "nowhere"),
        (uses_an_object, "Path"),
        (uses_a_builtin, "sum"),
    ],
)
def test_what_cannot_be_used_is_refused_with_function_and_name(function, name):
    with pytest.raises(InvalidArgument) as refused:
        text(function)
    assert function.__name__ in str(refused.value)
    assert repr(name) in str(refused.value)


def calls_itself(x, y):
    calls_itself(x, y)


def test_recursion_and_a_function_without_source_are_refused():
    scope = {}
    exec("def unseen(x, y):\n    y[0] = x[0]\n", scope)
    for function, complaint in (
        (calls_itself, "calls_itself calls itself"),
        (scope["unseen"], "unseen: its source cannot be read"),
        (lambda x, y: None, "expected a def, got"),
    ):
        with pytest.raises(InvalidArgument, match=complaint):
            text(function)


TWO_FORMS = """
from sysid_evo.engine.compiled.compiler import compile_kernel
from sysid_evo.kernels import REALS, KernelSource, Signature
from tests.fixtures.same_name import doubled
for pointer in (False, True):
    compile_kernel(KernelSource(doubled), Signature(x=REALS, y=REALS), "float32", pointer=pointer)
"""


def files(folder):
    return {str(path): path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


def in_another_process():
    root = Path(__file__).parents[3]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    subprocess.run([sys.executable, "-B", "-c", TWO_FORMS], check=True, cwd=root, env=environment)


def compiled_here():
    """As in a process that has compiled nothing yet."""
    _compiled_before.cache_clear()
    with pytest.MonkeyPatch.context() as patch:
        for name in [name for name in sys.modules if name.startswith("sysid_evo_kernel_")]:
            patch.delitem(sys.modules, name)
        exec(TWO_FORMS, {})


@pytest.mark.parametrize("again", [compiled_here, pytest.param(in_another_process, marks=pytest.mark.nightly)])
def test_what_was_compiled_is_found_again(again, tmp_path, monkeypatch):
    monkeypatch.setenv("SYSID_EVO_CACHE", str(tmp_path))
    compiled_here()
    before = files(tmp_path)
    again()
    names = [Path(name).suffix for name in before]
    assert names.count(".py") == names.count(".nbi") == names.count(".nbc") == 2
    assert files(tmp_path) == before


def test_kernels_are_kept_where_the_environment_says():
    call(with_numbers, 0.0)
    assert cache_folder("kernels") == Path(os.environ["SYSID_EVO_CACHE"]) / "sysid-evo" / "kernels"
    assert any(cache_folder("kernels").glob("sysid_evo_kernel_*.py"))


def test_what_another_process_compiles_is_waited_for(tmp_path, monkeypatch):
    monkeypatch.setenv("SYSID_EVO_CACHE", str(tmp_path))
    generated = "entry = 'waited for'\n"
    waiting = threading.Thread(target=imported, args=(generated,))
    folder = cache_folder("kernels")
    folder.mkdir(parents=True)
    with FileLock(folder / f"{module_name(generated)}.lock"):
        waiting.start()
        waiting.join(0.5)
        assert waiting.is_alive()
    waiting.join()
    assert sys.modules.pop(module_name(generated)).entry == "waited for"


def test_a_function_within_a_kernel_is_not_made_into_machine_code_of_its_own(tmp_path):
    path = tmp_path / "not_from_the_cache.py"
    path.write_text(text(same_name.doubled).replace("cache=True, ", ""))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    translated = {
        name: made.library.get_pointer_to_function(made.fndesc.mangled_name) != 0
        for name, function in vars(module).items()
        if hasattr(function, "overloads") and function.__module__ == path.stem
        for made in function.overloads.values()
    }
    assert translated == {"entry": True, "double_1": False}


def test_a_version_of_numba_that_was_not_tried_compiles_in_its_own_way():
    assert compiler_for((0, 61)) is Compiler
    assert all(compiler_for(version) is not Compiler for version in CHECKED_VERSIONS)


def amplify(x, p):
    for i in range(int(p[HEAD.n])):
        x[i] *= p[HEAD.gain] * p[HEAD.size]


def loop(dynamics, sizes, first, x):
    x[0] = 1.0


SIZES, WORK, FOUND = Layout("rows", "unread"), Arrays("a", "b"), Arrays("count", kind=INTEGERS)


def adding(sizes, work, found, first):
    for i in range(first, sizes.rows):
        work.b[i] += work.a[i]
        found.count[0] += 1


def test_a_loop_reads_numbers_and_arrays_within_its_arguments_by_name():
    signature = Signature.of(adding, sizes=SIZES, work=WORK, found=FOUND, first=INTEGER)
    assert str(signature) == "types.void(I, types.UniTuple(R, 2), types.UniTuple(I, 1), types.int64)"
    sizes, found = SIZES.integers(unread=7, rows=3), {"count": np.zeros(1, np.int64)}
    arrays = {"b": np.ones(4), "a": np.arange(4.0)}
    compiled_loop(adding, signature, "float64")(sizes, WORK.chosen(arrays), FOUND.chosen(found), 1)
    np.testing.assert_array_equal(arrays["b"], [1.0, 2.0, 3.0, 1.0])
    assert found["count"] == 2
    with pytest.raises(InvalidArgument, match=r"uses .work\.b.: attributes of arrays"):
        compiled_loop(adding, Signature.of(adding, sizes=SIZES, found=FOUND, first=INTEGER), "float64")


def test_a_layout_packs_by_name_and_a_kernel_reads_by_name():
    parameters = HEAD.pack([5.0], gain=3.0, n=2)
    np.testing.assert_array_equal(parameters, [2.0, 3.0, 0.0, 0.0, 5.0])
    x = call_block(amplify, Signature(x=REALS, p=REALS), "float64", [np.ones(3), parameters])[0]
    np.testing.assert_array_equal(x, [15.0, 15.0, 1.0])
    listed = HEAD.pack([5.0], gain=np.array([7.0, 8.0]), n=2)
    np.testing.assert_array_equal(listed, [2.0, 16.0, 0.0, 0.0, 5.0, *[0.0] * 11, 7.0, 8.0])


def test_a_layout_takes_its_names_and_no_others():
    with pytest.raises(InvalidArgument, match="layout: expected n, gain, got n"):
        HEAD.pack(n=1)
    with pytest.raises(InvalidArgument, match="layout: expected n, gain, got n, gain, bias"):
        HEAD.pack(n=1, gain=1.0, bias=0.0)
    with pytest.raises(AttributeError, match="layout: no 'bias'; its names are n, gain"):
        _ = HEAD.bias
    for names in (("n", "n"), ("size",)):
        with pytest.raises(InvalidArgument, match="expected different names, none of them 'size'"):
            Layout(*names)


def test_what_is_padded_ends_on_a_whole_line():
    assert [len(padded(np.ones(n))) for n in (0, 1, 16, 17)] == [0, 16, 16, 32]


def test_a_signature_is_the_type_and_the_order_of_a_call():
    signature = Signature.of(loop, dynamics=DYNAMICS, sizes=INTEGERS, first=INTEGER)
    inner = f"types.FunctionType(types.void({', '.join(['types.CPointer(R.dtype)'] * 5)}))"
    assert str(signature) == f"types.void({inner}, I, types.int64, R)"
    assert signature.ordered(x="d", first="c", sizes="b", dynamics="a") == ("a", "b", "c", "d")


def test_calls_that_do_not_fit_a_signature_are_refused():
    with pytest.raises(InvalidArgument, match="must only have arrays as arguments, got first"):
        str(Signature(kernel=Signature(x=REALS, first=INTEGER)))
    with pytest.raises(InvalidArgument, match="missing arguments: y; unknown ones: z"):
        SIGNATURE.ordered(x=1, z=2)
    with pytest.raises(InvalidArgument, match="signature of loop: no argument is called speed"):
        Signature.of(loop, speed=INTEGER)
    few = r"amplify: expected 5 arguments \(carry, control, noise, parameters, scratch\), got 2 \(x, p\)"
    with pytest.raises(InvalidArgument, match=few):
        compile_kernel(KernelSource(amplify), DYNAMICS, "float32")
