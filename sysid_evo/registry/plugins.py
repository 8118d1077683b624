"""Plugin files that are not installed: loading them, whether they may run, and the source of registered things.

The user may load any file. One that a stored file names must be trusted: it has run here before and is unchanged since.
The user's state folder holds a note for each plugin file that has run: its SHA-256 and its path. SECURITY.md states the
rule for every kind of file.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import os
import shlex
import sys
import warnings
from collections.abc import Callable, Iterable
from contextlib import suppress
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any

from sysid_evo.errors import PluginError, PluginWarning, RegistrationError
from sysid_evo.files import state_folder, write_atomically

SHIPPED = ("sysid_evo", "model_zoo", "evaluation", "hardware")
PREFIX = "sysid_evo_plugin_"


def load_plugin(path: str | Path) -> None:
    """Import a plugin file that is not installed, so that its decorators run, and trust it from now on, unchanged.

    Raises `PluginError` if the file is missing or fails while it is imported, `RegistrationError` if it
    takes a name that is in use.
    """
    file = Path(path).resolve()
    loaded = sys.modules.get(_module(file))
    if loaded is None:
        source = _source(file)
        _trust(file, source)
        _run(file, source)
    elif loaded.__file__ != str(file):
        raise PluginError(f"plugin {file}: {loaded.__file__}, a file of the same name, is loaded already; rename one")


def load_named_plugins(paths: Iterable[str | Path], by: Path) -> tuple[str, ...]:
    """Import plugin files that the stored file ``by`` names, if they are trusted; return the files that are loaded.

    A loaded plugin is used for a file of the same name, with a `PluginWarning` if its path differs. Raises
    `PluginError` for those that this user has not run here, unchanged, and what `load_plugin` does.
    """
    found, refused = [], []
    for file in (Path(path).resolve() for path in paths):
        loaded = sys.modules.get(_module(file))
        if loaded is None:
            source = _source(file) if file.is_file() else None
            why = "is not there" if source is None else _distrust(file, source)
            if source is None or why:
                refused.append((file, why))
                continue
            _run(file, source)
        elif loaded.__file__ != str(file):
            sentence = f"{by} names the plugin {file}: {loaded.__file__}, which has the same name, is used for it"
            warnings.warn(sentence, PluginWarning, stacklevel=2)
        found.append(str(file if loaded is None else loaded.__file__))
    if refused:
        names = " and ".join(f"the plugin {file}, which {why}" for file, why in refused)
        options = " ".join(f"--plugin {shlex.quote(str(file))}" for file, _ in refused)
        raise PluginError(
            f"{by} names {names}. A plugin is code that runs with your rights, so none runs because a file names it: "
            f"read it and, if you trust it, add {options} (in Python call load_plugin first)"
        )
    return tuple(dict.fromkeys(found))


def loaded_plugins() -> tuple[str, ...]:
    """Return the plugin files that this process has loaded, the first one first."""
    return tuple(str(module.__file__) for name, module in sys.modules.items() if name.startswith(PREFIX))


def load_plugins_again(paths: Iterable[str]) -> None:
    """Import the plugin files of the process that this one works for, which has decided to trust them."""
    for file in map(Path, paths):
        if _module(file) not in sys.modules:
            _run(file, _source(file))


def _trust(file: Path, source: bytes) -> None:
    """Note that the user has asked for ``file``, an absolute path, while it held ``source``."""
    if _distrust(file, source):
        line = hashlib.sha256(source).hexdigest().encode() + b"  " + os.fsencode(file) + b"\n"
        with suppress(OSError):  # a home that cannot be written: the user will be asked again
            write_atomically(_note(file), lambda note: note.write_bytes(line))


def _distrust(file: Path, source: bytes) -> str:
    """Return why ``file`` may not run unless the user asks for it; empty if it may."""
    try:
        known = _note(file).read_bytes().split(b" ")[0].decode(errors="replace")
    except OSError:
        return "has not run here yet"
    return "" if known == hashlib.sha256(source).hexdigest() else "has changed since it ran here"


def _note(file: Path) -> Path:
    # by path as well as by content: the same text elsewhere may read or import other files next to it
    return state_folder("plugins") / hashlib.sha256(os.fsencode(file)).hexdigest()


class _FromSource(SourceFileLoader):
    """Loads a module from the ``source`` that was looked at, never from cached bytecode, which others may have made."""

    def __init__(self, name: str, path: str, source: bytes) -> None:
        super().__init__(name, path)
        self._bytes = source

    def get_code(self, fullname: str) -> CodeType:
        code: CodeType = self.source_to_code(self._bytes, self.path)
        return code


def _module(file: Path) -> str:
    return f"{PREFIX}{file.stem}"


def _source(file: Path) -> bytes:
    if file.suffix != ".py" or not file.is_file():
        raise PluginError(f"plugin {file}: expected a Python file, found none")
    return file.read_bytes()


def _run(file: Path, source: bytes) -> None:
    name = _module(file)
    loader = _FromSource(name, str(file), source)
    spec = importlib.util.spec_from_file_location(name, file, loader=loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        loader.exec_module(module)
    except RegistrationError as error:
        del sys.modules[name]
        raise RegistrationError(f"plugin {file}: {error}") from error
    except Exception as error:  # a plugin may fail in any way while it is imported
        del sys.modules[name]
        raise PluginError(f"plugin {file} cannot be imported: {type(error).__name__}: {error}") from error


def source_digest(factory: Callable[..., Any]) -> str:
    """Return the SHA-256 of the source that brings ``factory``; empty for what this project ships.

    A module of a package counts with every Python file of the package it stands in. What is shipped
    changes with the version of the project, which every result is tied to anyway.
    """
    module = getattr(factory, "__module__", "")
    if module.split(".")[0] in SHIPPED:
        return ""
    return _digest_of(module)


def _digest_of(module: str) -> str:
    top = sys.modules.get(module.split(".")[0])
    file = getattr(top, "__file__", None) or getattr(sys.modules.get(module), "__file__", None)
    if file is None:
        return f"no source: {module}"
    path = Path(file)
    files = sorted(path.parent.rglob("*.py")) if path.name == "__init__.py" else [path]
    digest = hashlib.sha256()
    for source in files:
        digest.update(source.relative_to(path.parent).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    return digest.hexdigest()


def declared(module: str, name: str) -> dict[str, Any] | None:
    """Return the docstring (``__doc__``) and the literal class attributes of what a shipped ``module`` calls ``name``.

    They are read from its source, as importing it takes a second where it brings Numba. None if it does not say.
    """
    file = Path(__file__).parents[2].joinpath(*module.split("."))
    file = file / "__init__.py" if file.is_dir() else file.with_suffix(".py")
    for node in ast.parse(file.read_bytes()).body if file.is_file() else ():
        decorators = getattr(node, "decorator_list", ())
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and any(
            f"({name!r})" in ast.unparse(d) for d in decorators
        ):
            found: dict[str, Any] = {"__doc__": ast.get_docstring(node)}
            for item in node.body:
                if isinstance(item, (ast.Assign, ast.AnnAssign)) and item.value is not None:
                    target = item.target if isinstance(item, ast.AnnAssign) else item.targets[0]
                    with suppress(ValueError):  # no literal
                        found[ast.unparse(target)] = ast.literal_eval(item.value)
            return found
    return None
