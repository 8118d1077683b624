"""Plugin files that are not installed, and the digest of where a registered thing comes from."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sysid_evo.errors import PluginError, RegistrationError

SHIPPED = ("sysid_evo", "model_zoo", "evaluation", "hardware")
PREFIX = "sysid_evo_plugin_"


def load_plugin(path: str | Path) -> None:
    """Import a plugin file that is not installed, so that its decorators run.

    Raises `PluginError` if the file is missing or fails while it is imported, `RegistrationError` if it
    takes a name that is in use.
    """
    path = Path(path).resolve()
    name = f"{PREFIX}{path.stem}"
    loaded = sys.modules.get(name)
    if loaded is not None:
        if loaded.__file__ != str(path):
            raise PluginError(
                f"plugin {path}: {loaded.__file__}, a file of the same name, is loaded already; rename one"
            )
        return
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise PluginError(f"plugin {path}: expected a Python file, found none")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except RegistrationError as error:
        del sys.modules[name]
        raise RegistrationError(f"plugin {path}: {error}") from error
    except Exception as error:  # a plugin may fail in any way while it is imported
        del sys.modules[name]
        raise PluginError(f"plugin {path} cannot be imported: {type(error).__name__}: {error}") from error


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
