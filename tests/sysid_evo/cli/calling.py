"""How tests call the command line: as a process of its own, or in this one where a process is not what is tested."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from sysid_evo.cli.app import main
from sysid_evo.cli.console import err, session

COMMAND = (sys.executable, "-c", "from sysid_evo.cli import main; main()")


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit code, standard output, standard error, each without its line breaks."""

    code: int
    stdout: str
    stderr: str

    def says(self, text: str) -> bool:
        """Whether ``text`` stands on standard error, however its lines are broken."""
        return "".join(text.split()) in "".join(self.stderr.split())


def run(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run ``sysid-evo`` in a process of its own."""
    environment = {**os.environ, "COLUMNS": "80", "TERM": "dumb"}
    command = [*COMMAND, *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=240, check=False)


class Caller:
    """Calls ``sysid-evo`` in this process and in this folder."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder, self._patch, self._captured = folder, monkeypatch, capsys

    def __call__(self, *arguments: str | Path) -> Ended:
        self._captured.readouterr()
        code = 0
        with self._patch.context() as patch:
            patch.setattr(sys, "argv", ["sysid-evo", *map(str, arguments)])
            patch.setattr(session, "run", None)
            patch.setattr(session, "debug", False)
            patch.setattr(err, "quiet", False)
            patch.setattr("warnings.showwarning", lambda *_, **__: None)
            patch.chdir(self.folder)
            try:
                main()
            except SystemExit as ended:
                code = ended.code if isinstance(ended.code, int) else 0
        captured = self._captured.readouterr()
        return Ended(code, captured.out, captured.err)
