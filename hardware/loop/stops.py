"""What ends a run from outside: signals, a thread that dies, a request of another thread."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any, Self

from hardware.loop.report import Reason

SIGNALS = {signal.SIGINT: Reason.SIGINT, signal.SIGTERM: Reason.SIGTERM, signal.SIGHUP: Reason.SIGHUP}


class Stops:
    """Remembers that a run must end, and why; the loop looks at it at least every 20 ms.

    Within a ``with`` statement, which only the main thread can enter, SIGINT, SIGTERM, SIGHUP and an
    exception that ends a thread request it. They only leave a note, so that no frame on the wire is
    cut in two; a second signal raises `KeyboardInterrupt`, in case the loop does not come round.
    """

    def __init__(self) -> None:
        self.reason: Reason | None = None
        self.detail = ""
        self._handlers: dict[signal.Signals, Any] = {}
        self._excepthook = threading.excepthook

    def request(self, reason: Reason, detail: str = "") -> None:
        """End the run for ``reason``; the first request counts. Any thread may call it."""
        if self.reason is None:
            self.detail = detail
            self.reason = reason

    def __enter__(self) -> Self:
        self._handlers = {number: signal.signal(number, self._signalled) for number in SIGNALS}
        self._excepthook = threading.excepthook
        threading.excepthook = self._died
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        threading.excepthook = self._excepthook
        for number, handler in self._handlers.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)

    def _signalled(self, number: int, _: FrameType | None) -> None:
        if self.reason is not None:
            raise KeyboardInterrupt
        self.request(SIGNALS[signal.Signals(number)])

    def _died(self, arguments: threading.ExceptHookArgs) -> None:
        name = "a thread" if arguments.thread is None else arguments.thread.name
        self.request(Reason.THREAD_DIED, f"{name}: {arguments.exc_type.__name__}: {arguments.exc_value}")
        self._excepthook(arguments)
