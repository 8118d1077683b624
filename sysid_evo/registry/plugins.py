"""Plugin files that are not installed: loading, trust, and the source code of registered things.

The user may load any file. A plugin that a stored file names must be trusted: it has run here before and has not
changed since. The user's state folder records the SHA-256 and path of each plugin file that has run. SECURITY.md states
the rule for every kind of file.
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

from sysid_evo.errors import InvalidArgument, PluginError, PluginWarning, RegistrationError
from sysid_evo.files import state_folder, write_atomically

SHIPPED = ("sysid_evo", "model_zoo", "evaluation", "hardware")
PREFIX = "sysid_evo_plugin_"


def load_plugin(path: str | Path) -> None:
    """Import a plugin file, so that its decorators run, and trust it as long as it does not change.

    Raises `PluginError` if the file is missing or fails while it is imported, `RegistrationError` if it
    registers a name that is in use.
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
    """Import plugin files that the stored file ``by`` names, if they are trusted; return the loaded files.

    A loaded plugin of the same file name is used instead, with a `PluginWarning` if its path differs. Raises
    `PluginError` for files that are not trusted, and the errors of `load_plugin`.
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
            f"{by} names {names}. A plugin is code that runs with your rights, so it is not run just because a file "
            f"names it: read it and, if you trust it, add {options} (in Python call load_plugin first)"
        )
    return tuple(dict.fromkeys(found))


def loaded_plugins() -> tuple[str, ...]:
    """Return the plugin files that this process has loaded, in this order."""
    return tuple(str(module.__file__) for name, module in sys.modules.items() if name.startswith(PREFIX))


def named_in_plugin(text: str, kind: type) -> Any:
    """Return the function or class called ``text`` of the loaded plugin files, of type ``kind``.

    ``FILE.NAME`` chooses a file. Only the files' own definitions are found. Raises `InvalidArgument`.
    """
    file, _, name = text.rpartition(".")
    found = {
        module.removeprefix(PREFIX): thing
        for module, content in list(sys.modules.items())
        if (not file or module == PREFIX + file)
        and module.startswith(PREFIX)
        and isinstance(thing := vars(content).get(name), kind)
        and getattr(thing, "__module__", "") == module
    }
    if len(found) != 1:
        several = f"in several: write {' or '.join(f'{stem}.{name}' for stem in sorted(found))}" if found else "in none"
        raise InvalidArgument(
            f"expected the name of a {kind.__name__} in a plugin file that is loaded, got {text!r}, which is {several}"
            "; add --plugin FILE (in Python load_plugin)"
        )
    return next(iter(found.values()))


def load_plugins_again(paths: Iterable[str]) -> None:
    """Import the plugin files of the parent process, which has checked that they are trusted."""
    for file in map(Path, paths):
        if _module(file) not in sys.modules:
            _run(file, _source(file))


def _trust(file: Path, source: bytes) -> None:
    """Record that the user has loaded ``file``, an absolute path, with this ``source``."""
    if _distrust(file, source):
        line = hashlib.sha256(source).hexdigest().encode() + b"  " + os.fsencode(file) + b"\n"
        with suppress(OSError):  # the home folder is not writable: the user will be asked again
            write_atomically(_note(file), lambda note: note.write_bytes(line))


def _distrust(file: Path, source: bytes) -> str:
    """Return the reason why ``file`` is not trusted; empty if it is."""
    try:
        known = _note(file).read_bytes().split(b" ")[0].decode(errors="replace")
    except OSError:
        return "has not run here yet"
    return "" if known == hashlib.sha256(source).hexdigest() else "has changed since it ran here"


def _note(file: Path) -> Path:
    # path and content: the same source in another folder may import other files next to it
    return state_folder("plugins") / hashlib.sha256(os.fsencode(file)).hexdigest()


class _FromSource(SourceFileLoader):
    """Loads a module from the ``source`` that was checked, never from cached bytecode, which may be another."""

    def __init__(self, name: str, path: str, source: bytes) -> None:
        super().__init__(name, path)
        self._bytes = source

    def get_code(self, fullname: str) -> CodeType:
        code: CodeType = self.source_to_code(self._bytes, self.path)
        return code


def _module(file: Path) -> str:
    return f"{PREFIX}{file.stem}"


def _source(file: Path) -> bytes:
    if file.is_dir():
        inside = ", ".join(sorted(path.name for path in file.glob("*.py"))[:4]) or "no Python file"
        raise PluginError(f"plugin {file}: expected a Python file, but this is a folder; it contains {inside}")
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
    """Return the SHA-256 of the source code that defines ``factory``; empty for code of this project.

    For a module in a package, all Python files of that package are included. The code of this project is identified
    by its version, which every result records.
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
    if not path.exists():  # a script that Python reads from its standard input
        return f"no source: {module}"
    files = sorted(path.parent.rglob("*.py")) if path.name == "__init__.py" else [path]
    digest = hashlib.sha256()
    for source in files:
        digest.update(source.relative_to(path.parent).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    return digest.hexdigest()


def declared(module: str, name: str) -> dict[str, Any] | None:
    """Return the docstring (``__doc__``) and the literal attributes of the class that ``module`` registers as ``name``.

    They are read from the source of a shipped module, because an import with Numba takes a second. None if not found.
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
                    with suppress(ValueError):  # not a literal
                        found[ast.unparse(target)] = ast.literal_eval(item.value)
            return found
    return None
