"""Templates of a working plugin package for each kind with a contract: one file, one entry point, one test."""

from __future__ import annotations

import importlib.util
import keyword
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path
from string import Template

from sysid_evo.errors import InvalidArgument, RegistrationError
from sysid_evo.files import write_atomically
from sysid_evo.registry.registry import KINDS


@dataclass(frozen=True)
class PluginTemplate:
    """Template of one kind: the command that uses it, the module of its contract (``kit``), further files.

    ``check`` holds further options of `plugin check`; ``files`` maps sources to targets, with ``{name}`` for the name.
    """

    use: str
    kit: str = "sysid_evo.testing"
    check: str = ""
    files: Mapping[str, str] | None = None


TEST = "tests/test_{name}.py"
COMMON = {"pyproject.toml.txt": "pyproject.toml", "README.md.txt": "README.md"}
PLUGINS = {
    "model": PluginTemplate("sysid-evo compare --models $name,parametrised"),
    "task": PluginTemplate("sysid-evo compare --task $name"),
    "controller": PluginTemplate("sysid-evo compare --controller $name"),
    "strategy": PluginTemplate("sysid-evo compare --strategy $name"),
    "adapter": PluginTemplate("sysid-evo names adapter"),
    "robot": PluginTemplate("sysid-evo compare --robot $name", kit="hardware.testing"),
    "reader": PluginTemplate(
        "sysid-evo inspect logs/",
        check=" --data tests/example.jsonl",
        files={"test_reader.py.txt": TEST, "example.jsonl.txt": "tests/example.jsonl"},
    ),
}


def write_plugin(name: str, folder: Path, kind: str = "model") -> list[Path]:
    """Write a plugin package of this ``kind`` called ``name`` into ``folder`` and return its files.

    Raises `InvalidArgument` if ``name`` is not a Python name or a file exists, `RegistrationError` if the name is
    in use.
    """
    if kind not in PLUGINS:
        raise InvalidArgument(f"plugin: expected a kind among {', '.join(PLUGINS)}, got {kind!r}")
    if not name.isidentifier() or keyword.iskeyword(name) or name != name.lower():
        raise InvalidArgument(f"plugin: expected a lower-case Python name such as my_{kind}, got {name!r}")
    template = PLUGINS[kind]
    sources = {f"{kind}.py.txt": "{name}.py", **(template.files or {"test_plugin.py.txt": TEST}), **COMMON}
    targets = {source: folder / target.format(name=name) for source, target in sources.items()}
    existing = [str(path) for path in targets.values() if path.exists()]
    if existing:
        raise InvalidArgument(f"plugin: {', '.join(existing)} would be overwritten; choose another folder with --out")
    _refuse_a_name_in_use(name, kind)
    values = {
        "name": name,
        "title": "".join(part.capitalize() for part in name.split("_")),
        "factory": f"{name}_robot",
        "kebab": name.replace("_", "-"),
        "kind": kind,
        "kit": template.kit,
        "group": KINDS[kind].group,
        "check_options": template.check,
    }
    values["use"] = Template(template.use).substitute(values)
    for source, path in targets.items():
        text = Template(files("sysid_evo.plugin_template").joinpath(source).read_text()).substitute(values)
        write_atomically(path, partial(Path.write_text, data=text))
    return list(targets.values())


def plugin_text(name: str, kind: str) -> str:
    """Return the source file that `write_plugin` writes, for a page that shows it."""
    with tempfile.TemporaryDirectory() as folder:
        path, *_ = write_plugin(name, Path(folder), kind)
        return path.read_text(encoding="utf-8")


def _refuse_a_name_in_use(name: str, kind: str) -> None:
    registry = KINDS[kind]
    if name in registry.names():
        raise RegistrationError(
            f"{kind} {name!r} is already registered by the module {registry.module(name)}: choose another name"
        )
    found = importlib.util.find_spec(name)
    if found is not None and found.origin is not None:
        raise InvalidArgument(
            f"plugin: a module called {name!r} already exists ({found.origin}), and the file {name}.py would conflict "
            "with it: choose another name"
        )
