"""What a visit notes: errors of the page, and whatever it asks of another machine."""

import time

import pytest

from tests.fixtures.browser import PATIENCE, Visitor

ELSEWHERE = "http://elsewhere.invalid"
WRONG = {
    "console.error('so much for that')": "so much for that",
    f"fetch('{ELSEWHERE}/data').catch(() => 0)": f"asked for {ELSEWHERE}/data",
    f"new Image().src = '{ELSEWHERE}/picture.png'": f"asked for {ELSEWHERE}/picture.png",
    "new WebSocket('ws://elsewhere.invalid/line')": "asked for ws://elsewhere.invalid/line",
    "throw new Error('thrown')": "thrown",
}


def test_an_error_in_a_page_and_a_word_to_another_machine_fail_the_test(browser, tmp_path):
    file, visitor = tmp_path / "page.html", Visitor(browser)
    file.write_text(f"<!doctype html><title>A page</title><body><script>{'; '.join(WRONG)}</script>")
    page, deadline = visitor.open(file), time.monotonic() + PATIENCE / 1e3
    while not all(any(text in fault for fault in visitor.faults) for text in WRONG.values()):
        assert time.monotonic() < deadline, visitor.faults
        page.wait_for_timeout(10.0)  # a line is reported by another process of the browser than the page's own
    with pytest.raises(AssertionError, match=r"\['"):
        visitor.leave()
