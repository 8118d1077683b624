"""How data, models and results show themselves: a short line in a terminal, a small table in a notebook."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from html import escape

NAMES = 8
"""Names of a list that are shown."""
LONGEST = 90
"""Characters of one fact in a line; a table in a notebook has room for all."""


class Displayed:
    """Something with ``facts``, short texts by name, which are all that is shown of it."""

    @abstractmethod
    def facts(self) -> Mapping[str, str]:
        """Return what there is to know at a glance, quickly: no array is gone through."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({line_of(self.facts())})"

    def _repr_html_(self) -> str:
        return html_table(type(self).__name__, self.facts())


def line_of(facts: Mapping[str, str]) -> str:
    """Return ``facts`` in a line."""
    short = {name: text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..." for name, text in facts.items()}
    return ", ".join(f"{name}: {text}" for name, text in short.items())


def listed(names: Iterable[object]) -> str:
    """Return ``names`` with commas, of many the first ones and how many there are."""
    found = list(map(str, names))
    more = f", ... ({len(found)} in all)" if len(found) > NAMES else ""
    return ", ".join(found[:NAMES]) + more or "none"


def html_table(title: str, facts: Mapping[str, str]) -> str:
    """Return a table of two columns as HTML, its texts escaped."""
    left = 'style="text-align: left"'  # notebooks set it to the right, as numbers
    cells = [(escape(name), escape(text).replace("\n", "<br>")) for name, text in facts.items()]
    rows = "".join(f"<tr><th {left}>{name}</th><td {left}>{text}</td></tr>" for name, text in cells)
    return f"<table><caption {left}><strong>{escape(title)}</strong></caption>{rows}</table>"
