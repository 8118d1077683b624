"""Every table of the report in LaTeX, for ``\\input`` into a paper."""

from __future__ import annotations

import re
from collections.abc import Sequence

from evaluation.labels import folded
from evaluation.report.contents import Report
from evaluation.report.sheets import Sheet
from evaluation.report.story import Story

HEAD = "% Every table of {title}. In the preamble: \\usepackage{{booktabs}}"
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
PROSE = r"p{{{:.2f}\linewidth}}"
SIZES = ((52, ""), (58, r"\small"), (66, r"\footnotesize"), (77, r"\scriptsize"))
"""How many letters, with gaps, go into a line of an article in which size of type; the smallest one is for the rest."""
SMALLEST = r"\tiny"
CLOSE = r"\setlength{\tabcolsep}{3pt}"
GAP = 2.0
"""Letters between two columns, closer together where the type is small."""
LONG, BREAK = re.compile(r"\S{17,}"), r"\allowbreak{}"
"""In text, words so long may be broken where a part of them ends, a digest anywhere."""
NAME = 24
"""Letters of a name in one line of the first column."""


def to_latex(report: Report) -> str:
    """Return all tables, each a ``table`` with its title as caption and its note below."""
    return story_to_latex(Story.of(report))


def story_to_latex(story: Story) -> str:
    """Return all tables of a story."""
    tables = [sheet_to_latex(sheet, f"tab:{place}-{_slug(sheet)}") for place, sheet in story.sheets]
    return "\n\n".join([HEAD.format(title=" ".join(story.title.split())), *tables]) + "\n"


def sheet_to_latex(sheet: Sheet, label: str) -> str:
    """Return one table as a float."""
    text, columns = sheet.prose or sheet.code, len(sheet.columns) - 1
    others = [PROSE.format(0.64 / columns)] * columns if text else ["r"] * columns
    heads = [_cell(head, "l" if text or place == 0 else "r") for place, head in enumerate(sheet.columns)]
    rows = [
        [_cell(name, "l"), *(_prose(cell) if text else _cell(cell, "r") for cell in cells)]
        for name, *cells in map(_named, sheet.rows)
    ]
    return "\n".join(
        [
            r"\begin{table}",
            r"  \centering",
            rf"  \caption{{{_text(sheet.title)}}}",
            rf"  \label{{{label}}}",
            *([f"  {size}{CLOSE}"] if (size := _size(sheet)) else []),
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


def _size(sheet: Sheet) -> str:
    """Return the size of type in which a table is as wide as a line of text at most, empty for the usual one."""
    if sheet.prose or sheet.code:
        return SIZES[2][1]
    columns = zip(sheet.columns, *map(_named, sheet.rows), strict=True)
    letters = sum(max(len(line) for cell in column for line in cell.split("\n")) + GAP for column in columns)
    return next((size for most, size in SIZES if letters <= most), SMALLEST)


def _named(row: Sequence[str]) -> tuple[str, ...]:
    """Return a row whose name is folded."""
    return "\n".join(folded(line, NAME) for line in row[0].split("\n")), *row[1:]


def _row(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"


def _slug(sheet: Sheet) -> str:
    words = re.findall(r"[a-z0-9]+", sheet.title.lower())
    return "-".join(words[:5])


def _cell(text: str, side: str) -> str:
    """Return one cell; several lines stand below each other, aligned to their ``side``."""
    lines = [_text(line) for line in text.split("\n")]
    if len(lines) == 1:
        return lines[0]
    below = r" \\ ".join(lines)
    return rf"\begin{{tabular}}[t]{{@{{}}{side}@{{}}}}{below}\end{{tabular}}"


def _prose(text: str) -> str:
    """Return a cell that is broken into lines where it is full, as the long names of files must be."""
    found, end = [], 0
    for long in LONG.finditer(text):
        parts = re.findall(r"[^/_.+=,-]{1,16}[/_.+=,-]*|[/_.+=,-]+", long.group())
        found += [_text(text[end : long.start()]), BREAK.join(map(_text, parts))]
        end = long.end()
    return "".join([*found, _text(text[end:])])


def _text(text: str) -> str:
    return "".join(ESCAPED.get(letter, letter) for letter in text)
