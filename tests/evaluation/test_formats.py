"""The report in other forms: every table in Markdown and LaTeX, every figure as a file."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest

from evaluation.report import Report, verdict
from evaluation.report.formats import to_latex, to_markdown, write_format
from evaluation.report.formats.latex import sheet_to_latex
from evaluation.report.formats.markdown import sheet_to_markdown
from evaluation.report.headlines import headlines
from evaluation.report.sections import sections
from evaluation.report.sheets import Sheet
from sysid_evo.errors import InvalidArgument
from tests.evaluation.known_models import Known, Sliding, fitted
from tests.evaluation.test_report import make_report

AWKWARD = Sheet("50 % of a_b", ("name", "x|y\n(m/s²)"), (("a_b & {c}", "1 ±2\n< 3"), ("#1", "–")), note="~ $5")


@pytest.fixture(scope="module")
def report() -> Report:
    return make_report({"known": fitted(Known()), "sliding": fitted(Sliding())})


def test_a_markdown_table_has_as_many_cells_in_every_row_and_escapes_what_means_something() -> None:
    lines = sheet_to_markdown(AWKWARD).splitlines()
    assert [len(re.findall(r"(?<!\\)\|", line)) for line in lines] == [3] * 4
    assert lines[0] == r"| name | x\|y (m/s²) |"
    assert lines[1] == "| :-- | --: |"
    assert lines[2] == r"| a\_b & \{c\} | 1 ±2<br>\< 3 |"


def test_a_latex_table_has_as_many_cells_in_every_row_and_escapes_what_means_something() -> None:
    text = sheet_to_latex(AWKWARD, "tab:awkward")
    rows = [line.strip() for line in text.splitlines() if line.endswith(r" \\")]
    assert [len(re.findall(r"(?<!\\)&", row)) for row in rows] == [1] * 3
    assert rows[0] == r"name & \begin{tabular}[t]{@{}r@{}}x$|$y \\ (m/s$^2$)\end{tabular} \\"
    assert rows[1] == r"a\_b \& \{c\} & \begin{tabular}[t]{@{}r@{}}1 $\pm$2 \\ $<$ 3\end{tabular} \\"
    assert rows[2] == r"\#1 & -- \\"
    assert r"\caption{50 \% of a\_b}" in text
    assert r"\textasciitilde{} \$5" in text
    assert [text.count(f"\\{what}{{tabular}}") for what in ("begin", "end")] == [3, 3]


def test_what_is_open_in_latex_is_closed_and_what_means_something_is_escaped(report: Report) -> None:
    text = to_latex(report) + sheet_to_latex(AWKWARD, "tab:awkward")
    opened: list[str] = []
    for what, name in re.findall(r"\\(begin|end)\{(\w+)\}", text):
        if what == "begin":
            opened.append(name)
        else:
            assert opened.pop() == name
    assert opened == []
    plain = "\n".join(line for line in text.splitlines() if not line.startswith("%"))
    bare = re.sub(r"\\[&%$#_{}]", "", plain)
    assert bare.count("{") == bare.count("}")
    assert bare.count("$") % 2 == 0
    outside = re.sub(r"\$[^$]*\$|\\label\{[^}]*\}", "", bare)
    assert not set(outside) & set('_^#%~"<>|')
    assert outside.isascii(), sorted({letter for letter in outside if not letter.isascii()})


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
def test_the_tables_compile_and_are_no_wider_than_the_page(report: Report, tmp_path: Path) -> None:
    (tmp_path / "report.tex").write_text(to_latex(report) + sheet_to_latex(AWKWARD, "tab:awkward"))
    (tmp_path / "paper.tex").write_text(
        "\\documentclass{article}\\usepackage[T1]{fontenc}\\usepackage{booktabs}\n"
        "\\begin{document}\\input{report}\\end{document}\n"
    )
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
    made = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60.0)
    assert made.returncode == 0, made.stdout[-2000:]
    wide = [float(points) for points in re.findall(r"Overfull \\hbox \(([\d.]+)pt too wide\)", made.stdout)]
    assert max(wide, default=0.0) < 15.0


def test_every_table_and_answer_of_the_report_is_in_both(report: Report) -> None:
    markdown, latex = to_markdown(report), to_latex(report)
    sheets = [sheet for section in sections(report) for sheet in section.sheets]
    assert len(sheets) > 10
    for sheet in sheets:
        assert sheet_to_markdown(sheet) in markdown
    assert latex.count(r"\begin{table}") == len(sheets) + 1  # and the short one
    labels = re.findall(r"\\label\{(.*)\}", latex)
    assert len(set(labels)) == len(labels)
    for finding in verdict(report):
        assert finding.question in markdown
    assert "known" in headlines(report)[0].answer


def test_the_figures_are_files_with_a_legend_and_the_markdown_shows_them(report: Report, tmp_path: Path) -> None:
    text, *figures = write_format(report, "markdown", tmp_path)
    shown = re.findall(r"!\[.*\]\((.*)\)", text.read_text())
    assert sorted(shown) == sorted(figure.relative_to(tmp_path).as_posix() for figure in figures)
    for figure in figures:
        assert ElementTree.parse(figure).getroot().tag.endswith("svg")
    curve = (tmp_path / "figures" / "horizon.svg").read_text()
    assert all(f">{name}<" in curve for name in ("persistence", "known", "sliding"))
    assert "var(--" not in curve
    assert ">measured<" in (tmp_path / "figures" / "free-run.svg").read_text()


def test_an_unknown_form_is_refused(report: Report, tmp_path: Path) -> None:
    with pytest.raises(InvalidArgument, match="markdown, latex, svg, got 'word'"):
        write_format(report, "word", tmp_path)
