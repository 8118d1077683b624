"""Who may open the page: those who have its address, from a page that is really ours."""

from __future__ import annotations

import ipaddress
import secrets
import socket
from urllib.parse import urlsplit

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocketClose

TOKEN_BYTES = 16
FORBIDDEN = 403


def new_token() -> str:
    """Return a secret for an address, different each time."""
    return secrets.token_urlsafe(TOKEN_BYTES)


class Guard:
    """Answers 403 unless the first part of the path is ``token`` and the request comes from our own page.

    Any web page can make a browser send requests to this machine. It does not know the token. A
    page whose name was pointed at this machine after it was loaded (DNS rebinding) names itself in
    the Host header, so that must be an address, localhost, this machine's name or ``host``; any
    other page names itself in the Origin header, which every browser sends with a web socket.
    """

    def __init__(self, app: ASGIApp, *, token: str, host: str) -> None:
        self._app = app
        self._token = token.encode()
        self._names = {"localhost", host.lower(), socket.gethostname().lower()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan" or self._allows(scope):
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await WebSocketClose()(scope, receive, send)
        else:
            await PlainTextResponse("403: open the address that sysid-evo drive printed.\n", FORBIDDEN)(
                scope, receive, send
            )

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
