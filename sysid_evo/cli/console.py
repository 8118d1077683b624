"""Standard output and error, notes, error messages and exit codes.

``err`` is for progress and remarks, which ``--quiet`` leaves out; ``problems`` for errors, which it does not.
"""

from __future__ import annotations

import errno
import signal
import traceback
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from sysid_evo.errors import printable

if TYPE_CHECKING:
    from sysid_evo.plan import Store

WRONG_INPUT = 2
SOME_FAILED = 3
ROBOT = 4

INTERRUPTED = 128 + signal.SIGINT
"""Exit code of a command that was stopped with Ctrl-C."""

EXIT_CODES = (
    "Exit codes: 0 success; 1 a plugin breaks its contract; 2 wrong usage or input; 3 some steps failed (the others "
    "finished; reasons are listed); 4 robot, link or scheduler; 130 interrupted."
)

INTERRUPTING = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EMFILE)
"""Errors that interrupt work: no space, no quota, a failing disk, too many open files."""


class Printer(Console):
    """A console for text with names from files: they can neither control the terminal nor act as markup."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(markup=False, emoji=False, **settings)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """Yield the segments of ``renderable`` without control characters; all output passes here."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=printable(segment.text))


out = Printer()
err = Printer(stderr=True)
problems = Printer(stderr=True)


@dataclass
class CommandState:
    """State of this command: whether it shows tracebacks, and the run in which it logs errors."""

    debug: bool = False
    run: Store | None = None


session = CommandState()


def print_line(text: str) -> None:
    """Print a line on standard output, without colours and without wrapping."""
    out.print(text, highlight=False, markup=False, soft_wrap=True)


def print_status(text: str, *, label: str = "", style: str = "") -> None:
    """Print a sentence on standard error, after a coloured label."""
    err.print(Text.assemble((label, style), text), soft_wrap=True)


def note(text: str) -> None:
    """Print a remark on standard error."""
    print_status(text, label="note: ", style="dim")


def table_of(*headings: str, numbers: Collection[str] = (), whole: Collection[str] = ()) -> Table:
    """Return a table without lines with these columns; ``numbers`` are right-aligned, ``whole`` never wrap."""
    table = Table(box=None, pad_edge=False)
    for heading in headings:
        side: Any = "right" if heading in numbers else "left"
        table.add_column(heading, justify=side, overflow="fold", no_wrap=heading in whole)
    return table


def as_option(name: str, value: Any = None) -> str:
    """Return an option as it is typed: ``--stop-after fit``."""
    option = "--" + name.replace("_", "-")
    return f"{option} {value}" if isinstance(value, str) else option


def print_error(error: BaseException) -> None:
    """Print an error on standard error, with --debug also its traceback; the log of the run holds both."""
    text = "".join(traceback.format_exception(error))
    if session.debug:
        problems.print(text, markup=False, highlight=False, soft_wrap=True)
    problems.print(Text.assemble(("error: ", "bold red"), error_sentence(error)))
    if session.run is not None and session.run.path.is_dir():
        try:
            session.run.log(error=error_sentence(error), traceback=text)
        except OSError as failed:
            problems.print(f"the error could not be logged: {failed}", markup=False, highlight=False)


def error_sentence(error: BaseException) -> str:
    """Return the message of an error; one of the operating system names its file."""
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename else ""
        kept = ". Finished results are kept; repeat the command to continue"
        return f"{where}{error.strerror}{kept if error.errno in INTERRUPTING else ''}"
    return str(error) or type(error).__name__


def code_of(error: BaseException) -> int:
    """Return the exit code of a command that ``error`` ended."""
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED
    if isinstance(error, ConnectionError):
        return ROBOT
    return SOME_FAILED if isinstance(error, OSError) else WRONG_INPUT
