"""Generated files: kept in the cache under a name that says all they depend on, and imported once a process."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import sys
import threading
from functools import cache
from typing import Any

import llvmlite
import numba

from sysid_evo.engine.compiled import lanes, pointers, row_mathematics, rows
from sysid_evo.files import cache_folder, write_atomically

_IMPORTING = threading.RLock()


@cache
def _fingerprint() -> str:
    """Return a digest of everything outside a generated file that its compiled form depends on."""
    rooms = [inspect.getsource(module) for module in (rows, lanes, pointers, row_mathematics)]
    parts = [numba.__version__, llvmlite.__version__, sys.version, *rooms]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def imported(text: str) -> Any:
    """Return the module of a generated file, kept in the cache under a name that says all it depends on."""
    digest = hashlib.sha256((_fingerprint() + text).encode()).hexdigest()[:24]
    name = f"sysid_evo_kernel_{digest}"
    with _IMPORTING:
        return sys.modules[name] if name in sys.modules else _load(name, text)


def _load(name: str, text: str) -> Any:
    path = cache_folder("kernels") / f"{name}.py"
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
