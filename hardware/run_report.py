"""Reason of the end of a run, its punctuality, and stop requests from outside (signals, threads)."""

from __future__ import annotations

import math
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from types import FrameType, TracebackType
from typing import Any, Self

import numpy as np

from sysid_evo.errors import LinkLost
from sysid_evo.types import Array

ROBOT = 4
"""Exit code of a command ended by link, tracker or robot; the command line uses the same for other commands, too."""


class StopReason(Enum):
    """Reason of the end of a run: a sentence, and the exit code of its command (0: normal end).

    That of a signal is the one of shells; a fault of link, tracker or robot has 4.
    """

    SAMPLES = ("all samples were driven", 0)
    PILOT = ("the pilot ended the run", 0)
    LINK_LOST = ("the link to the robot or its tracker was lost", ROBOT)
    TRACKER_LOST = ("the tracker lost the robot", ROBOT)
    TRIPPED = ("the robot stopped itself", ROBOT)
    NOT_FINITE = ("the control was not a number", ROBOT)
    NOT_AT_REST = ("the robot did not come to rest", ROBOT)
    THREAD_DIED = ("a thread died", ROBOT)
    SIGHUP = ("hung up", 129)
    SIGINT = ("interrupted", 130)
    SIGTERM = ("terminated", 143)

    def __init__(self, sentence: str, exit_code: int) -> None:
        self.sentence = sentence
        self.exit_code = exit_code

    @property
    def is_fault(self) -> bool:
        """Whether the run was ended early."""
        return self.exit_code != 0


@dataclass(frozen=True)
class LoopReport:
    """One run of the control loop.

    ``ticks`` commands were sent, each ``lateness`` (ticks,) s after it was due; ``gaps`` (ticks - 1,) are the seconds
    between one and the next. ``skipped`` ticks were missed and left out, ``stale`` ones sent neutral because the newest
    pose was too old. ``rejected`` counts the frames that were not used, by reason.
    """

    reason: StopReason
    detail: str
    lateness: Array
    gaps: Array
    skipped: int = 0
    stale: int = 0
    rejected: Mapping[str, int] = field(default_factory=dict)

    @property
    def ticks(self) -> int:
        return len(self.lateness)

    @property
    def sentence(self) -> str:
        """Reason of the end of the run, in words."""
        return f"{self.reason.sentence}: {self.detail}" if self.detail else self.reason.sentence

    @property
    def punctuality(self) -> str:
        """Punctuality of the loop, in words."""
        if not self.ticks:
            return f"No command was sent: {self.sentence}."
        median, high = np.percentile(self.lateness, (50, 99))
        gap = self.gaps.max() if len(self.gaps) else 0.0
        return (
            f"{self.ticks} commands; late by {1e3 * median:.1f} ms (median), {1e3 * high:.1f} ms (99 %); longest gap "
            f"{1e3 * gap:.0f} ms; {self.skipped} skipped, {self.stale} sent as neutral (no recent pose)."
        )


PATIENCE = 10.0
"""Longest time (s) for a robot to answer one call: a hundred times the longest `dt` of a driven one."""

GRACE = 1.0
"""Time (s) that it has to answer after a signal."""

SIGNALS = {signal.SIGINT: StopReason.SIGINT, signal.SIGTERM: StopReason.SIGTERM, signal.SIGHUP: StopReason.SIGHUP}


class StopRequest:
    """Stores a request to end a run, and its reason; the loop checks it at least every 20 ms.

    Within a ``with`` statement, which only the main thread can enter, SIGINT, SIGTERM, SIGHUP and an exception that
    ends a thread make a request. They only store it, so that no frame on the wire is cut in two; a second signal raises
    `KeyboardInterrupt`, in case the loop does not respond. Calls within `answer` must return within ``patience`` s, and
    within a second after a signal.
    """

    def __init__(self, patience: float = PATIENCE) -> None:
        self.patience = patience
        self.reason: StopReason | None = None
        self.detail = ""
        self._handlers: dict[signal.Signals, Any] = {}
        self._asked = ""
        self._excepthook = threading.excepthook

    def request(self, reason: StopReason, detail: str = "") -> None:
        """End the run for ``reason``; the first request counts. Any thread may call it."""
        if self.reason is None:
            self.detail = detail
            self.reason = reason

    def __enter__(self) -> Self:
        self._handlers = {number: signal.signal(number, self._signalled) for number in SIGNALS}
        self._handlers[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._unanswered)
        self._excepthook = threading.excepthook
        threading.excepthook = self._died
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        threading.excepthook = self._excepthook
        for number, handler in self._handlers.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)
        self._handlers = {}

    @contextmanager
    def answer(self, name: str, patience: float | None = None) -> Iterator[None]:
        """Limit the time of calls to ``name`` within it. Raises `LinkLost` after it, if signals are handled.

        ``patience`` replaces the time of all calls; `math.inf` is for a call with its own time limit.
        """
        if not self._handlers:
            yield
            return
        self._asked, patience = name, self.patience if patience is None else patience
        self._wait(0.0 if math.isinf(patience) else patience)
        try:
            yield
        finally:
            self._asked = ""
            self._wait(0.0)

    @staticmethod
    def _wait(seconds: float) -> None:
        """Set the alarm to ``seconds``, then to every second: a robot may catch the first exception."""
        signal.setitimer(signal.ITIMER_REAL, seconds, GRACE if seconds else 0.0)

    def _unanswered(self, _: int, __: FrameType | None) -> None:
        if self._asked:
            within = f" within {GRACE:g} s of the signal" if self.reason else f" for {self.patience:g} s"
            raise LinkLost(f"{self._asked}: no answer{within}")

    def _signalled(self, number: int, _: FrameType | None) -> None:
        if self.reason is not None:
            raise KeyboardInterrupt
        self.request(SIGNALS[signal.Signals(number)])
        if self._asked:
            self._wait(GRACE)

    def _died(self, arguments: threading.ExceptHookArgs) -> None:
        name = "a thread" if arguments.thread is None else arguments.thread.name
        self.request(StopReason.THREAD_DIED, f"{name}: {arguments.exc_type.__name__}: {arguments.exc_value}")
        self._excepthook(arguments)
