"""Writes a report into a folder."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from evaluation.report.contents import Report
from evaluation.report.document import to_json
from sysid_evo.files import write_atomically
from sysid_evo.store.manifest import versions

DOCUMENT, PAGE = "report.json", "report.html"
EVALUATION = Path(__file__).parents[1]
"""The package whose sources decide how a page looks."""


def save_report(
    report: Report, folder: str | Path, *, of: str | None = None, afresh: bool = False
) -> tuple[Path, Path]:
    """Write ``report.json`` and ``report.html`` into ``folder`` and return their paths.

    ``of`` is a digest of all results that the report shows. With it a page is not drawn again that is there already,
    made of the same results by the same program, unless that is wanted ``afresh``.
    """
    folder = Path(folder)
    text = json.dumps(to_json(report), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    document = write_atomically(folder / DOCUMENT, lambda file: file.write_text(text, encoding="utf-8"))
    mark = "" if of is None else _mark(of, text)
    if afresh or not mark or _end(folder / PAGE, len(mark)) != mark:
        from evaluation.report.page import to_html  # brings matplotlib, for which no mistake should wait

        page = to_html(report) + mark
        write_atomically(folder / PAGE, lambda file: file.write_text(page, encoding="utf-8"))
    return document, folder / PAGE


def _mark(of: str, text: str) -> str:
    """Return the last line of a page: what it was made of, and by which program."""
    made_of = hashlib.sha256(json.dumps([of, text, versions()]).encode())
    for file in sorted(EVALUATION.rglob("*")):
        if file.suffix in (".py", ".j2", ".js", ".css"):
            made_of.update(file.read_bytes())
    return f"\n<!-- made of {made_of.hexdigest()} -->\n"


def _end(file: Path, length: int) -> str:
    """Return the last ``length`` bytes of a file as text, nothing if there is none."""
    try:
        with file.open("rb") as stream:
            stream.seek(max(0, file.stat().st_size - length))
            return stream.read().decode(errors="replace")
    except OSError:
        return ""
