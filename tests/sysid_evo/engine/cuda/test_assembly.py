"""Every shipped kernel is compiled for a device of compute capability 9.0, where the compiler is installed."""

from __future__ import annotations

import os
import re

import pytest

from .assembly import assembly, compiler_is_missing
from .cases import CASES, seldom

ALWAYS = {"parametrised"}


@pytest.fixture(scope="module", autouse=True)
def _with_a_compiler() -> None:
    if os.environ.get("NUMBA_ENABLE_CUDASIM") == "1":
        pytest.skip("the simulator compiles nothing")
    if why := compiler_is_missing():
        pytest.skip(why)


@pytest.mark.parametrize("name", [seldom(name, CASES.keys() - ALWAYS) for name in CASES])
def test_a_case_becomes_one_function_of_the_device_without_doubles(name: str) -> None:
    text = assembly(CASES[name](), "float32")
    assert ".target sm_90" in text
    assert text.count(".entry") == 1
    assert not re.search(r"call(\.uni)?\s", text), "a function was not taken into the one that calls it"
    assert ".f64" not in text, "a number of double precision takes 32 times as long on most devices"
