"""A working plugin package: one file, one entry-point line, one test."""

from __future__ import annotations

import keyword
from functools import partial
from importlib.resources import files
from pathlib import Path
from string import Template

from sysid_evo.errors import InvalidArgument
from sysid_evo.files import write_atomically

TARGETS = {
    "pyproject.toml.txt": "pyproject.toml",
    "model.py.txt": "{name}.py",
    "test_model.py.txt": "tests/test_{name}.py",
    "README.md.txt": "README.md",
}


def write_plugin(name: str, folder: Path) -> list[Path]:
    """Write the package of a new model family ``name`` into ``folder`` and return its files.

    Raises `InvalidArgument` if ``name`` is no Python name or a file stands in the way.
    """
    if not name.isidentifier() or keyword.iskeyword(name) or name != name.lower():
        raise InvalidArgument(f"plugin: expected a lower-case Python name such as my_model, got {name!r}")
    values = {
        "name": name,
        "title": "".join(part.capitalize() for part in name.split("_")),
        "kebab": name.replace("_", "-"),
    }
    targets = {source: folder / target.format(name=name) for source, target in TARGETS.items()}
    standing = [str(path) for path in targets.values() if path.exists()]
    if standing:
        raise InvalidArgument(f"plugin: {', '.join(standing)} would be overwritten; choose another folder with --out")
    for source, path in targets.items():
        text = Template(files(__package__).joinpath(source).read_text()).substitute(values)
        write_atomically(path, partial(_write, text))
    return list(targets.values())


def _write(text: str, path: Path) -> None:
    path.write_text(text)
