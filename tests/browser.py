"""Pages in a headless Chromium, through Playwright: each in a context of its own, offline and without an error."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, BrowserContext, ConsoleMessage, Page, expect, sync_playwright

PHONE, TABLET, DESK = 375, 768, 1280
"""Widths (CSS pixels) at which every page is looked at."""
PATIENCE = 60_000.0  # ms for what takes a fraction of it on a machine without other work
HERE = {"127.0.0.1", "localhost"}
OFFLINE = [
    "--disable-background-networking",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost",
]


def find_chromium() -> str:
    """Return the path of a Chromium; without one the test is skipped, in CI it fails."""
    for name in ("chromium", "chromium-browser", "google-chrome"):
        found = shutil.which(name)
        if found:
            return found
    if os.environ.get("CI"):
        pytest.fail("no chromium: CI must install it")
    pytest.skip("no chromium is installed, so the page cannot be opened")


@contextmanager
def chromium() -> Iterator[Browser]:
    """A browser in a process of its own, which knows the names of no other machine."""
    path = find_chromium()
    expect.set_options(timeout=PATIENCE)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=path, args=["--no-sandbox", "--disable-gpu", *OFFLINE], timeout=PATIENCE
        )
        yield browser
        browser.close()


class Visitor:
    """Opens pages, each in a fresh context; ``faults`` are errors in them and what they asked of other machines.

    A fault with one of the words ``tolerated`` in it is none.
    """

    def __init__(self, browser: Browser) -> None:
        self._browser = browser
        self._contexts: list[BrowserContext] = []
        self.faults: list[str] = []
        self.tolerated: tuple[str, ...] = ()

    def page(self, *, width: int = DESK, height: int = 800, dark: bool = False, **options: Any) -> Page:
        """Return an empty page of this size in CSS pixels; ``options`` are those of `Browser.new_context`."""
        context = self._browser.new_context(
            viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light", **options
        )
        self._contexts.append(context)
        context.set_default_timeout(PATIENCE)
        context.on("console", self._said)
        context.on("weberror", lambda error: self.faults.append(str(error.error)))
        context.on("request", lambda request: self._asked(request.url))
        context.on("page", lambda page: page.on("websocket", lambda line: self._asked(line.url)))
        return context.new_page()

    def open(self, where: str | Path, **options: Any) -> Page:
        """Return the page at an address or in a file, loaded; ``options`` as for `page`."""
        page = self.page(**options)
        page.goto(where.as_uri() if isinstance(where, Path) else where)
        return page

    def leave(self) -> None:
        """Close all pages, and fail if something was wrong in one of them."""
        for context in self._contexts:
            context.close()
        faults = [fault for fault in self.faults if not any(word in fault for word in self.tolerated)]
        assert not faults, faults

    def _said(self, message: ConsoleMessage) -> None:
        if message.type in ("error", "assert"):
            self.faults.append(f"{message.text} (at {message.location['url']})")

    def _asked(self, address: str) -> None:
        parts = urlsplit(address)
        if parts.scheme not in ("file", "data", "blob", "about") and parts.hostname not in HERE:
            self.faults.append(f"asked for {address}")


def resize(page: Page, width: int, height: int = 800) -> None:
    """Give the window of a page another size, in CSS pixels."""
    page.set_viewport_size({"width": width, "height": height})


def shown(page: Page, selector: str) -> int:
    """Return how many elements of a kind have a size on the screen."""
    found: int = page.locator(selector).evaluate_all("all => all.filter(e => e.getClientRects().length).length")
    return found


def sideways(page: Page) -> int:
    """Return by how much the page can be scrolled sideways, in CSS pixels."""
    found: int = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    return found
