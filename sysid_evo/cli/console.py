"""Standard output and error, notes, error messages and exit codes.

``err`` is for progress and remarks, which ``--quiet`` leaves out; ``problems`` for errors, which it does not.
"""

from __future__ import annotations

import errno
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

if TYPE_CHECKING:
    from hardware.run_report import Reason


INTERRUPTING = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EMFILE)
"""What stops a work that was going on: no space, no quota, a failing disk, too many open files."""

out = Console()

err = Console(stderr=True)

problems = Console(stderr=True)


@dataclass
class Session:
    """What this command was asked: to show tracebacks, and where it logs."""

    debug: bool = False
    run: Path | None = None


session = Session()


def tell(text: str, *, label: str = "", style: str = "") -> None:
    """Print a sentence on standard error, behind a coloured label."""
    err.print(Text.assemble((label, style), text), soft_wrap=True)


def complain(error: BaseException) -> None:
    """Print an error on standard error, with its traceback if asked for; the run's log always holds it."""
    text = "".join(traceback.format_exception(error))
    if session.debug:
        problems.print(text, markup=False, highlight=False, soft_wrap=True)
    problems.print(Text.assemble(("error: ", "bold red"), sentence_of(error)))
    if session.run is not None and session.run.is_dir():
        from sysid_evo.plan.store import Store

        try:
            Store(session.run).log(error=sentence_of(error), traceback=text)
        except OSError as failed:
            problems.print(f"the error could not be logged: {failed}", markup=False, highlight=False)


def sentence_of(error: BaseException) -> str:
    """Return what an error says; one of the operating system names its file."""
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename else ""
        kept = ". What was finished until then is kept; the same command goes on from there"
        return f"{where}{error.strerror}{kept if error.errno in INTERRUPTING else ''}"
    return str(error) or type(error).__name__


DONE = 0

WRONG_INPUT = 2

SOME_FAILED = 3

ROBOT = 4

EXIT_CODES = (
    "Exit codes: 0 done; 2 wrong usage or input; 3 some parts failed (the rest is done, reasons are told); "
    "4 robot, link or scheduler; 130 interrupted."
)


def code_of_loop(reason: Reason) -> int:
    """Return the exit code of a command that drove a robot until ``reason``: a signal keeps its own."""
    return reason.exit_code if reason.exit_code == 0 or reason.exit_code >= 128 else ROBOT


def code_of(error: BaseException) -> int:
    """Return the exit code of a command that ``error`` ended."""
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED
    if isinstance(error, ConnectionError):
        return ROBOT
    return SOME_FAILED if isinstance(error, OSError) else WRONG_INPUT


INTERRUPTED = 130
"""Exit code of a command that was stopped with Ctrl-C."""
