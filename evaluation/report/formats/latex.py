"""Every table of the report in LaTeX, for ``\\input`` into a paper."""

from __future__ import annotations

import re
from collections.abc import Sequence

from evaluation.report.contents import Report
from evaluation.report.sheets import Sheet
from evaluation.report.story import Story

HEAD = "% Every table of {title}. In the preamble: \\usepackage{{booktabs, makecell}}"
ESCAPED = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "±": r"$\pm$",
    "→": r"$\rightarrow$",
    "×": r"$\times$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "²": r"$^2$",
    "³": r"$^3$",
    "°": r"$^\circ$",
    "−": r"$-$",
    "–": "--",
    "<": r"$<$",
    ">": r"$>$",
    "|": r"$|$",
    '"': r"{\textquotedbl}",
    **{letter: f"\\{letter}" for letter in "&%$#_{}"},
}
PROSE = "p{0.6\\linewidth}"


def to_latex(report: Report) -> str:
    """Return all tables, each a ``table`` with its title as caption and its note below."""
    tables = [sheet_to_latex(sheet, f"tab:{place}-{_slug(sheet)}") for place, sheet in Story.of(report).sheets]
    return "\n\n".join([HEAD.format(title=" ".join(report.title.split())), *tables]) + "\n"


def sheet_to_latex(sheet: Sheet, label: str) -> str:
    """Return one table; cells of several lines need the package makecell."""
    text = sheet.prose or sheet.code
    others = ["l"] * (len(sheet.columns) - 2) + [PROSE] if text else ["r"] * (len(sheet.columns) - 1)
    side = "l" if text else "r"
    heads = [_cell(head, "l" if place == 0 else side) for place, head in enumerate(sheet.columns)]
    rows = [[_cell(text, "l" if place == 0 else side) for place, text in enumerate(row)] for row in sheet.rows]
    return "\n".join(
        [
            r"\begin{table}",
            r"  \centering",
            rf"  \caption{{{_text(sheet.title)}}}",
            rf"  \label{{{label}}}",
            rf"  \begin{{tabular}}{{{''.join(['l', *others])}}}",
            r"    \toprule",
            f"    {_row(heads)}",
            r"    \midrule",
            *(f"    {_row(row)}" for row in rows),
            r"    \bottomrule",
            r"  \end{tabular}",
            *([rf"  \par\smallskip\footnotesize {_text(sheet.note)}"] if sheet.note else []),
            r"\end{table}",
        ]
    )


def _row(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"


def _slug(sheet: Sheet) -> str:
    words = re.findall(r"[a-z0-9]+", sheet.title.lower())
    return "-".join(words[:5])


def _cell(text: str, side: str) -> str:
    lines = r" \\ ".join(_text(line) for line in text.split("\n"))
    return rf"\makecell[t{side}]{{{lines}}}" if "\n" in text else lines


def _text(text: str) -> str:
    return "".join(ESCAPED.get(letter, letter) for letter in text)
