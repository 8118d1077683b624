"""The shape of the four packages: few modules, no cycles, imports at the top, every class name once."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from tests.layout import (
    COMPILERS,
    contents,
    cycles,
    importers_of,
    imports_in_functions,
    late_imports,
    lines_of,
    lists,
    repeated_classes,
)

HEAVY = {
    "cobs", "control", "cvxpy", "distributed", "filelock", "gymnasium", "jinja2", "joblib", "markupsafe",
    "matplotlib", "motioncapture", "mujoco", "natnet", "onnx", "onnxruntime", "optuna", "pandas", "psutil",
    "pyarrow", "pysindy", "ribs", "rich", "scipy", "serial", "sklearn", "starlette", "torch", "torchdiffeq",
    "uvicorn", "websockets", "xarray",
}  # fmt: skip
"""Packages that a function may import, since loading them takes long or they are an extra."""


def test_there_are_few_modules_and_few_lines() -> None:
    assert len(contents()) <= 300
    assert len(lists()) <= 42
    assert sum(map(lines_of, contents() + lists())) <= 66_500


def test_no_module_is_longer_than_can_be_read_at_once() -> None:
    assert [str(file) for file in contents() if lines_of(file) > 600] == []


def test_no_modules_import_each_other_in_a_round() -> None:
    assert cycles() == []


def test_imports_stand_at_the_top() -> None:
    assert len(late_imports()) <= 40, late_imports()


def test_functions_import_heavy_packages_only() -> None:
    assert [(module, package) for module, package in imports_in_functions() if package not in HEAVY] == []


def test_every_class_name_is_defined_once() -> None:
    assert repeated_classes() == {}


def test_only_the_fence_around_the_compiler_imports_it() -> None:
    modules = importers_of(*COMPILERS)
    assert len(modules) <= 5
    assert [module for module in modules if not module.startswith("sysid_evo.engine.compiled.")] == []


@pytest.mark.parametrize(
    "package",
    [
        *(f"sysid_evo.{name}" for name in ("models", "tasks", "controllers", "engine", "evolution", "testing")),
        "model_zoo",
    ],
)
def test_what_can_be_compiled_loads_neither_the_compiler_nor_torch(package: str) -> None:
    program = f"import json, sys, {package}; print(json.dumps(sorted(sys.modules)))"
    loaded = json.loads(subprocess.check_output([sys.executable, "-c", program]))
    assert {"numba", "llvmlite", "torch"} & set(loaded) == set()
