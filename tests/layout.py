"""Structure of the four packages: ``python -m tests.layout [--list]`` prints the measures that tests limit.

All imports are counted: at the top, in functions, and for type checking.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from statistics import median

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("sysid_evo", "model_zoo", "evaluation", "hardware")
COMPILERS = ("numba", "llvmlite")


@cache
def trees() -> dict[str, ast.Module]:
    """Return the syntax tree of every module of the four packages, by its dotted name."""
    files = [file for package in PACKAGES for file in sorted((ROOT / package).rglob("*.py"))]
    return {name_of(file): ast.parse(file.read_text("utf-8")) for file in files}


@cache
def import_statements(module: str) -> list[tuple[ast.Import | ast.ImportFrom, bool]]:
    """Return every import in ``module`` and whether it is in a function; expressions are not searched."""
    found, rest = [], [(statement, False) for statement in trees()[module].body]
    while rest:
        node, inside = rest.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            found.append((node, inside))
        inside = inside or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        for part in ("body", "orelse", "finalbody", "handlers", "cases"):
            rest += [(statement, inside) for statement in getattr(node, part, ())]
    return found


def names_in(node: ast.Import | ast.ImportFrom) -> list[str]:
    """Return the modules that an import names; a relative import is returned as written."""
    return [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]


def name_of(file: Path) -> str:
    """Return the name by which ``file`` is imported."""
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def contents() -> list[Path]:
    """Return the files of modules with content, those that are no list of a package."""
    return [file for package in PACKAGES for file in (ROOT / package).rglob("*.py") if file.name != "__init__.py"]


def lists() -> list[Path]:
    """Return the ``__init__`` files."""
    return [file for package in PACKAGES for file in (ROOT / package).rglob("__init__.py")]


def lines_of(file: Path) -> int:
    """Return the number of physical lines of a file."""
    return len(file.read_text("utf-8").splitlines())


def imports(module: str) -> Iterator[tuple[str, bool]]:
    """Yield each module of the four packages that ``module`` imports, and whether the import is at its top."""
    top = {id(node) for node in trees()[module].body}
    for node, _ in import_statements(module):
        names = names_in(node)
        if isinstance(node, ast.ImportFrom):
            if node.level:
                continue
            submodules = [name for alias in node.names if (name := f"{node.module}.{alias.name}") in trees()]
            names = submodules if len(submodules) == len(node.names) else [*names, *submodules]
        for name in names:
            if name.split(".")[0] in PACKAGES:
                yield name, id(node) in top


def late_imports() -> list[str]:
    """Return ``module -> imported`` for every import of a module of ours that is not at the top of a module."""
    return sorted(f"{module} -> {name}" for module in trees() for name, at_top in imports(module) if not at_top)


def cycles() -> list[list[str]]:
    """Return the groups of modules that import each other in a round."""
    names = sorted(trees())
    place = {name: i for i, name in enumerate(names)}
    pairs = np.array([(place[a], place[b]) for a in names for b, _ in imports(a) if b in place and b != a])
    graph = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(len(names), len(names)))
    groups = defaultdict(list)
    for name, group in zip(names, connected_components(graph, connection="strong")[1], strict=True):
        groups[int(group)].append(name)
    return [group for group in groups.values() if len(group) > 1]


def repeated_classes() -> dict[str, list[str]]:
    """Return the modules of every class name (also private) that more than one module defines."""
    where = defaultdict(list)
    for module, tree in trees().items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef):
                where[node.name].append(module)
    return {name: modules for name, modules in sorted(where.items()) if len(modules) > 1}


def importers_of(*packages: str) -> list[str]:
    """Return the modules that import one of these third-party packages, anywhere in them."""
    return sorted(
        module
        for module in trees()
        if any(name.split(".")[0] in packages for node, _ in import_statements(module) for name in names_in(node))
    )


def imports_in_functions() -> list[tuple[str, str]]:
    """Return module and package of each third-party import within a function."""
    found = {
        (module, name.split(".")[0])
        for module in trees()
        for node, in_function in import_statements(module)
        if in_function
        for name in names_in(node)
    }
    return sorted((module, package) for module, package in found if package not in PACKAGES)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--list", action="store_true", help="also print the modules behind the counts")
    listed = parser.parse_args().list
    sizes = sorted(lines_of(file) for file in contents())
    rows: list[tuple[str, object, list[str]]] = [
        ("modules with content", len(sizes), []),
        ("__init__ files", len(lists()), []),
        ("lines", sum(sizes) + sum(lines_of(file) for file in lists()), []),
        ("median module, lines", int(median(sizes)), []),
        (
            "modules above 600 lines",
            sum(size > 600 for size in sizes),
            [str(f) for f in contents() if lines_of(f) > 600],
        ),
        ("import cycles", len(cycles()), [", ".join(group) for group in cycles()]),
        ("modules in import cycles", sum(map(len, cycles())), []),
        ("imports of ours that are not at the top", len(late_imports()), late_imports()),
        ("class names defined twice", len(repeated_classes()), [f"{n}: {m}" for n, m in repeated_classes().items()]),
        ("modules that import the compiler", len(importers_of(*COMPILERS)), importers_of(*COMPILERS)),
    ]
    for title, count, modules in rows:
        sys.stdout.write(f"{count:>7}  {title}\n")
        if listed:
            sys.stdout.write("".join(f"           {module}\n" for module in modules))


if __name__ == "__main__":
    main()
