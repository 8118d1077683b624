"""What a kernel function may use, what it becomes, and what it is told otherwise."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from sysid_evo.engine.compiled.compiler import compile_kernel
from sysid_evo.engine.compiled.language import generate
from sysid_evo.errors import InvalidArgument
from sysid_evo.files import cache_folder
from sysid_evo.kernels import REALS, KernelSource, Precision, Signature
from tests.sysid_evo.engine import same_name
from tests.sysid_evo.engine.running import PRECISIONS

SIGNATURE = Signature(x=REALS, y=REALS)
GAIN = 0.1
COUNT = 3
SWITCH = True
NUMPY_NUMBER = np.float64(0.25)
TABLE = np.zeros(3)
ENTRIES = [1.0, 2.0]


def call(function: Callable[..., Any], x: list[float], precision: Precision = "float64", **bindings: Any) -> list[Any]:
    compiled = compile_kernel(KernelSource(function, bindings), SIGNATURE, precision, pointer=False)
    y = np.zeros(4, dtype=precision)
    compiled(np.array(x, dtype=precision), y)
    return y.tolist()


def text(function: Callable[..., Any], precision: Precision = "float32") -> str:
    return generate(KernelSource(function), SIGNATURE, precision, pointer=False)


def with_numbers(x, y):
    y[0] = GAIN * x[0]
    y[1] = COUNT
    y[2] = 1.0 if SWITCH else 0.0
    y[3] = NUMPY_NUMBER * math.pi


def helper(x):
    return 100.0 * same_name.helper(x)


def with_one_name_three_times(x, y):
    y[0] = helper(x[0])


@numba.njit
def decorated(x):
    return x + GAIN


def with_a_decorated_function(x, y):
    y[0] = decorated(x[0])


def with_a_bound_function(x, y):
    y[0] = inner(x[0])  # noqa: F821  # bound in the test


def with_locals_named_like_the_generated_text(x, y):
    real, types, entry = x[0], 2.0, 3.0
    helper_1 = 4.0
    y[0] = real * types * entry * helper_1 * 0.5


def with_a_cast(x, y):
    y[0] = float(3) * 0.1


def test_module_level_numbers_become_literals() -> None:
    assert call(with_numbers, [2.0]) == [0.2, 3.0, 1.0, 0.25 * math.pi]


def test_functions_of_one_name_in_three_modules_stay_apart() -> None:
    for precision in PRECISIONS:
        assert call(with_one_name_three_times, [2.0], precision)[0] == 3000.0


def test_a_function_decorated_with_njit_is_taken() -> None:
    assert call(with_a_decorated_function, [2.0])[0] == 2.1


def test_free_names_stand_for_what_is_bound() -> None:
    assert call(with_a_bound_function, [2.0], inner=decorated)[0] == 2.1
    assert call(with_a_bound_function, [2.0], inner=KernelSource(same_name.helper))[0] == 30.0
    with pytest.raises(InvalidArgument, match=r"with_a_bound_function uses 'inner': no such name"):
        call(with_a_bound_function, [2.0])


def test_a_local_name_never_clashes_with_the_generated_text() -> None:
    for precision in PRECISIONS:
        assert call(with_locals_named_like_the_generated_text, [2.0], precision)[0] == 24.0


def test_a_closure_over_a_number_is_taken() -> None:
    factor = 7.0

    def times(x, y):
        y[0] = factor * x[0]

    assert call(times, [2.0])[0] == 14.0


def test_literals_have_the_precision_of_the_kernel() -> None:
    assert call(with_a_cast, [0.0], "float32")[0] == np.float32(3) * np.float32(0.1)
    assert call(with_a_cast, [0.0], "float64")[0] == 3 * 0.1


def mathematics(x, y):
    y[0] = math.sin(x[0]) + math.cos(x[0]) + math.tanh(x[0])
    y[1] = math.exp(x[0]) + math.sqrt(x[0]) + math.log(x[0])
    y[2] = math.atan2(x[0], 2.0) + math.hypot(x[0], 3.0)
    y[3] = abs(-x[0]) + min(x[0], 1.0) + max(x[0], 5.0)


def test_mathematics_is_the_library_in_float64_and_good_to_float32_in_float32() -> None:
    x = 0.7
    expected = [
        math.sin(x) + math.cos(x) + math.tanh(x),
        math.exp(x) + math.sqrt(x) + math.log(x),
        math.atan2(x, 2.0) + math.hypot(x, 3.0),
        x + x + 5.0,
    ]
    np.testing.assert_allclose(call(mathematics, [x]), expected, rtol=1e-15)
    np.testing.assert_allclose(call(mathematics, [x], "float32"), expected, rtol=3e-7)
    assert "math.tanh" in text(mathematics, "float64")
    assert "math.tanh" not in text(mathematics, "float32")


def uses_numpy(x, y):
    y[0] = np.sin(x[0])


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
    y[0] = nowhere  # noqa: F821  # what is tested


def uses_an_object(x, y):
    y[0] = Path(x[0])


def uses_a_builtin(x, y):
    y[0] = sum(x)


@pytest.mark.parametrize(
    "function, name",
    [
        (uses_numpy, "np.sin"),
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
def test_what_cannot_be_used_is_refused_with_function_and_name(function: Any, name: str) -> None:
    with pytest.raises(InvalidArgument) as refused:
        text(function)
    assert function.__name__ in str(refused.value)
    assert repr(name) in str(refused.value)


def calls_itself(x, y):
    calls_itself(x, y)


def test_recursion_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="calls_itself calls itself"):
        text(calls_itself)


def test_a_function_without_source_is_refused() -> None:
    scope: dict[str, Any] = {}
    exec("def unseen(x, y):\n    y[0] = x[0]\n", scope)
    with pytest.raises(InvalidArgument, match="unseen: its source cannot be read"):
        text(scope["unseen"])
    with pytest.raises(InvalidArgument, match="expected a def, got"):
        text(lambda x, y: None)


SECOND = """
import json, sys
from pathlib import Path
from sysid_evo.engine.compiled.compiler import compile_kernel
from sysid_evo.kernels import REALS, KernelSource, Signature
from tests.sysid_evo.engine.test_dialect import with_numbers, mathematics
for function in (with_numbers, mathematics):
    for pointer in (False, True):
        compile_kernel(KernelSource(function), Signature(x=REALS, y=REALS), "float32", pointer=pointer)
"""


def files(folder: Path) -> dict[str, int]:
    return {str(path): path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


def test_a_second_process_finds_everything_compiled(tmp_path: Path) -> None:
    root = Path(__file__).parents[3]
    environment = {**os.environ, "SYSID_EVO_CACHE": str(tmp_path), "PYTHONPATH": str(root)}
    for _ in range(2):
        before = files(tmp_path)
        subprocess.run([sys.executable, "-B", "-c", SECOND], check=True, cwd=root, env=environment)
    names = [Path(name).suffix for name in before]
    assert names.count(".py") == names.count(".nbi") == names.count(".nbc") == 4
    assert files(tmp_path) == before


def test_kernels_are_kept_where_the_environment_says() -> None:
    call(with_a_cast, [0.0])
    assert cache_folder("kernels") == Path(os.environ["SYSID_EVO_CACHE"]) / "sysid-evo" / "kernels"
    assert any(cache_folder("kernels").glob("sysid_evo_kernel_*.py"))
