"""On the built site every link and anchor leads somewhere, and no page is wider than a telephone."""

from __future__ import annotations

import re
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from tests.docs.blocks import ROOT
from tests.fixtures.browser import PHONE, Visitor, sideways

OTHERS = {
    "github.com",
    "semver.org",
    "gymnasium.farama.org",
    "squidfunk.github.io",
    "distributed.dask.org",
    "jobqueue.dask.org",
}
"""Whom pages link to. A host is added here by hand, so that no address of a machine slips in."""
PATHS = re.compile(r"(?<![\w./])/(?:home|root|work|tmp|Users|opt|mnt)/\w")


class Links(HTMLParser):
    """The addresses that a page names, and the places in it that others may name."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.places: set[str] = {""}
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.places |= {given[name] or "" for name in ("id", "name") if name in given}
        self.addresses += [given[name] or "" for name in ("href", "src") if name in given and tag != "base"]


links = cache(Links)


def pages(site: Path) -> list[Path]:
    """Return the pages of the site; that for what is not found is served from anywhere and has absolute links."""
    return [page for page in sorted(site.rglob("*.html")) if page.name != "404.html"]


def test_every_link_of_the_site_leads_to_a_file_and_a_place_in_it(site: Path) -> None:
    wrong = []
    for page in pages(site):
        for address in links(page).addresses:
            parts = urlsplit(address)
            if parts.scheme or parts.netloc:
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            target = target / "index.html" if target.is_dir() else target
            place = unquote(parts.fragment)
            if not target.is_file() or (target.suffix == ".html" and place not in links(target).places):
                wrong.append(f"{page.relative_to(site)}: {address}")
    assert wrong == []


def test_links_to_others_are_of_a_list_and_encrypted(site: Path) -> None:
    outside = {address for page in pages(site) for address in links(page).addresses if "//" in address}
    assert {urlsplit(address).scheme for address in outside} <= {"https"}
    assert {urlsplit(address).hostname for address in outside} <= OTHERS


def test_no_page_names_a_path_of_somebody_s_machine() -> None:
    for page in [*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md"), ROOT / "CITATION.cff"]:
        assert PATHS.findall(page.read_text(encoding="utf-8")) == [], page


def test_no_page_is_wider_than_a_telephone(site: Path, visitor: Visitor) -> None:
    """Tables and code scroll within themselves; a page that had to be pushed about sideways would be hard to read."""
    visitor.tolerated = ("search/search_index.js",)  # the search needs a server
    page, wide = visitor.page(width=PHONE), []
    for file in pages(site):
        page.goto(file.as_uri(), wait_until="domcontentloaded")
        if sideways(page):
            wide.append(file.relative_to(site).as_posix())
    assert wide == []
