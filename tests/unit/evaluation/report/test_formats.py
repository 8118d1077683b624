"""The report in its forms: every section in each, every table in Markdown, every figure as a file."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from evaluation.report import report as report_module
from evaluation.report.elements import Section, TableElement
from evaluation.report.render.html import page_of
from evaluation.report.render.markdown import sheet_to_markdown, story_to_markdown
from evaluation.report.report import sections, story_of, tables
from evaluation.report.save import write_format
from evaluation.report.sections.summary import headlines
from sysid_evo.errors import InvalidArgument
from tests.fixtures.reports import printed

AWKWARD = TableElement("50 % of a_b", ("name", "x|y\n(m/s²)"), (("a_b & {c}", "1 ±2\n< 3"), ("#1", "–")))


def test_a_markdown_table_has_as_many_cells_in_every_row_and_escapes_what_means_something():
    lines = sheet_to_markdown(AWKWARD).splitlines()
    assert [len(re.findall(r"(?<!\\)\|", line)) for line in lines] == [3] * 4
    assert lines[0] == r"| name | x\|y (m/s²) |"
    assert lines[1] == "| :-- | --: |"
    assert lines[2] == r"| a\_b & \{c\} | 1 ±2<br>\< 3 |"


def test_every_table_and_answer_of_the_report_is_in_markdown(report):
    markdown = story_to_markdown(story_of(report))
    sheets = [sheet for section in sections(report) for sheet in section.sheets]
    assert len(sheets) > 10
    for sheet in sheets:
        assert sheet_to_markdown(sheet) in markdown
    for headline in headlines(report):
        assert headline.question in markdown
    assert any("known" in headline.answer for headline in headlines(report))


def test_the_figures_are_files_with_a_legend_and_the_markdown_shows_them(report, tmp_path):
    story = story_of(replace(report, matrix=None, exploitability=()))
    text, *figures = write_format(story, "markdown", tmp_path)
    shown = re.findall(r"!\[.*\]\((.*)\)", text.read_text())
    assert sorted(shown) == sorted(figure.relative_to(tmp_path).as_posix() for figure in figures)
    for figure in figures:
        assert ElementTree.parse(figure).getroot().tag.endswith("svg")
    curve = (tmp_path / "figures" / "horizon.svg").read_text()
    assert all(f">{name}<" in curve for name in ("persistence", "known", "sliding"))
    assert "var(--" not in curve
    assert ">measured<" in (tmp_path / "figures" / "free-run.svg").read_text()


@pytest.mark.usefixtures("blank_figures")
def test_a_further_section_is_one_function_in_the_list_and_shows_in_every_form(report, monkeypatch):
    def tyres(shown):
        rows = tuple((model.name, "0.9") for model in shown.models)
        return Section(
            "Tyres", [TableElement("Wear of tyres", ("model", "wear"), rows)], absent=["No tyre was weighed."]
        )

    monkeypatch.setattr(report_module, "SECTIONS", (*report_module.SECTIONS, tyres))
    undrawn = replace(report, prediction=None, matrix=None, exploitability=())
    for text in (page_of(story_of(undrawn)), story_to_markdown(story_of(undrawn)), "\n".join(printed(tables(undrawn)))):
        assert "Wear of tyres" in text
        assert "No tyre was weighed." in text


def test_an_unknown_form_is_refused(report, tmp_path):
    with pytest.raises(InvalidArgument, match="markdown, svg, got 'word'"):
        write_format(story_of(report), "word", tmp_path)
