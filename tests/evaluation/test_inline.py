"""Drawings inside the page: their colours follow its theme, and they do not get into each other's way."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from matplotlib.figure import Figure

from evaluation.plot_style import (
    ALARM,
    BOX,
    HEAT,
    INK,
    LINK,
    MUTED,
    PAPER,
    THEME,
    Colour,
    new_figure,
    style,
    style_sheet,
)
from evaluation.plots import plot_claims, plot_fitness, plot_free_run, plot_horizon_curve, plot_trace
from evaluation.report import Report
from evaluation.report.render.svg import inline_svg
from evaluation.transfer import summarise
from tests.fixtures.known_models import Known, Sliding, fitted
from tests.fixtures.reports import make_report, matrix


@pytest.fixture(scope="module")
def report() -> Report:
    return make_report({"known": fitted(Known()), "sliding": fitted(Sliding())})


def drawn(draw: Callable[[Figure], object], key: str = "k", label: str = "a curve") -> str:
    with style():
        figure = new_figure(4.0, 3.0)
        draw(figure)
        return inline_svg(figure, key, label)


def every_plot(report: Report) -> dict[str, str]:
    assert report.prediction is not None
    assert report.matrix is not None
    prediction, transfer = report.prediction, report.matrix
    trace = transfer.cell("known_c", "known").traces[0]
    several = summarise(matrix({"a": {"a": 9.0, "b": 8.0, "car": 5.0}}, robot="car", seeds=(8.0, 9.0)))
    return {
        "curve": drawn(lambda figure: plot_horizon_curve(prediction, figure.add_subplot()), "curve"),
        "free run": drawn(lambda figure: plot_free_run(prediction, 0, ax=figure.add_subplot()), "free"),
        "fitness": drawn(lambda figure: plot_fitness(transfer.champions[0], figure.add_subplot()), "fitness"),
        "trace": drawn(lambda figure: plot_trace(trace, figure.add_subplot()), "trace"),
        "claims": drawn(lambda figure: plot_claims(several, figure.add_subplot()), "claims"),
    }


def test_every_colour_of_a_plot_is_one_of_the_theme(report: Report) -> None:
    for name, svg in every_plot(report).items():
        assert not re.findall(r"(?:fill|stroke): (?!none|var\(--)[^;\"]+", svg), name
        assert "var(--ink)" in svg


def test_the_theme_has_a_light_and_a_dark_form_of_every_colour_and_paper_gets_the_light_one() -> None:
    light, dark = style_sheet().split("@media screen and (prefers-color-scheme: dark)")
    for colour in THEME:
        assert f"--{colour.name}: {colour.light};" in light
        assert f"--{colour.name}: {colour.dark};" in dark
    assert len({colour.light for colour in THEME}) == len(THEME)


def contrast(first: str, second: str) -> float:
    """The contrast ratio of WCAG 2, section 1.4.3."""

    def luminance(colour: str) -> float:
        shares = [int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]
        linear = [share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4 for share in shares]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    low, high = sorted((luminance(first), luminance(second)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize(
    "text, behind", [(INK, PAPER), (INK, BOX), (INK, HEAT), (INK, ALARM), (MUTED, PAPER), (LINK, PAPER)]
)
def test_text_can_be_read_on_what_stands_behind_it(text: Colour, behind: Colour) -> None:
    assert contrast(text.light, behind.light) >= 4.5
    assert contrast(text.dark, behind.dark) >= 4.5


def test_ids_differ_between_drawings_and_are_found_within_each(report: Report) -> None:
    seen: set[str] = set()
    for svg in every_plot(report).values():
        ids = re.findall(r' id="([^"]+)"', svg)
        assert len(ids) == len(set(ids))
        assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', svg)) == set(ids)
        assert not seen & set(ids)
        seen |= set(ids)


def test_coordinates_are_rounded_and_labels_are_not() -> None:
    def draw(figure: Figure) -> None:
        ax = figure.add_subplot()
        ax.plot([0.0, 1.0], [0.0, 1.0 / 3.0])
        ax.set_title("0.123456 <of> it")

    svg = drawn(draw, label='say "it" & <go>')
    assert "0.123456 &lt;of&gt; it" in svg
    assert 'aria-label="say &quot;it&quot; &amp; &lt;go&gt;"' in svg
    assert not any(re.search(r"\.\d{3}", path) for path in re.findall(r' d="([^"]*)"', svg))


def test_a_drawing_is_an_element_of_the_page_and_as_wide_as_its_place(report: Report) -> None:
    for svg in every_plot(report).values():
        assert re.match(r'<svg viewBox="0 0 [\d.]+ [\d.]+" role="img" aria-label="[^"]+">', svg)
        assert svg.endswith("</svg>")
        assert "<style" not in svg
        assert "DejaVu" not in svg
