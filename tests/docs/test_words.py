"""All that users and readers of the code see is written in the words of the field."""

import pytest

from tests.docs.words import Text, code_texts, help_texts, pages


@pytest.mark.parametrize("texts", [pages, help_texts, code_texts])
def test_no_text_has_a_word_that_only_this_project_uses(texts):
    found = [
        f"{text.file}:{line}: {word!r}; say: {better}" for text in texts() for line, word, better in text.private()
    ]
    assert found == []


@pytest.mark.parametrize(
    ("text", "places"),
    [
        ("It tells\nwhat it is told.", [(5, "tells"), (6, "told")]),
        ("Run it `anew`.\n```\nstands\n```\nIt STANDS.", [(9, "STANDS")]),
        ("A free-run error.", [(5, "free-run")]),
        ("Understanding foretells nothing.", []),
    ],
)
def test_words_are_found_with_their_lines_and_code_is_left_out(text, places):
    assert [(line, word) for line, word, _ in Text("docs", "page.md", 5, text).private()] == places


def test_words_of_a_kind_or_folder_are_looked_for_there_alone(monkeypatch):
    monkeypatch.setattr("tests.docs.words.LIST", {"message": {"gate": "test"}, "hardware/": {"home": "base"}})
    assert [word for _, word, _ in Text("message", "a.py", 1, "gate home").private()] == ["gate"]
    assert [word for _, word, _ in Text("docs", "hardware/a.md", 1, "gate home").private()] == ["home"]
