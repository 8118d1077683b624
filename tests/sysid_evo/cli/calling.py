"""How tests call the command line: as a process of its own, or in this one where a process is not what is tested."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pytest

from sysid_evo.__main__ import main
from sysid_evo.cli.console import err, session
from sysid_evo.registry import KINDS
from sysid_evo.registry.plugins import PREFIX

COMMAND = (sys.executable, "-c", "from sysid_evo.__main__ import main; main()")


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


@contextmanager
def forgetting() -> Iterator[None]:
    """Forget afterwards what a ``--plugin`` has registered meanwhile; a process of its own would, too."""
    modules, before = set(sys.modules), {kind: set(registry.loaded) for kind, registry in KINDS.items()}
    yield
    brought = {name for name in set(sys.modules) - modules if name.startswith(PREFIX)}
    for name in brought:
        del sys.modules[name]
    for kind, registry in KINDS.items():
        for name in set(registry.loaded) - before[kind]:
            if registry.loaded[name].__module__ in brought:
                del registry._entries[name]


def call_main(*arguments: str | Path, cwd: Path) -> int:
    """Run the command line in this process and in the folder ``cwd``; return its exit code."""
    with pytest.MonkeyPatch.context() as patch, forgetting():
        patch.setattr(sys, "argv", ["sysid-evo", *map(str, arguments)])
        patch.setattr(session, "run", None)
        patch.setattr(session, "debug", False)
        patch.setattr(err, "quiet", False)
        patch.setattr("warnings.showwarning", lambda *_, **__: None)
        patch.chdir(cwd)
        try:
            main()
        except SystemExit as ended:
            return ended.code if isinstance(ended.code, int) else 0
    return 0


def run_here(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run ``sysid-evo`` as `run` does, but in this process, which has everything imported and compiled."""
    out, wrong = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(wrong):
        code = call_main(*arguments, cwd=cwd)
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), wrong.getvalue())


class Caller:
    """Calls ``sysid-evo`` in this process and in this folder."""

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder, self._captured = folder, capsys

    def __call__(self, *arguments: str | Path) -> Ended:
        self._captured.readouterr()
        code = call_main(*arguments, cwd=self.folder)
        captured = self._captured.readouterr()
        return Ended(code, captured.out, captured.err)
