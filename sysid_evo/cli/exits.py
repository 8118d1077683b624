"""How commands end, and the exit code of each end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sysid_evo.cli import INTERRUPTED

if TYPE_CHECKING:
    from hardware.loop.report import Reason

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
