"""The site: built without a warning, complete, links lead somewhere, tables have an age; the picture of the README."""

import html
import importlib.util
import re
import shutil
import struct
import subprocess
import sys
from functools import cache
from html.parser import HTMLParser
from urllib.parse import unquote, urlsplit

import pytest

import sysid_evo
from evaluation.experiment import Experiment
from hardware import CONTRACTS
from sysid_evo.cli.app import loaded
from sysid_evo.testing.contract import rule_of
from tests.docs.page import PAGES, ROOT, picture
from tests.docs.pictures import README, REPORT, SCREEN, first_screen
from tests.fixtures.browser import PHONE, sideways

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


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built with warnings as errors: names that are not found, links and anchors that lead nowhere."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


class Links(HTMLParser):
    """The addresses that a page names, and the places in it that others may name."""

    def __init__(self, page):
        super().__init__()
        self.addresses, self.places = [], {""}
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.places |= {given[name] or "" for name in ("id", "name") if name in given}
        self.addresses += [given[name] or "" for name in ("href", "src") if name in given and tag != "base"]


links = cache(Links)


def pages(site):
    """Return the pages of the site; that for what is not found is served from anywhere and has absolute links."""
    return [page for page in sorted(site.rglob("*.html")) if page.name != "404.html"]


def test_every_link_of_the_site_leads_to_a_file_and_a_place_in_it(site):
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


def test_links_to_others_are_of_a_list_and_encrypted(site):
    outside = {address for page in pages(site) for address in links(page).addresses if "//" in address}
    assert {urlsplit(address).scheme for address in outside} <= {"https"}
    assert {urlsplit(address).hostname for address in outside} <= OTHERS


def test_links_have_words_and_no_file_names_and_nobody_else_is_asked_for_anything(site):
    for page in site.rglob("*.html"):
        text = page.read_text()
        assert re.findall(r"<a [^>]*>[^<]*\.md</a>", text) == [], page
        assert re.findall(r'<(?:script|link|img)[^>]+(?:src|href)="(https?://[^"]+)"', text) == [], page


def test_a_page_that_a_study_wrote_begins_with_its_command_and_commit(site):
    text = (site / "results" / "studies" / "procedures.html").read_text()
    before, after = text.split("<code>sysid-evo study docs/results/studies/procedures.toml</code>, commit", 1)
    assert before.rstrip().endswith("<p><em>")
    assert after.index("<h2") < after.index("<table>")


def git(folder, *words):
    """Run git in ``folder``, as somebody."""
    who = ("-c", "user.name=somebody", "-c", "user.email=somebody@example.org")
    done = subprocess.run(["git", *who, *words], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_the_line_above_a_table_counts_the_commits_since_it_was_measured(tmp_path):
    spec = importlib.util.spec_from_file_location("pages", ROOT / "docs" / "site" / "pages.py")
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)

    def written(name):
        commit = git(tmp_path, "rev-parse", "--short=9", "HEAD")
        (tmp_path / name).write_text(f"<!-- python -m measure; commit {commit}; 2026-01-31 -->\n\n| a |\n| --- |\n")
        return f"*`python -m measure`, commit {commit}, 2026-01-31, measured "

    def committed(name):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
        git(tmp_path, "add", ".")
        git(tmp_path, "commit", "--quiet", "--message", name)

    git(tmp_path, "init", "--quiet")
    committed("sysid_evo/model.py")
    old = written("old.md")
    committed("sysid_evo/task.py")
    new = written("new.md")
    committed("docs/page.md")
    built = "before this page was built"
    assert hook.origin(tmp_path / "old.md") == f"{old}2 commits {built}, 1 of which changed the program*\n\n"
    assert hook.origin(tmp_path / "new.md") == f"{new}1 commits {built}, none of which changed the program*\n\n"
    unknown = tmp_path / "unknown.md"
    unknown.write_text(f"<!-- python -m measure; commit {'0' * 9}; 2026-01-31 -->\n")
    assert hook.origin(unknown) == f"*`python -m measure`, commit {'0' * 9}, 2026-01-31*\n\n"


def test_links_to_the_firmware_lead_to_its_page(site):
    assert 'href="firmware.html"' in (site / "hardware.html").read_text()
    assert (site / "firmware.html").is_file()


def test_every_command_has_its_place_in_the_reference(site):
    page = html.unescape(re.sub(r"<[^>]+>", "", (site / "reference" / "commands.html").read_text()))
    for name in loaded().commands:
        assert f"sysid-evo {name}" in page
    assert "--leave-out" in page
    assert "compare: Fit models, evolve controllers, report prediction and transfer." in page  # in full
    assert all(name in page for name in Experiment.model_fields)


def test_every_rule_of_a_contract_stands_on_its_page(site):
    page = html.unescape((site / "reference" / "contracts.html").read_text())
    for contract in CONTRACTS.values():
        assert all(rule_of(check) in page for check in contract.checks)


def test_the_reference_of_python_describes_what_is_imported_from_the_package(site):
    page = (site / "reference" / "python.html").read_text()
    for name in ("dataset.Dataset", "base.DynamicsModel", "running.compare"):
        assert re.search(rf'id="[\w.]*{re.escape(name)}"', page), name
    assert "Return minus the simulation error" in page


@pytest.mark.nightly
def test_no_page_is_wider_than_a_telephone(site, visitor):
    """Tables and code scroll within themselves; a page that had to be pushed about sideways would be hard to read."""
    visitor.tolerated = ("search/search_index.js",)  # the search needs a server
    page, wide = visitor.page(width=PHONE), []
    for file in pages(site):
        if 'http-equiv="refresh"' in file.read_text():  # a forward from an old address
            continue
        page.goto(file.as_uri(), wait_until="domcontentloaded")
        if sideways(page):
            wide.append(file.relative_to(site).as_posix())
    assert wide == []


def test_no_page_names_a_path_of_somebody_s_machine():
    for page in [*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md"), ROOT / "CITATION.cff"]:
        assert PATHS.findall(page.read_text(encoding="utf-8")) == [], page


def test_the_version_stands_in_one_place_and_who_cites_names_it():
    cited = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert cited[1] == sysid_evo.__version__
    assert f"## {sysid_evo.__version__}" in (ROOT / "CHANGELOG.md").read_text()


def test_every_picture_of_a_run_is_shown_somewhere():
    shown = {picture(run, figure) for page in PAGES.values() for run, figure in page.pictures}
    assert set(picture("any", "any").parent.glob("*.svg")) == shown
    assert max(path.stat().st_size for path in shown) < 120_000  # bytes, so that a page is there at once


def size_of(png):
    head = png.read_bytes()[:24]
    assert head.startswith(b"\x89PNG")
    return struct.unpack(">II", head[16:])


def test_the_readme_shows_a_picture_of_the_size_that_is_taken():
    assert f"]({REPORT.relative_to(ROOT).as_posix()})" in (ROOT / README).read_text()
    assert size_of(REPORT) == SCREEN
    assert REPORT.stat().st_size < 120_000


@pytest.mark.skipif(shutil.which("chromium") is None, reason="no chromium is installed")
def test_the_first_screen_of_a_page_is_taken(tmp_path):
    page, file = tmp_path / "page.html", tmp_path / "page.png"
    page.write_text("<p style='height: 5000px'>Long</p>")
    first_screen(page, file)
    assert size_of(file) == SCREEN
