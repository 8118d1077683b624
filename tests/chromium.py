"""A headless Chromium, driven through its DevTools protocol."""

from __future__ import annotations

import base64
import itertools
import json
import os
import shutil
import subprocess
import time
import urllib.request
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pytest
from websockets.sync.client import ClientConnection, connect

START_UP = 60.0  # s
ANSWER = 20.0  # s
KEY_CODES = {
    "Home": 36,
    "ArrowLeft": 37,
    "ArrowUp": 38,
    "ArrowRight": 39,
    "ArrowDown": 40,
    "Space": 32,
    "KeyR": 82,
    "KeyW": 87,
}


def find_chromium() -> str:
    """Return the path of a Chromium; without one the test is skipped, in CI it fails."""
    for name in ("chromium", "chromium-browser", "google-chrome"):
        found = shutil.which(name)
        if found:
            return found
    if os.environ.get("CI"):
        pytest.fail("no chromium: CI must install it")
    pytest.skip("no chromium is installed, so the page cannot be opened")


class Chromium:
    """A browser in a process of its own, with the profile in ``folder``."""

    def __init__(self, path: str, folder: Path) -> None:
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--mute-audio"]
        self._process = subprocess.Popen(
            [path, *options, "--remote-debugging-port=0", f"--user-data-dir={folder}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._tabs: list[Tab] = []
        self._port = self._find_port(folder / "DevToolsActivePort")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for tab in self._tabs:
            tab.let_go()
        self._process.terminate()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def open(self, url: str) -> Tab:
        """Open a new tab and return when its page is loaded."""
        tab = Tab(self._ask("PUT", "new?about:blank")["webSocketDebuggerUrl"])
        self._tabs.append(tab)
        tab.call("Page.enable")
        tab.call("Page.navigate", url=url)
        tab.wait_for("document.readyState === 'complete'")
        return tab

    def _ask(self, method: str, what: str) -> Any:
        request = urllib.request.Request(f"http://127.0.0.1:{self._port}/json/{what}", method=method)
        with urllib.request.urlopen(request, timeout=ANSWER) as answer:
            return json.load(answer)

    def _find_port(self, file: Path) -> int:
        deadline = time.monotonic() + START_UP
        while time.monotonic() < deadline:
            lines = file.read_text().splitlines() if file.is_file() else []
            if len(lines) == 2:
                return int(lines[0])
            time.sleep(0.05)
        self._process.kill()
        raise TimeoutError(f"chromium did not open its DevTools within {START_UP} s")


class Tab:
    """One page of the browser."""

    def __init__(self, address: str) -> None:
        self._closing = ExitStack()
        line = connect(address, max_size=None, compression=None, close_timeout=1.0)
        self._line: ClientConnection = self._closing.enter_context(line)
        self._numbers = itertools.count(1)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the DevTools protocol and return its result."""
        number = next(self._numbers)
        self._line.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._line.recv(timeout=ANSWER))
            if answer.get("id") == number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                result: dict[str, Any] = answer["result"]
                return result

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression in the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, f"{expression}: {answer['exceptionDetails']}"
        return answer["result"].get("value")

    def wait_for(self, expression: str, *, timeout: float = 20.0) -> None:
        """Wait until a JavaScript expression is true."""
        deadline = time.monotonic() + timeout
        while not self.evaluate(expression):
            assert time.monotonic() < deadline, f"not true within {timeout} s: {expression}"
            time.sleep(0.02)

    def press(self, code: str) -> None:
        """Push a key down and hold it."""
        self._key("rawKeyDown", code)

    def release(self, code: str) -> None:
        """Let go of a key."""
        self._key("keyUp", code)

    def move_to(self, x: float, y: float) -> None:
        """Move the pointer to a place in the window, in CSS pixels."""
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)

    def click(self, selector: str) -> None:
        """Click the element that a selector finds first."""
        self.evaluate(f"document.querySelector({json.dumps(selector)}).click()")

    def picture(self, file: Path, *, width: int, height: int, dark: bool = False) -> None:
        """Write a picture of the page at this size in CSS pixels."""
        self.to_front()
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        time.sleep(0.2)
        file.write_bytes(base64.b64decode(self.call("Page.captureScreenshot")["data"]))

    def to_front(self) -> None:
        """Show the tab: one behind another draws nothing, and its pictures are waited for in vain."""
        self.call("Page.bringToFront")

    def close(self) -> None:
        """Close the tab as its user would."""
        self.call("Page.close")
        self.let_go()

    def let_go(self) -> None:
        """End the conversation with the tab and leave it as it is."""
        self._closing.close()

    def _key(self, kind: str, code: str) -> None:
        self.call("Input.dispatchKeyEvent", type=kind, code=code, key=code, windowsVirtualKeyCode=KEY_CODES[code])
