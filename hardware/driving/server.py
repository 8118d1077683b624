"""The web server of the page: access, files, web socket."""

from __future__ import annotations

import asyncio
import ipaddress
import json
import secrets
import socket
import threading
import time
import webbrowser
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from hardware.connection import Closeable
from hardware.driving.keyboard import Keyboard, PageClient, PageClients
from hardware.driving.page_messages import DrivePanel, InvalidPageMessage, as_text, messages_script
from hardware.run_report import StopReason, StopRequest
from sysid_evo.errors import InvalidArgument, LinkLost
from sysid_evo.extras import check_installed

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.types import ASGIApp, Receive, Scope, Send
    from starlette.websockets import WebSocket

PACKAGES = ("starlette", "uvicorn", "websockets")
"""Packages that serve the page."""

PAGE = Path(__file__).parent / "page"
FILES = ("drive.css", "drive.js", "plot.js", "traces.js", "view.js")
"""Files served by name, in addition to the page itself and the table of messages."""
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
PERIOD = 0.02  # s between two readings that are sent to the page
MESSAGE_BYTES = 256  # the longest message of a page
MOST_CONNECTIONS = 32
"""Maximum number of simultaneous requests and web sockets; only those with the secret count."""
SILENCE = 5.0  # s within which a connection must have sent a whole request
MOST_SILENT = 64
"""Connections without a request: beyond this number the oldest is closed, to save the system's file handles."""
PING = 1.0  # s after which a page that does not answer is closed
START_UP = 5.0  # s
INVALID = 1008  # the web socket's code for a message that violates the rules
REASON_BYTES = 120  # of the sentence that goes with it; the protocol has room for 123


@dataclass(frozen=True)
class PageAddress:
    """Address of the page, and whether it is also opened in the browser. Port 0 is a free one."""

    host: str = "127.0.0.1"
    port: int = 0
    opened: bool = False


def check_page() -> None:
    """Raise `MissingExtra` if a package is missing that serves the page."""
    check_installed("driving by hand", PACKAGES)


@contextmanager
def served(
    panel: DrivePanel, keyboard: Keyboard, address: PageAddress, *, stop: StopRequest, announce: Callable[[str], None]
) -> Iterator[PageServer]:
    """Serve the page during the ``with`` block, which is stopped if the server dies; ``announce`` gets the URL."""
    died = partial(stop.request, StopReason.THREAD_DIED)
    with PageServer(panel, keyboard, host=address.host, port=address.port, on_server_end=died) as page:
        announce(page.url)
        if address.opened:
            webbrowser.open(page.url)
        yield page


class PageServer(Closeable):
    """The page at ``url`` while it is open, served from its own thread.

    ``port`` 0 takes a free one. ``on_server_end`` is called with a sentence, in that thread, if the server ends before
    it is closed; all keys are released then. ``seats`` are the clients of the open pages. Raises `MissingExtra` for a
    missing package, `InvalidArgument` if the address cannot be used, `LinkLost` if the server does not start.
    """

    def __init__(
        self,
        panel: DrivePanel,
        keyboard: Keyboard,
        *,
        host: str,
        port: int,
        on_server_end: Callable[[str], None],
    ) -> None:
        check_page()
        import uvicorn

        token = secrets.token_urlsafe(TOKEN_BYTES)  # another address each time
        try:
            self._socket = socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
        except (OSError, OverflowError) as error:
            raise InvalidArgument(f"the page cannot be served at {host}, port {port}: {error}") from error
        named = f"[{host}]" if ":" in host else host
        self.url = f"http://{named}:{self._socket.getsockname()[1]}/{token}/"
        self._keyboard = keyboard
        self.seats = PageClients(keyboard)
        self._died = on_server_end
        self._closing = False
        self._server = uvicorn.Server(
            uvicorn.Config(
                make_app(panel, self.seats, token=token, host=host),
                http=impatient_http(),
                ws="websockets-sansio",
                ws_max_size=MESSAGE_BYTES,
                ws_ping_interval=PING,
                ws_ping_timeout=PING,
                ws_per_message_deflate=False,
                lifespan="off",
                log_config=None,
                access_log=False,
                server_header=False,
                proxy_headers=False,
                timeout_graceful_shutdown=1,
            )
        )
        self._thread = threading.Thread(target=self._serve, name="page server", daemon=True)
        self._thread.start()
        deadline = time.monotonic() + START_UP
        while not self._server.started:
            if not self._thread.is_alive() or time.monotonic() > deadline:
                self.close()
                raise LinkLost(f"the page's server did not start at {self.url} within {START_UP:.0f} s")
            time.sleep(0.01)

    def close(self) -> None:
        self._closing = True
        self._server.should_exit = True
        self._thread.join(START_UP)
        self._socket.close()

    def _serve(self) -> None:
        try:
            self._server.run(sockets=[self._socket])
        finally:
            self._keyboard.release()
            if not self._closing:
                self._died("the page's server ended")


def impatient_http() -> type[asyncio.Protocol]:
    """Return uvicorn's HTTP protocol with a time limit: connections without a whole request are closed."""
    from uvicorn.protocols.http.h11_impl import H11Protocol

    silent: dict[H11Protocol, asyncio.TimerHandle] = {}

    class ImpatientHttp(H11Protocol):
        """A connection of one client."""

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
            super().connection_made(transport)
            if len(silent) >= MOST_SILENT:
                first = next(iter(silent))
                first.transport.abort()
                silent.pop(first).cancel()
            silent[self] = self.loop.call_later(SILENCE, transport.abort)

        def handle_events(self) -> None:
            super().handle_events()
            if self.scope is not None:  # a request has come
                self._request_received()

        def connection_lost(self, exc: Exception | None) -> None:
            self._request_received()
            super().connection_lost(exc)

        def _request_received(self) -> None:
            if self in silent:
                silent.pop(self).cancel()

    return ImpatientHttp


def make_app(panel: DrivePanel, seats: PageClients, *, token: str, host: str) -> Starlette:
    """Return the page, its files and its web socket, all behind ``/token/``."""
    from starlette.applications import Starlette
    from starlette.middleware import Middleware
    from starlette.responses import Response
    from starlette.routing import Mount, Route, WebSocketRoute
    from starlette.websockets import WebSocketDisconnect

    async def converse(page: WebSocket) -> None:
        await page.accept()
        seat = seats.join()
        talking = asyncio.create_task(_send(page, seat, seats, panel))
        try:
            await _receive(page, seat)
        except ValueError as error:
            seats.remove(seat)
            await page.close(INVALID, str(error).encode("ascii", "backslashreplace")[:REASON_BYTES].decode())
        finally:
            seats.remove(seat)
            talking.cancel()
            with suppress(asyncio.CancelledError, WebSocketDisconnect):
                await talking

    async def messages(_: Request) -> Response:
        return Response(messages_script(), headers=HEADERS, media_type="text/javascript")

    files = [Route("/", _file(PAGE / "index.html")), *(Route(f"/{name}", _file(PAGE / name)) for name in FILES)]
    routes = [Mount(f"/{token}", routes=[*files, Route("/messages.js", messages), WebSocketRoute("/socket", converse)])]
    return Starlette(routes=routes, middleware=[Middleware(Guard, token=token, host=host)])


def _file(path: Path) -> Callable[[Request], Awaitable[Response]]:
    from starlette.responses import FileResponse

    async def answer(_: Request) -> Response:
        return FileResponse(path, headers=HEADERS)

    return answer


async def _receive(page: WebSocket, seat: PageClient) -> None:
    """Handle the messages of the page until it leaves. Raises `InvalidPageMessage` or another `ValueError`."""
    while True:
        message = await page.receive()
        if message["type"] == "websocket.disconnect":
            return
        if message.get("text") is None:
            raise InvalidPageMessage("expected text, got bytes")
        seat.receive(json.loads(message["text"]), time.monotonic())


async def _send(page: WebSocket, seat: PageClient, seats: PageClients, panel: DrivePanel) -> None:
    """Send the page the setting once, the scenery of each trial, and the newest reading periodically."""
    await page.send_text(as_text(panel.setting()))
    trial = None
    while True:
        reading = replace(panel.reading(), is_driver=seat.is_driver, watchers=seats.watchers)
        if reading.trial != trial:
            trial = reading.trial
            await page.send_text(as_text(panel.scenery()))
        await page.send_text(as_text(reading))
        await asyncio.sleep(PERIOD)


TOKEN_BYTES = 16
FORBIDDEN, BUSY = 403, 503


class Guard:
    """Answers 403 unless the first part of the path is ``token`` and the request comes from our own page.

    A refused client is also disconnected. Of the accepted ones, more than `MOST_CONNECTIONS` at once get 503.

    Any web page can make a browser send requests to this machine. It does not know the token. A page whose name was
    redirected to this machine after it was loaded (DNS rebinding) has its name in the Host header, so that must be an
    address, localhost, this machine's name or ``host``. Any other page has its name in the Origin header, which every
    browser sends with a web socket.
    """

    def __init__(self, app: ASGIApp, *, token: str, host: str) -> None:
        self._app = app
        self._token = token.encode()
        self._names = {"localhost", host.lower(), socket.gethostname().lower()}
        self._open = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        from starlette.responses import PlainTextResponse
        from starlette.websockets import WebSocketClose

        refused = None
        if scope["type"] != "lifespan" and not self._allows(scope):
            refused = FORBIDDEN, "open the address that sysid-evo drive printed"
        elif self._open >= MOST_CONNECTIONS:
            refused = BUSY, "too many pages are open: close one"
        if refused is None:
            self._open += 1
            try:
                await self._app(scope, receive, send)
            finally:
                self._open -= 1
        elif scope["type"] == "websocket":
            await WebSocketClose()(scope, receive, send)
        else:
            code, why = refused
            answer = PlainTextResponse(f"{code}: {why}.\n", code, {"Connection": "close"})
            await answer(scope, receive, send)

    def _allows(self, scope: Scope) -> bool:
        headers = [(name, value.decode("latin-1")) for name, value in scope["headers"]]
        hosts = [value for name, value in headers if name == b"host"]
        origins = [value for name, value in headers if name == b"origin"]
        given = scope["path"].split("/")[1] if scope["path"].count("/") > 1 else ""
        return (
            secrets.compare_digest(given.encode("utf-8", "surrogateescape"), self._token)
            and len(hosts) == 1
            and self._is_ours(hosts[0])
            and (bool(origins) or scope["type"] == "http")
            and all(origin == f"http://{hosts[0]}" for origin in origins)
        )

    def _is_ours(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if name in self._names:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True
