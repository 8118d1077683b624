"""A controller that drives, shown on the local page."""

from __future__ import annotations

import time
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sysid_evo.cli.console import out
from sysid_evo.cli.hand_driving import page_server

if TYPE_CHECKING:
    from hardware.driving.controller_panel import ControllerPanel
    from hardware.loop.stops import Stops

POLL = 0.05  # s
LAST_LOOK = 0.3
"""Seconds for which the page still hears how the last trial ended."""


@dataclass(frozen=True)
class Watching:
    """Where the page is served that shows a controller, and whether it is opened in the browser, too."""

    host: str
    port: int
    open_page: bool

    @contextmanager
    def shown(self, panel: ControllerPanel, stops: Stops) -> Iterator[None]:
        """Serve ``panel`` and wait until somebody has opened the page, or a stop from outside."""
        from hardware.driving.keyboard import Keyboard
        from hardware.loop.report import Reason

        def died(why: str) -> None:
            stops.request(Reason.THREAD_DIED, why)

        with page_server()(panel, Keyboard(life=1.0), host=self.host, port=self.port, died=died) as served:
            out.print(f"Watch it at {served.url}", highlight=False, markup=False, soft_wrap=True)
            if self.open_page:
                webbrowser.open(served.url)
            while served.seats.driver is None and stops.reason is None:
                time.sleep(POLL)
            yield
            if stops.reason is None:
                time.sleep(LAST_LOOK)
