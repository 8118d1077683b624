"""Compilation of kernels: one generated file for each kernel, stored on disk, locked between processes.

The file name is a hash of everything that the compiled form depends on, so a stale file is never used, and another
process reuses the compiled code. This module does not import Numba: only the generated files do, when the first kernel
is compiled. Importing this module is therefore cheap.
"""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sysid_evo.engine.compiled.language import generate, plain_function
from sysid_evo.files import cache_folder, write_atomically
from sysid_evo.kernels import KernelSource, Precision, Signature, Source

FENCED = ("internals.py", "vectors.py")
"""The modules that import Numba and LLVM and implement the words of kernels. Generated files import them."""

LOCK_TIMEOUT = 60.0
"""Seconds to wait for another process that compiles the same file; most take two."""

_IMPORTING = threading.RLock()


def compile_kernel(source: Source, signature: Signature, precision: Precision, *, pointer: bool = True) -> Any:
    """Return ``source`` compiled for ``signature``. Raises `InvalidArgument` if it takes other arguments.

    With ``pointer`` the result can be passed to compiled code as a first-class function that takes the addresses of
    arrays. Without ``pointer`` it is called from Python and releases the interpreter lock.
    """
    if isinstance(source, KernelSource):
        signature.check(plain_function(source.function))
    return imported(generate(source, signature, precision, pointer=pointer)).entry


@cache
def compiled(source: Source, signature: Signature, precision: Precision) -> Any:
    """Return the kernel as a first-class function, compiled at most once per process."""
    return compile_kernel(source, signature, precision)


@cache
def compiled_loop(function: Callable[..., None], signature: Signature, precision: Precision) -> Any:
    """Return a loop over time that is called from Python, compiled at most once per process."""
    return compile_kernel(KernelSource(function), signature, precision, pointer=False)


def module_name(text: str) -> str:
    """Return the module name of a generated file: a hash of its ``text`` and of all it depends on."""
    digest = hashlib.sha256((_fingerprint() + text).encode()).hexdigest()[:24]
    return f"sysid_evo_kernel_{digest}"


@cache
def _fingerprint() -> str:
    """Return a digest of everything outside a generated file on which its compiled form depends."""
    sources = [Path(__file__).with_name(name).read_text(encoding="utf-8") for name in FENCED]
    parts = [version("numba"), version("llvmlite"), sys.version, *sources]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def imported(text: str) -> Any:
    """Return the module of a generated file, from the cache if it is there."""
    name = module_name(text)
    with _IMPORTING:
        return sys.modules[name] if name in sys.modules else _load(name, text)


def _load(name: str, text: str) -> Any:
    """Import the file, and so compile it unless it is compiled; other processes wait for the same file."""
    path = cache_folder("kernels") / f"{name}.py"
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    with nullcontext() if name in _compiled_before(path.parent) else locked(path.with_suffix(".lock")):
        return load_module(name, path)


@cache
def _compiled_before(folder: Path) -> frozenset[str]:
    """Return the names of the files that were compiled before the first call in this process."""
    compiled = folder / "__pycache__"
    return frozenset(path.name.split(".")[0] for path in compiled.iterdir()) if compiled.is_dir() else frozenset()


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock; continue without it if locks are unavailable, or after `LOCK_TIMEOUT`."""
    from filelock import FileLock

    lock = FileLock(path)
    with suppress(OSError, NotImplementedError):
        lock.acquire(timeout=LOCK_TIMEOUT)
    try:
        yield
    finally:
        lock.release()


def load_module(name: str, path: Path) -> Any:
    """Return the module ``name``, imported from ``path``."""
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
