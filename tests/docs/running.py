"""A page as one program: its files, commands and Python, in the order of the page, in one folder."""

from __future__ import annotations

import contextlib
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.docs.blocks import FENCE, PAGES
from tests.fixtures.commands import run_here

SMALL = {
    "compare": ("--generations", "2", "--trials", "2"),
    "evolve": ("--generations", "2", "--trials", "2"),
    "drive": ("--trials", "1"),
    "exploit": ("--generations", "2", "--trials", "2"),
}
"""What is added to a command, so that it takes seconds; of an option given twice the last one counts."""
IMAGE = re.compile(r"!\[[^\]]*\]\(\.\./images/(\w+)-([\w-]+)\.svg\)")


@dataclass(frozen=True)
class Said:
    """A command of a page, and what it printed."""

    line: str
    printed: str


def run_page(page: str, folder: Path, further: Mapping[str, tuple[str, ...]]) -> Iterator[Said]:
    """Run a page in ``folder``, its commands with the ``further`` options; yield what they print, one by one."""
    names: dict[str, Any] = {"__name__": "__main__"}
    for found in FENCE.finditer(PAGES[page].read_text()):
        language, text = found[1], found[2]
        file = re.match(r"# (\w+\.(?:py|toml))\n", text)
        if file is not None:
            (folder / file[1]).write_text(text)
        elif language == "python":
            sys.path.insert(0, str(folder))  # as a notebook does
            try:
                with contextlib.chdir(folder):
                    exec(compile(text, page, "exec"), names)
            finally:
                sys.path.remove(str(folder))
        elif language == "sh":
            for line in text.replace("\\\n", " ").splitlines():
                yield from _run(line, folder, further)


def _run(line: str, folder: Path, further: Mapping[str, tuple[str, ...]]) -> Iterator[Said]:
    program, *words = shlex.split(line, comments=True)
    if program == "python3":
        subprocess.run([program, *words], cwd=folder, check=True)
        return
    assert program == "sysid-evo", line
    more = () if "--only" in words else further.get(words[0], ())  # no controller is evolved there
    done = run_here(*words, *more, cwd=folder)
    assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
    yield Said(line, done.stdout)


def shown_on(page: str) -> list[tuple[str, str]]:
    """Return the pictures of a page: the run that each is of, and which figure of its report it is."""
    return [(found[1], found[2]) for found in IMAGE.finditer(PAGES[page].read_text())]


def picture(run: str, figure: str) -> Path:
    """Return where a picture stands among the pages."""
    return PAGES["index.md"].parent / "images" / f"{run}-{figure}.svg"


def words_of(svg: Path) -> set[str]:
    """Return what is written in a picture, without numbers: axes, units, models, controllers."""
    written = re.findall(r"<text[^>]*>([^<]+)</text>", svg.read_text(encoding="utf-8"))
    return {text.strip() for text in written if not re.fullmatch(r"[\s\d.,:±−+\-%()e]*", text)}
