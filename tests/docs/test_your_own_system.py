"""The page for a system of one's own works as it stands: files, commands and what they leave, from an empty folder."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import pytest

from sysid_evo.data import Dataset
from tests.docs.blocks import Block, blocks, commands
from tests.fixtures.commands import run_here

PAGE = "your_own_system.md"
SMALL = {
    "compare": ("--generations", "2", "--trials", "2"),
    "evolve": ("--generations", "2", "--trials", "2"),
    "record": ("--minutes", "9"),
}
"""What is added to a command of the page, so that it takes a second; of an option given twice the last one counts."""
WIDTH = 80


def file_of(block: Block) -> str:
    """Return the name of the file that a block is, which its first line says."""
    found = re.match(r"# (\w+\.py)\n", block.text)
    assert found is not None, f"{PAGE}, line {block.line}: expected the name of the file"
    return found[1]


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """The folder after all commands of the page, and what each printed."""
    folder = tmp_path_factory.mktemp("empty")
    for block in blocks(PAGE, "python"):
        (folder / file_of(block)).write_text(block.text)
    printed: dict[str, str] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", str(WIDTH))
        for line in commands(PAGE):
            program, *words = shlex.split(line)
            assert program == "sysid-evo"
            done = run_here(*words, *SMALL.get(words[0], ()), cwd=folder)
            assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
            printed[line] = done.stdout
    return folder, printed


def test_every_command_of_the_page_runs_and_nothing_is_found_wrong(told: tuple[Path, dict[str, str]]) -> None:
    _, printed = told
    checked = [text for line, text in printed.items() if "robots check" in line]
    assert len(checked) == 2
    assert not any(line.startswith("wrong") for text in checked for line in text.splitlines())


def test_what_is_recorded_compared_and_exported_is_there(told: tuple[Path, dict[str, str]]) -> None:
    folder, printed = told
    assert Dataset.read(folder / "data").system.state_names == ("upper", "lower")
    for run in ("first", "turntable"):
        page = (folder / "runs" / run / "report.html").read_text()
        assert "What to use?" in page
    assert any("on tank" in text for line, text in printed.items() if " drive " in line)
    ran = subprocess.run(["python3", "recommended.py"], cwd=folder, capture_output=True, text=True, check=False)
    assert ran.stdout.startswith("ok"), ran.stderr
    assert "(target - lower) / (0.2 m)" in (folder / "recommended.c").read_text()


def test_no_line_that_is_printed_is_wider_than_the_terminal_but_paths_and_commands(
    told: tuple[Path, dict[str, str]],
) -> None:
    _, printed = told
    for line, text in printed.items():
        wide = [row for row in text.splitlines() if len(row.rstrip()) > WIDTH]
        assert not [row for row in wide if not re.search(r"\S/\S|use:|check:", row)], line
