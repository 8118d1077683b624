"""A page of the documentation: its blocks of code, commands, links and pictures, and the ways to run it."""

from __future__ import annotations

import contextlib
import importlib.util
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import nbformat

from sysid_evo.registry.plugins import PREFIX
from sysid_evo.testing.template import plugin_text
from tests.fixtures.commands import forgetting, run_here

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
IMAGES = DOCS / "images"
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
PLUGIN = re.compile(r"^# the file that `sysid-evo plugin new (\w+) --kind (\w+)` writes\n", re.MULTILINE)
"""A line in place of the file that this command writes, see docs/site/pages.py."""
IMAGE = re.compile(r"!\[[^\]]*\]\(\.\./images/(\w+)-([\w-]+)\.svg\)")
EXAMPLE = re.compile(r"^# the file docs/(examples/\w+\.py)\n", re.MULTILINE)
"""A line in place of this file."""
SHELL = "%%sh -e"
"""The first line of a cell of commands."""
QUICK = {
    "compare": ("--generations", "2", "--trials", "2"),
    "evolve": ("--generations", "2", "--trials", "2"),
    "drive": ("--trials", "1"),
    "exploit": ("--generations", "2", "--trials", "2"),
}
"""Options that make the commands of a page quick; of an option given twice the last one counts."""


@dataclass(frozen=True)
class Block:
    """One block of code: its ``language`` (may be empty), its text, and the line of the page on which that begins."""

    language: str
    text: str
    line: int

    @property
    def file(self) -> str | None:
        """The name of the file that the block is, which its first line says, such as ``# tank.py``."""
        found = re.match(r"# (\w+\.(?:py|toml))\n", self.text)
        return None if found is None else found[1]


@dataclass(frozen=True)
class Printed:
    """A command of a page, and what it printed."""

    line: str
    text: str


class Page:
    """The page ``name``, as the tests and the pictures of the documentation read it."""

    def __init__(self, name: str, path: Path) -> None:
        self.name, self.path = name, path

    def __str__(self) -> str:
        return self.name

    @cached_property
    def text(self) -> str:
        """All of the page, with the plugins that it shows as `sysid-evo plugin new` writes them, and its examples."""
        text = self.path.read_text(encoding="utf-8")
        text = EXAMPLE.sub(lambda found: (DOCS / found[1]).read_text(encoding="utf-8"), text)
        return PLUGIN.sub(lambda found: plugin_text(found[1], found[2]), text)

    @cached_property
    def all_blocks(self) -> list[Block]:
        """The blocks of code, in order."""
        return [Block(m[1], m[2], self.text.count("\n", 0, m.start(2)) + 1) for m in FENCE.finditer(self.text)]

    def blocks(self, language: str) -> list[Block]:
        """Return the blocks in this language, in order."""
        return [block for block in self.all_blocks if block.language == language]

    @property
    def commands(self) -> list[str]:
        """The lines of the blocks in sh, without remarks; lines that end in a backslash are joined."""
        return [line for block in self.blocks("sh") for line in _commands(block.text)]

    @property
    def links(self) -> list[str]:
        """The files of the project that the page links to."""
        return re.findall(r"\]\(([^)#:]+)\)", self.text)

    @property
    def pictures(self) -> list[tuple[str, str]]:
        """Each picture of a run: the name of the run, and which figure of its report it is."""
        return [(found[1], found[2]) for found in IMAGE.finditer(self.text)]

    def program(self, budget: Mapping[str, str] | None = None) -> str:
        """Return all Python of the page as one module, every line where it stands on the page.

        ``budget`` replaces texts by others with as many lines, so that the program takes less time. Raises
        `ValueError` if the page does not have one of the texts.
        """
        lines = [""] * len(self.text.splitlines())
        for block in self.blocks("python"):
            text = block.text.splitlines()
            lines[block.line - 1 : block.line - 1 + len(text)] = text
        whole = "\n".join(lines) + "\n"
        for old, new in (budget or {}).items():
            if old not in whole:
                raise ValueError(f"{self.name}: its budget replaces {old!r}, which no block has")
            whole = whole.replace(old, new)
        # it may stand at the top of a module only
        return re.sub(r"^from __future__ import annotations$", "", whole, flags=re.MULTILINE)

    @contextlib.contextmanager
    def module(self, folder: Path, given: Mapping[str, Any], budget: Mapping[str, str]) -> Iterator[ModuleType]:
        """Run the Python of the page as a module in ``folder``, a file since kernels are read from theirs.

        It has the names ``given``. What it registers is forgotten afterwards.
        """
        name = f"{PREFIX}page_{self.identifier}"
        path = folder / f"{name}.py"
        path.write_text(self.program(budget), encoding="utf-8")
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        module.__dict__.update(given)
        with forgetting(), contextlib.chdir(folder):
            sys.modules[name] = module
            spec.loader.exec_module(module)
            yield module

    @property
    def identifier(self) -> str:
        """The name of the page as a part of the name of a module."""
        return self.name.removesuffix(".md").replace("/", "_").lower()

    def visit(self, folder: Path, options: Mapping[str, tuple[str, ...]]) -> Iterator[Printed]:
        """Do everything on the page in its order in ``folder``: write files, run commands and Python.

        ``options`` are added to the commands of these names. Yields what each command printed.
        """
        names: dict[str, Any] = {"__name__": "__main__"}
        with importable(folder):
            for block in self.all_blocks:
                if block.file is not None:
                    (folder / block.file).write_text(block.text, encoding="utf-8")
                elif block.language == "python":
                    with contextlib.chdir(folder):
                        exec(compile(block.text, self.name, "exec"), names)
                elif block.language == "sh":
                    for line in _commands(block.text):
                        yield from _run(line, folder, options)


def notebook_of(page: Page, options: Mapping[str, tuple[str, ...]]) -> Any:
    """Return the notebook of a page as the site makes it; ``options`` are added to the commands of these names."""
    spec = importlib.util.spec_from_file_location("notebooks", DOCS / "site" / "notebooks.py")
    assert spec is not None
    assert spec.loader is not None
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    made = nbformat.reads(hook.notebook(page.text), nbformat.NO_CONVERT)
    for cell in made.cells:
        if cell.source.startswith(SHELL):
            lines = [" ".join([line, *_more(shlex.split(line), options)]) for line in _commands(cell.source)[1:]]
            cell.source = "\n".join([SHELL, *lines])
    return made


_FOUND = [
    Page(path.relative_to(DOCS).as_posix(), path)
    for path in sorted(DOCS.rglob("*.md"))
    if path.parent != DOCS / "results" / "tables"
]
PAGES = {page.name: page for page in (Page("README.md", ROOT / "README.md"), *_FOUND)}


def picture(run: str, figure: str) -> Path:
    """Return where the picture of a run stands among the pages."""
    return IMAGES / f"{run}-{figure}.svg"


def words_of(svg: Path) -> set[str]:
    """Return what is written in a picture, without numbers: axes, units, models, controllers."""
    written = re.findall(r"<text[^>]*>([^<]+)</text>", svg.read_text(encoding="utf-8"))
    return {text.strip() for text in written if not re.fullmatch(r"[\s\d.,:±−+\-%()e]*", text)}


def _commands(text: str) -> list[str]:
    lines = (re.sub(r"(^|\s)#.*", "", line).strip() for line in text.replace("\\\n", " ").splitlines())
    return [line for line in lines if line]


@contextlib.contextmanager
def importable(folder: Path) -> Iterator[None]:
    """Let Python import files of ``folder``, as a notebook there does, and forget them afterwards."""
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        for name, module in list(sys.modules.items()):
            if Path(getattr(module, "__file__", None) or "/").parent == folder:
                del sys.modules[name]


def _run(line: str, folder: Path, options: Mapping[str, tuple[str, ...]]) -> Iterator[Printed]:
    program, *words = shlex.split(line)
    if program == "python3":
        subprocess.run([program, *words], cwd=folder, check=True)
        return
    assert program == "sysid-evo", line
    done = run_here(*words, *_more([program, *words], options), cwd=folder)
    assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
    yield Printed(line, done.stdout)


def _more(words: list[str], options: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """Return the options to add to a command; none if no controller is evolved there."""
    return () if words[0] != "sysid-evo" or "--stop-after" in words else options.get(words[1], ())
