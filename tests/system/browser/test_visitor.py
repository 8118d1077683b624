"""What a visit notes: errors of the page, and whatever it asks of another machine."""

import time

import pytest

from tests.fixtures.browser import PATIENCE, Visitor

ELSEWHERE = "http://elsewhere.invalid"
WRONG = {
    "console.error('so much for that')": "so much for that",
    "throw new Error('thrown')": "thrown",
    f"fetch('{ELSEWHERE}/data').catch(() => 0)": f"asked for {ELSEWHERE}/data",
    f"new Image().src = '{ELSEWHERE}/picture.png'": f"asked for {ELSEWHERE}/picture.png",
    "new WebSocket('ws://elsewhere.invalid/line')": "asked for ws://elsewhere.invalid/line",
}


def visited(browser, folder, script):
    """Return who opened a page with this script, and the page."""
    file, visitor = folder / "page.html", Visitor(browser)
    file.write_text(f"<!doctype html><title>A page</title><body><script>{script}</script>")
    return visitor, visitor.open(file)


@pytest.mark.parametrize("script", WRONG)
def test_an_error_in_a_page_and_a_word_to_another_machine_fail_the_test(browser, tmp_path, script):
    visitor, page = visited(browser, tmp_path, script)
    deadline = time.monotonic() + PATIENCE / 1e3
    while not any(WRONG[script] in fault for fault in visitor.faults) and time.monotonic() < deadline:
        page.wait_for_timeout(10.0)  # a line is reported by another process of the browser than the page's own
    with pytest.raises(AssertionError, match=r"\['"):
        visitor.check()
    with pytest.raises(AssertionError, match=r"\['"):
        visitor.leave()
    assert any(WRONG[script] in fault for fault in visitor.faults)


def test_a_page_that_keeps_to_itself_is_no_fault(browser, tmp_path):
    visitor, page = visited(browser, tmp_path, "document.body.append('all is well'); console.log('said')")
    assert page.locator("body").inner_text() == "all is well"
    visitor.leave()
