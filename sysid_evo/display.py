"""Display of data, models and results: a short line in a terminal, a small table in a notebook."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from html import escape

NAMES = 8
"""Largest number of names of a list to show."""
LONGEST = 90
"""Largest number of characters of one fact in a line; tables in a notebook show all."""


class Displayed:
    """Base class of objects that are displayed by their ``facts``, short texts by name."""

    @abstractmethod
    def facts(self) -> Mapping[str, str]:
        """Return a summary as texts by name; it must be fast, without computations over arrays."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({line_of(self.facts())})"

    def _repr_html_(self) -> str:
        return html_table(type(self).__name__, self.facts())


def line_of(facts: Mapping[str, str]) -> str:
    """Return ``facts`` in a line."""
    short = {name: text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..." for name, text in facts.items()}
    return ", ".join(f"{name}: {text}" for name, text in short.items())


def listed(names: Iterable[object]) -> str:
    """Return ``names`` separated by commas; of many names, the first ones and the total number."""
    found = list(map(str, names))
    more = f", ... ({len(found)} in all)" if len(found) > NAMES else ""
    return ", ".join(found[:NAMES]) + more or "none"


def html_table(title: str, facts: Mapping[str, str]) -> str:
    """Return a table of two columns as HTML, its texts escaped."""
    left = 'style="text-align: left"'  # notebooks align cells to the right
    cells = [(escape(name), escape(text).replace("\n", "<br>")) for name, text in facts.items()]
    rows = "".join(f"<tr><th {left}>{name}</th><td {left}>{text}</td></tr>" for name, text in cells)
    return f"<table><caption {left}><strong>{escape(title)}</strong></caption>{rows}</table>"
