"""`python -m tests.mutate MODULE ...`: change lines of the product chosen by chance, and see whether a test notices.

A change exchanges an operator or a name, changes a number, or makes a guard false. The tests that are run import the
module, directly or through others, nearest first, in a copy of the tree of the current folder. Changes that no test
notices are printed with the line before and after. Ends with 0 if enough are noticed.
"""

from __future__ import annotations

import argparse
import ast
import json
import math
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import tomllib
import traceback
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

NIGHTLY_LINES, NIGHTLY = 60, (
    "evaluation/prediction", "evaluation/study", "evaluation/transfer", "hardware/link",
    "sysid_evo/evolution/strategies", "sysid_evo/models/adaptation", "sysid_evo/plan", "sysid_evo/validation",
)  # fmt: skip
"""Lines that are changed in a night, of all these folders together: verdicts, statistics, refusals and protocols."""
NEVER = {"benchmarks", "docs", "packaging", "rig", "mutation"}
"""Folders of tests that are not run here; those of ``tests/system`` only where no other test imports a module."""
MOST_STEPS, MOST_TESTS, MOST_SECONDS = 3, 25, 120.0
"""Imports from a test to the module, modules of tests for it, and what these may take together without a change."""
COMMANDS = tuple(
    f"tests/system/test_{name}.py" for name in ("commands", "controller_commands", "outcomes", "robot_commands")
)
"""Modules of tests that run the commands in this process."""
RUNS = ((0, 3), (3, 10), (10, MOST_TESTS + len(COMMANDS)))
"""Which of them are run together: most changes are noticed by the nearest few."""
MEMORY = 8 << 30  # bytes of a run: a size that was changed must not fill the machine
COMPILED = re.compile(r"kernel|compiled|motion", re.IGNORECASE)
"""In the path or the text of a module whose changes must not meet machine code from before."""
IGNORED = (".git", ".venv", "runs", "build", "dist", "site", ".*_cache", ".hypothesis")
OPTIONS = ("--tb=no", "-pno:cacheprovider", "-n0", "-Wignore::pytest.PytestAssertRewriteWarning")
WARM = (
    "pytest", "numpy", "scipy.optimize", "scipy.signal", "scipy.stats", "pandas", "sklearn.neighbors", "matplotlib",
    "hypothesis", "pydantic", "typer", "jinja2", "rich.console",
)  # fmt: skip
"""Packages that are imported once, before the runs branch off."""

COMPARISONS = {
    ast.Lt: (">=", "<="), ast.LtE: (">", "<"), ast.Gt: ("<=", ">="), ast.GtE: ("<", ">"), ast.Eq: ("!=",),
    ast.NotEq: ("==",), ast.In: ("not in",), ast.NotIn: ("in",), ast.Is: ("is not",), ast.IsNot: ("is",),
}  # fmt: skip
"""What a comparison becomes: turned, and for the four orders made lax or strict."""
COMPARED = r"\bnot\s+in\b|\bis\s+not\b|\bin\b|\bis\b|[<>=!]=|[<>]"
ARITHMETIC = {ast.Add: (r"\+", "-"), ast.Sub: ("-", "+"), ast.Mult: (r"\*", "/"), ast.Div: ("/", "*")}
_PAIRS = (("min", "max"), ("minimum", "maximum"), ("argmin", "argmax"), ("nanmin", "nanmax"), ("any", "all"))
EXCHANGED = {a: b for pair in _PAIRS for a, b in (pair, pair[::-1])}


@dataclass(frozen=True)
class Change:
    """Bytes ``start`` to ``end`` of ``file``, in ``line``, become ``text``; no line is added or removed."""

    file: str
    line: int
    start: int
    end: int
    text: str

    def of(self, source: bytes) -> bytes:
        """Return the changed source."""
        return source[: self.start] + self.text.encode() + source[self.end :]

    def shown(self, source: bytes) -> str:
        """Return where it is, and the line before and after."""
        before, after = (text.split(b"\n")[self.line - 1].decode().strip() for text in (source, self.of(source)))
        return f"{self.file}:{self.line}\n  - {before}\n  + {after}\n"


class Places:
    """Finds the changes of a module, except in texts and type annotations."""

    def __init__(self, source: bytes) -> None:
        self.source = source
        self.starts = [0, *(found.end() for found in re.finditer(b"\n", source))]

    def below(self, node: ast.AST) -> Iterator[tuple[int, int, str]]:
        """Yield start, end and new text of every change of ``node`` and all that is in it."""
        yield from self._of(node)
        for name, value in ast.iter_fields(node):
            if name not in ("annotation", "returns", "decorator_list"):
                for child in value if isinstance(value, list) else [value]:
                    if isinstance(child, ast.AST) and not _unseen(child):
                        yield from self.below(child)

    def _of(self, node: ast.AST) -> Iterator[tuple[int, int, str]]:
        match node:
            case ast.Compare():
                for left, kind, right in zip([node.left, *node.comparators], node.ops, node.comparators, strict=False):
                    turned, *shifted = COMPARISONS[type(kind)]
                    yield from self._between(left, right, COMPARED, turned)
                    if _whole(left) or _whole(right):
                        yield from self._between(left, right, COMPARED, *shifted)
            case ast.BinOp(left=left, right=right) | ast.AugAssign(target=left, value=right):
                if type(node.op) in ARITHMETIC and not _text(left) and not _text(right):
                    yield from self._between(left, right, *ARITHMETIC[type(node.op)])
            case ast.BoolOp(op=kind, values=values):
                for left, right in pairwise(values):
                    yield from self._between(left, right, r"\b(and|or)\b", "or" if isinstance(kind, ast.And) else "and")
            case ast.UnaryOp(op=ast.Not()):
                start, _ = self._span(node)
                yield start, start + len("not"), ""
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name) as called) if name in EXCHANGED:
                _, end = self._span(called)
                yield end - len(name), end, EXCHANGED[name]
            case ast.Constant(value=value):
                yield from ((*self._span(node), repr(other)) for other in _other(value))
            case ast.If(test=test, body=[*_, ast.Raise() | ast.Return() | ast.Continue()]):
                if not any(isinstance(inner, ast.NamedExpr) for inner in ast.walk(test)):
                    start, end = self._span(test)
                    yield start, end, f"False and ({self.source[start:end].decode()})"

    def _span(self, node: Any) -> tuple[int, int]:
        first, last = self.starts[node.lineno - 1], self.starts[node.end_lineno - 1]
        return first + node.col_offset, last + node.end_col_offset

    def _between(self, left: ast.expr, right: ast.expr, pattern: str, *texts: str) -> Iterator[tuple[int, int, str]]:
        """Yield changes of the operator between two expressions; a comment there might hold one, too."""
        start, end = self._span(left)[1], self._span(right)[0]
        found = re.search(pattern.encode(), gap := self.source[start:end])
        if found and b"#" not in gap:
            yield from ((start + found.start(), start + found.end(), text) for text in texts)


def _unseen(node: ast.AST) -> bool:
    """Whether a part holds no behaviour: messages, types, lists of names. Positions in f-strings are wrong in 3.11."""
    match node:
        case ast.JoinedStr() | ast.Raise() | ast.Assert():
            return True
        case ast.If(test=ast.Name("TYPE_CHECKING") | ast.Compare(left=ast.Name("__name__"))):
            return True
        case ast.Assign([ast.Name("__all__")]) | ast.AnnAssign(annotation=ast.Name("TypeAlias")):
            return True
        case ast.keyword("strict" | "repr" | "compare" | "maxsize") | ast.Subscript(ast.Name("Literal")):
            return True
    return False


def _whole(node: ast.expr) -> bool:
    """Whether a side of a comparison is evidently a whole number; other numbers are equal by chance only."""
    match node:
        case ast.Constant(int() | float() as value):
            return value == int(value)
        case (
            ast.Call(ast.Name("len")) | ast.Attribute(attr="ndim" | "size") | ast.Subscript(ast.Attribute(attr="shape"))
        ):
            return True
    return False


def _text(node: ast.AST) -> bool:
    """Whether an operand is a text or a list: other operators only end in a `TypeError`."""
    return isinstance(node, ast.JoinedStr | ast.List | ast.ListComp) or isinstance(getattr(node, "value", 0), str)


def _other(value: object) -> list[object]:
    """Return the changed values of a number or truth value: one more, one less, doubled, halved, if different."""
    match value:
        case bool():
            return [not value]
        case int():
            return [value + 1] + [value - 1] * (value > 0) + [2 * value] * (value > 2)
        case float():
            tiny, large = 0.0 <= value < 1e-5, value >= 1e5
            return [value + 1.0] * (tiny or 1.0 <= value < 1e5) + [2.0 * value] * (not tiny) + [0.5 * value] * large
    return []


def places(file: str, source: bytes) -> list[Change]:
    """Return every change of a module, in the order of its lines."""
    found = sorted(Places(source).below(ast.parse(source)))
    return [Change(file, source.count(b"\n", 0, start) + 1, start, end, text) for start, end, text in found]


def drawn(changes: Iterable[Change], lines: int, seed: str) -> list[Change]:
    """Return one change on each of ``lines`` lines, chosen by the seed, in the order of the lines."""
    by_line = defaultdict[tuple[str, int], list[Change]](list)
    for change in changes:
        by_line[change.file, change.line].append(change)
    rng = random.Random(seed)
    return [rng.choice(by_line[line]) for line in sorted(rng.sample(sorted(by_line), min(lines, len(by_line))))]


class Imports:
    """The imports in the source tree ``root``, and from them the tests that are near to a module."""

    def __init__(self, root: Path) -> None:
        packages = [file.parent for file in root.glob("*/__init__.py")] + [root / "tests"]
        files = [file.relative_to(root) for package in packages for file in package.rglob("*.py")]
        self.files = {_dotted(file): file for file in files if not NEVER & set(file.parts)}
        self.trees = {name: self._tree(root / file) for name, file in self.files.items()}
        project = root / "pyproject.toml"
        table = tomllib.loads(project.read_text()).get("project", {}) if project.is_file() else {}
        self.plugins = defaultdict[str, set[str]](set)
        for group in table.get("entry-points", {}).values():
            for name, place in group.items():
                self.plugins[name].add(place.partition(":")[0])
        self.pairs = {name: list(self._pairs(name, tree)) for name, tree in self.trees.items()}
        self.imported = {name: self._imported(name) for name in self.files}

    @staticmethod
    def _tree(file: Path) -> ast.Module:
        stub = file.with_suffix(".pyi")  # lists the names of a package that loads lazily
        tree = ast.parse((stub if stub.is_file() else file).read_bytes())
        tree.body = [node for node in tree.body if not (isinstance(node, ast.If) and _unseen(node))]
        return tree

    def _pairs(self, module: str, part: ast.AST) -> Iterator[tuple[str, str]]:
        """Yield the module and the name of everything that a part of a module imports."""
        for node in ast.walk(part):
            if isinstance(node, ast.Import):
                yield from ((alias.name, "") for alias in node.names)
            elif isinstance(node, ast.ImportFrom):  # only lists of packages use dots
                base = f"{module}.{node.module}" if node.level else str(node.module)
                yield from ((base, alias.name) for alias in node.names)

    def _origin(self, module: str, name: str) -> str:
        """Return the module that defines ``name``: ``module`` may only pass it on."""
        if f"{module}.{name}" in self.files:
            return f"{module}.{name}"
        if name and module in self.files and self.files[module].stem == "__init__":
            return next((self._origin(*pair) for pair in self.pairs[module] if pair[1] == name), module)
        return module

    def _imported(self, module: str) -> set[str]:
        """Return the imports of a module, the modules named in its texts, and the imports of its fixtures."""
        file, nodes = self.files[module], list(ast.walk(self.trees[module]))
        found = {self._origin(*pair) for pair in self.pairs[module]}
        texts = {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
        places = {text.partition(":")[0] for text in texts if re.fullmatch(r"[\w.]+(:\w+)?", text)}
        found |= places | {f"{module.rpartition('.')[0]}.{place}" for place in places}
        if not file.name.startswith("test_"):
            return found
        asked = {node.arg for node in nodes if isinstance(node, ast.arg)}
        for conftest in (_dotted(folder / "conftest.py") for folder in file.parents):
            body = self.trees[conftest].body if conftest in self.trees else []
            fixtures = {node.name: node for node in body if isinstance(node, ast.FunctionDef)}
            while reached := asked & fixtures.keys():
                for fixture in map(fixtures.pop, reached):
                    asked |= {node.arg for node in ast.walk(fixture) if isinstance(node, ast.arg)}
                    found |= {self._origin(*pair) for pair in self._pairs(conftest, fixture)}
                    used = {node.id for node in ast.walk(fixture) if isinstance(node, ast.Name)}
                    found |= {self._origin(*pair) for pair in self.pairs[conftest] if pair[1] in used}
        return found | {"plugin " + re.split(r"\W", text)[0] for text in texts}

    def tests_of(self, file: str) -> list[str]:
        """Return the modules of tests that import the module ``file``, those first that import it most directly.

        Last come those that run the commands, which import as they run.
        """
        steps, front = dict[str, int](), {_dotted(Path(file))}
        imported = self.imported | {f"plugin {name}": modules for name, modules in self.plugins.items()}
        while front:
            steps |= dict.fromkeys(front, len(set(steps.values())))
            front = {name for name, others in imported.items() if others & front and name not in steps}
        words, own = set(re.split(r"\W|_", file)), f"test_{Path(file).stem}"
        tests = [name for name in steps if name in self.files and self.files[name].name.startswith("test_")]

        def rank(name: str) -> tuple[int, bool, int, int]:
            likeness = len(words & set(re.split(r"\W|_", name)))
            return steps[name], not name.endswith(own), -likeness, len(self.pairs[name])

        near = [name for name in tests if steps[name] <= MOST_STEPS] or tests
        ranked = [self.files[name].as_posix() for name in sorted(sorted(near), key=rank)]
        ranked = [test for test in ranked if not test.startswith("tests/system/")] or ranked
        known = {path.as_posix() for path in self.files.values()}
        return ranked[:MOST_TESTS] + [test for test in COMMANDS if test in known and test not in ranked]


def _dotted(file: Path) -> str:
    return ".".join(file.parts[:-1] if file.stem == "__init__" else file.with_suffix("").parts)


class Watch:
    """A plugin of pytest: the tests that failed and the seconds of each module that ends within its share.

    ``budget`` is for all modules together; one takes at most a quarter of it, and the rest of its tests is left out.
    The ``tests`` are run in their order, not in that of the folders.
    """

    def __init__(self, budget: float, tests: Sequence[str]) -> None:
        self.budget, self.failed = budget, list[str]()
        self.order = {test: place for place, test in enumerate(tests)}
        self.spent, self.cut = defaultdict[str, float](float), set[str]()

    def pytest_collection_finish(self, session: Any) -> None:
        session.items.sort(key=lambda item: self.order.get(item.nodeid.partition("::")[0], -1))

    def pytest_runtest_setup(self, item: Any) -> None:
        module = item.nodeid.partition("::")[0]
        if self.spent[module] > self.budget / 4 or sum(self.spent.values()) > self.budget:
            self.cut.add(module)
            import_module("pytest").skip("enough")

    def pytest_collectreport(self, report: Any) -> None:
        self.failed += [report.nodeid] * report.failed

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.failed += [report.nodeid] * report.failed
        self.spent[report.nodeid.partition("::")[0]] += report.duration

    @property
    def seconds(self) -> dict[str, float]:
        return {module: seconds for module, seconds in self.spent.items() if module not in self.cut}


class Tree:
    """A copy of the tree ``root`` in ``folder``, in which tests run in processes that branch off from this one."""

    def __init__(self, root: Path, folder: Path, deselected: Sequence[str] = ()) -> None:
        self.folder, self.deselected = folder, list(deselected)
        shutil.copytree(root, folder, ignore=shutil.ignore_patterns(*IGNORED))

    def cache_for(self, module: str) -> str:
        """Return the folder of machine code; empty for a module that must not use compiled code of its original."""
        text = (self.folder / module).read_text(encoding="utf-8")
        kept = os.environ.get("SYSID_EVO_CACHE", str(self.folder.with_name("cache")))
        return "" if COMPILED.search(module + text) else kept

    def run(self, tests: Sequence[str], *options: str, limit: float, cache: str, budget: float = math.inf) -> Any:
        """Return pytest's code, what failed and the seconds of each module; None after a crash or ``limit`` seconds."""
        answer = self.folder.with_suffix(".json")
        answer.unlink(missing_ok=True)
        process = os.fork()
        if process == 0:
            try:
                os.setsid()
                signal.alarm(math.ceil(limit))
                resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
                self._enter(cache)
                watch = Watch(budget, tests)
                options += (f"--basetemp={self.folder.with_suffix('.tmp')}",)
                options += tuple(f"--deselect={test}" for test in self.deselected)
                code = import_module("pytest").main([*OPTIONS, *options, *tests], plugins=[watch])
                answer.write_text(json.dumps([code, watch.failed, watch.seconds]))
            except Exception:
                traceback.print_exc()
            finally:
                os._exit(0)
        os.waitpid(process, 0)
        with suppress(ProcessLookupError):
            os.killpg(process, signal.SIGKILL)  # what its tests have started
        return json.loads(answer.read_text()) if answer.is_file() else None

    def _enter(self, cache: str) -> None:
        """Let this process, and those it starts, import from the copy and write next to it."""
        os.dup2(os.open(self.folder.with_suffix(".txt"), os.O_CREAT | os.O_TRUNC | os.O_RDWR), 1)
        os.dup2(1, 2)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        here = Path.cwd()
        os.chdir(self.folder)
        sys.path[:] = [str(self.folder), *(path for path in sys.path if Path(here, path) != here)]
        os.environ |= {"PYTHONPATH": str(self.folder), "SYSID_EVO_CACHE": cache}
        if not cache:
            del os.environ["SYSID_EVO_CACHE"]
        for name in [name for name in sys.modules if name.split(".")[0] == "tests"]:
            del sys.modules[name]

    def noticed(self, change: Change, tests: Mapping[str, float]) -> str:
        """Return the first test that fails with a change, or why none ended; empty if all pass."""
        path, cache, near = self.folder / change.file, self.cache_for(change.file), list(tests)
        limit = 30.0 + 4.0 * sum(tests.values())
        source, stat = path.read_bytes(), path.stat()
        path.write_bytes(change.of(source))
        os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns + 10**9))  # or what is compiled of it would be taken
        sys.dont_write_bytecode, os.environ["PYTHONDONTWRITEBYTECODE"] = True, "1"
        try:
            for start, end in RUNS:
                if near[start:end]:
                    ran = self.run(near[start:end], "-x", limit=limit, cache=cache)
                    if ran is None:
                        return f"crash, or {limit:.0f} s"
                    if ran[0]:
                        return ran[1][0] if ran[1] else f"pytest ends with {ran[0]}"
            return ""
        finally:  # as old as before, so that what is compiled of it holds
            path.write_bytes(source)
            os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


def chosen_tests(tree: Tree, wanted: Mapping[str, Sequence[str]]) -> dict[str, dict[str, float]]:
    """Return the tests for each module and their seconds, without tests that fail on the unchanged product."""
    known: dict[tuple[str, str], float] = {}
    found = {}
    for module, tests in wanted.items():
        cache, left, found[module] = tree.cache_for(module), MOST_SECONDS, dict[str, float]()
        if new := [test for test in tests if (cache, test) not in known]:
            further = "--continue-on-collection-errors"
            ran = tree.run(new, further, limit=10 * MOST_SECONDS, cache=cache, budget=MOST_SECONDS)
            if ran is None or ran[0] > 2:
                said = tree.folder.with_suffix(".txt").read_text()
                raise RuntimeError(f"pytest cannot run the tests of {module} as it is:\n{said[-3000:]}")
            tree.deselected += ran[1]
            known |= {(cache, test): seconds for test, seconds in ran[2].items()}
        for test in tests:
            if (seconds := known.get((cache, test), math.inf)) <= left:
                found[module][test], left = seconds, left - seconds
    return found


def tried(tree: Tree, changes: Sequence[Change], tests: Mapping[str, Mapping[str, float]], jobs: int) -> Iterator[Any]:
    """Yield number, what noticed it and seconds of each change, as they come from ``jobs`` processes."""
    reader, writer = os.pipe()
    for job in range(jobs):
        if os.fork() == 0:
            try:
                mine = Tree(tree.folder, tree.folder.with_name(f"tree{job}"), tree.deselected)
                for number in range(job, len(changes), jobs):
                    began = time.perf_counter()
                    by = mine.noticed(changes[number], tests[changes[number].file])
                    os.write(writer, json.dumps([number, by, time.perf_counter() - began]).encode() + b"\n")
            finally:
                os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as lines:
        yield from map(json.loads, lines)


def try_all(root: Path, changes: Sequence[Change], jobs: int) -> list[str]:
    """Return, for each change, the test that detected it, else ""; progress is written to stderr."""
    os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    os.environ.setdefault("SYSID_EVO_DATA", str(root.parent / "shared" / "data"))
    for package in WARM:
        with suppress(ImportError):
            import_module(package)
    imports, say, by = Imports(root), sys.stderr.write, [""] * len(changes)
    with tempfile.TemporaryDirectory(prefix="sysid-evo-mutate-") as folder:
        Path(folder).chmod(0o755)  # some tests give up their rights, and come back to this folder
        tree = Tree(root, Path(folder, "tree"))
        tests = chosen_tests(tree, {change.file: imports.tests_of(change.file) for change in changes})
        for module, near in tests.items():
            say(f"{module}: {len(near)} modules of tests, {sum(near.values()):.0f} s\n")
        say("".join(f"fails without a change: {test}\n" for test in tree.deselected))
        for count, (number, by[number], seconds) in enumerate(tried(tree, changes, tests, jobs), 1):
            where = f"{changes[number].file}:{changes[number].line}"
            say(f"{count} of {len(changes)}: {where} {by[number] or 'SURVIVED'} ({seconds:.1f} s)\n")
    return by


def product(root: Path, named: Iterable[str]) -> list[str]:
    """Return the modules with content at these files and folders; "." means all."""
    packages = {file.parent.name for file in root.glob("*/__init__.py")} - {"tests"}
    files = {file.relative_to(root) for name in named for file in [root / name, *(root / name).rglob("*.py")]}
    files = {file for file in files if file.suffix == ".py" and file.stem != "__init__" and file.parts[0] in packages}
    return sorted(map(str, files))


def main(arguments: Sequence[str] | None = None) -> int:
    """Try changes of the modules that the arguments name, print those that survive, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutate", description=__doc__)
    parser.add_argument("modules", nargs="*", metavar="MODULE", help="files or folders of the product")
    parser.add_argument("--lines", type=int, default=20, help="lines of each module; one change on each (%(default)s)")
    parser.add_argument("--seed", default="0", help="chooses lines and changes (%(default)s)")
    parser.add_argument("--random", type=int, metavar="N", help="N modules of the product, chosen by the seed")
    parser.add_argument("--nightly", action="store_true", help=f"{NIGHTLY_LINES} lines, by the date; never fails")
    parser.add_argument("--enough", type=float, default=0.9, help="share that tests must notice (%(default)s)")
    parser.add_argument("--jobs", type=int, default=2, help="processes side by side (%(default)s)")
    parser.add_argument("--list", action="store_true", help="print the changes and try none")
    asked = parser.parse_args(arguments)
    root, seed = Path.cwd(), f"{datetime.now(UTC):%Y-%m-%d}" if asked.nightly else asked.seed
    files = product(root, NIGHTLY if asked.nightly else ["."] if asked.random else asked.modules)
    sources = {file: (root / file).read_bytes() for file in files}
    found = {file: changes for file, source in sources.items() if (changes := places(file, source))}
    if not found:
        parser.error("name modules or folders of the product in this folder, or ask for --random N or --nightly")
    if asked.nightly:
        sample = drawn((change for changes in found.values() for change in changes), NIGHTLY_LINES, seed)
    else:
        few = sorted(random.Random(seed).sample(sorted(found), min(asked.random or len(found), len(found))))
        sample = [change for file in few for change in drawn(found[file], asked.lines, f"{seed} {file}")]
    by = [""] * len(sample) if asked.list else try_all(root, sample, asked.jobs)
    survivors = [change for change, test in zip(sample, by, strict=True) if not test]
    sys.stdout.write("".join(change.shown(sources[change.file]) for change in survivors))
    if asked.list:
        return 0
    share = 1.0 - len(survivors) / len(sample)
    sys.stdout.write(f"{len(sample) - len(survivors)} of {len(sample)} changes noticed, {share:.0%}; seed {seed}\n")
    return 0 if asked.nightly or share >= asked.enough else 1


if __name__ == "__main__":
    sys.exit(main())
