"""Every tutorial works as it stands: files, commands and Python, from an empty folder, in the order of the page."""

from __future__ import annotations

import os
import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from tests.docs.blocks import FENCE, PAGES
from tests.sysid_evo.cli.calling import run_here

TUTORIALS = [page for page in PAGES if page.startswith("tutorials/")]
SMALL = {
    "compare": ("--generations", "2", "--trials", "2"),
    "evolve": ("--generations", "2", "--trials", "2"),
    "drive": ("--trials", "1"),
    "exploit": ("--generations", "2", "--trials", "2"),
}
"""What is added to a command, so that it takes seconds; of an option given twice the last one counts."""
WIDTH = 80


@pytest.mark.parametrize("page", TUTORIALS)
def test_a_tutorial_runs_from_an_empty_folder(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    names: dict[str, Any] = {"__name__": "__main__"}
    for found in FENCE.finditer(PAGES[page].read_text()):
        language, text = found[1], found[2]
        file = re.match(r"# (\w+\.(?:py|toml))\n", text)
        if file is not None:
            Path(file[1]).write_text(text)
        elif language == "python":
            exec(compile(text, page, "exec"), names)
        elif language == "sh":
            run_commands(text, tmp_path)


def run_commands(text: str, folder: Path) -> None:
    """Run the lines of a block, small; no line that is printed is wider than the terminal, but paths and commands."""
    for line in text.replace("\\\n", " ").splitlines():
        program, *words = shlex.split(line, comments=True)
        if program == "python3":
            exec(compile((folder / words[0]).read_text(), words[0], "exec"), {"__name__": "__main__"})
            continue
        assert program == "sysid-evo", line
        done = run_here(*words, *SMALL.get(words[0], ()), cwd=folder)
        assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
        wide = [row for row in done.stdout.splitlines() if len(row.rstrip()) > WIDTH]
        assert not [row for row in wide if not re.search(rf"\S{os.sep}\S|use:|check:", row)], line
