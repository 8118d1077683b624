"""The shape of the four packages: few modules, no cycles, imports at the top, every class name once."""

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
    trees,
)

HEAVY = {
    "cobs", "control", "distributed", "filelock", "gymnasium", "joblib", "lightgbm",
    "matplotlib", "motioncapture", "mujoco", "natnet", "packaging", "pandas", "psutil",
    "pyarrow", "pysindy", "rich", "scipy", "serial", "skops", "sklearn", "starlette", "torch", "torchdiffeq",
    "uvicorn", "websockets", "xgboost",
}  # fmt: skip
"""Packages that a function may import, since loading them takes long or they are an extra."""


@pytest.fixture(scope="module", autouse=True)
def _parsed():
    """All modules are parsed once, which takes a second or two."""
    trees()


def test_there_are_few_modules_and_few_lines():
    assert len(contents()) <= 317
    assert len(lists()) <= 42
    assert sum(map(lines_of, contents() + lists())) <= 72_800


def test_no_module_is_longer_than_can_be_read_at_once():
    assert [str(file) for file in contents() if lines_of(file) > 600] == []


def test_no_modules_import_each_other_in_a_round():
    assert cycles() == []


def test_imports_stand_at_the_top():
    assert len(late_imports()) <= 20, late_imports()


def test_functions_import_heavy_packages_only():
    assert [(module, package) for module, package in imports_in_functions() if package not in HEAVY] == []


def test_every_class_name_is_defined_once():
    assert repeated_classes() == {}


def test_only_the_fence_around_the_compiler_imports_it():
    modules = importers_of(*COMPILERS)
    assert 1 <= len(modules) <= 5
    assert [module for module in modules if not module.startswith("sysid_evo.engine.compiled.")] == []
