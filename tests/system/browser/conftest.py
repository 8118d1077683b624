"""The page of the session's report, opened once for the tests of a module that leave it as it was."""

import pytest

from tests.fixtures.browser import DESK, Visitor, resize


@pytest.fixture(scope="module")
def opened(browser, report_page):
    visitor = Visitor(browser)
    yield visitor, visitor.open(report_page)
    visitor.leave()


@pytest.fixture
def page(opened):
    """The page on a desk, in the light, on a screen."""
    visitor, page = opened
    resize(page, DESK)
    page.emulate_media(color_scheme="light", media="screen")
    page.mouse.move(0, 0)
    yield page
    visitor.check()
