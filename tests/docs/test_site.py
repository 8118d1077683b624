"""The pages of docs become a site without a warning."""

from __future__ import annotations

import html
import re
from pathlib import Path

import sysid_evo
from sysid_evo.cli.app import loaded
from tests.docs.blocks import ROOT


def test_every_command_has_its_place_in_the_reference(site: Path) -> None:
    page = html.unescape(re.sub(r"<[^>]+>", "", (site / "reference" / "commands.html").read_text()))
    group = loaded()
    for name in group.commands:  # type: ignore[attr-defined]  # an application of several commands is a group
        assert f"sysid-evo {name}" in page
    assert "--leave-out" in page
    whole = r"compare: Fit .*: which predict, which transfer\."  # not what a terminal has room for
    assert re.search(whole, page)


def test_the_reference_of_python_describes_what_is_imported_from_the_package(site: Path) -> None:
    page = (site / "reference" / "python.html").read_text()
    for name in ("dataset.Dataset", "base.DynamicsModel", "running.compare"):
        assert re.search(rf'id="[\w.]*{re.escape(name)}"', page), name
    assert "Return minus the simulation error" in page


def test_the_version_stands_in_one_place_and_who_cites_names_it() -> None:
    cited = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert cited is not None
    assert cited[1] == sysid_evo.__version__
    assert f"## {sysid_evo.__version__}" in (ROOT / "CHANGELOG.md").read_text()


def test_links_to_the_firmware_lead_to_its_page(site: Path) -> None:
    assert 'href="firmware.html"' in (site / "hardware.html").read_text()
    assert (site / "firmware.html").is_file()


def test_links_have_words_and_no_file_names(site: Path) -> None:
    for page in site.rglob("*.html"):
        assert re.findall(r"<a [^>]*>[^<]*\.md</a>", page.read_text()) == [], page


def test_the_site_asks_nobody_else_for_anything(site: Path) -> None:
    for page in site.rglob("*.html"):
        asked = re.findall(r'<(?:script|link|img)[^>]+(?:src|href)="(https?://[^"]+)"', page.read_text())
        assert asked == [], page
