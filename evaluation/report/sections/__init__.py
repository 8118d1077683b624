"""The sections of a report, in the order in which they are read; a further one is a module and a line here."""

from __future__ import annotations

from evaluation.report.elements import Section

__all__ = [
    "Section",
]
