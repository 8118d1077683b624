"""Generated files: who compiles them, and how much of them."""

from __future__ import annotations

import importlib.util
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock
from numba.core.compiler import Compiler

from sysid_evo.engine.compiled.compiler import imported, name_of
from sysid_evo.engine.compiled.internals import TRIED, compiler_for
from sysid_evo.engine.compiled.language import generate
from sysid_evo.files import cache_folder
from sysid_evo.kernels import REALS, KernelSource, Signature


def test_what_another_process_compiles_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SYSID_EVO_CACHE", str(tmp_path))
    text = "entry = 'waited for'\n"
    waiting = threading.Thread(target=imported, args=(text,))
    folder = cache_folder("kernels")
    folder.mkdir(parents=True)
    with FileLock(folder / f"{name_of(text)}.lock"):
        waiting.start()
        waiting.join(0.5)
        assert waiting.is_alive()
    waiting.join()
    assert sys.modules.pop(name_of(text)).entry == "waited for"


def double(x):  # type: ignore[no-untyped-def]  # the kernel's language
    return 2.0 * x


def twice(x, y):  # type: ignore[no-untyped-def]  # the kernel's language
    y[0] = double(double(x[0]))


def test_a_function_within_a_kernel_is_not_made_into_machine_code_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "not_from_the_cache.py"
    text = generate(KernelSource(twice), Signature(x=REALS, y=REALS), "float32", pointer=False)
    path.write_text(text.replace("cache=True, ", ""))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    translated = {
        name: made.library.get_pointer_to_function(made.fndesc.mangled_name) != 0
        for name, function in vars(module).items()
        if hasattr(function, "overloads") and function.__module__ == path.stem
        for made in function.overloads.values()
    }
    assert translated == {"entry": True, "double_1": False}


def test_a_version_of_numba_that_was_not_tried_compiles_in_its_own_way() -> None:
    assert compiler_for((0, 61)) is Compiler
    assert all(compiler_for(version) is not Compiler for version in TRIED)
