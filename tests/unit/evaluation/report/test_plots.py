"""Plots: units on every axis, drawn where asked; inside the page they follow its theme and keep apart."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest

from evaluation.plot_style import (
    ALARM,
    BOX,
    HEAT,
    INK,
    LINK,
    MUTED,
    PAPER,
    THEME,
    new_figure,
    style,
    style_sheet,
    to_svg,
)
from evaluation.plots import (
    plot_claimed_measured,
    plot_fitness,
    plot_free_run,
    plot_horizon_curve,
    plot_spreads,
    plot_trace,
)
from evaluation.report.render.svg import inline_svg
from evaluation.transfer.matrix import Trace
from sysid_evo.data import Trajectory
from sysid_evo.errors import InvalidData
from sysid_evo.validation.estimates import Estimate


def claiming(report):
    return [one for one in report.transfer.controllers if one.claimed and one.elsewhere]


def axes():
    return new_figure(4.0, 3.0).add_subplot()


def draw(report, on=axes):
    trace = report.matrix.cell("known_c", "known").traces[0]
    return {
        "curve": plot_horizon_curve(report.prediction, on()),
        "free run": plot_free_run(report.prediction, 2, on(), models=report.prediction.names),
        "fitness": plot_fitness(report.matrix.champions[0], on(), unit="waypoints"),
        "claims": plot_claimed_measured(claiming(report), on(), unit="waypoints", label="measured (waypoints)"),
        "trace": plot_trace(trace, on()),
        "spreads": plot_spreads({"one": {"a": (1.0, 0.9, 1.2)}}, on(), label="share"),
    }


@pytest.fixture(scope="module")
def drawn(report):
    """Every plot on axes of its own."""
    return draw(report)


def test_axes_carry_their_units(drawn):
    labels = {name: (ax.get_xlabel(), ax.get_ylabel()) for name, ax in drawn.items()}
    assert labels["curve"] == ("horizon (s)", "N (standard deviations)")
    assert labels["free run"] == ("time (s)", "yaw_rate (rad/s)")
    assert labels["fitness"] == ("generation", "fitness (waypoints)")
    assert labels["claims"] == ("claimed (waypoints)", "measured (waypoints)")
    assert labels["trace"] == ("x (m)", "y (m)")


def test_a_plot_is_drawn_on_the_axes_it_is_given_and_leaves_pyplot_alone(report):
    given = []

    def fresh():
        given.append(axes())
        return given[-1]

    assert list(draw(report, fresh).values()) == given
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or not pyplot.get_fignums()


def test_the_same_plot_gives_the_same_svg(report):
    one, two = (to_svg(plot_horizon_curve(report.prediction, axes()).figure) for _ in range(2))
    assert one == two
    assert "<dc:date>" not in one


def test_traces_have_equal_axes_in_metres(drawn):
    ax = drawn["trace"]
    assert ax.get_aspect() == 1.0
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    assert right - left == pytest.approx(high - low)


def test_driving_backwards_has_its_own_colour():
    pose = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    ax = plot_trace(Trace(Trajectory(np.zeros((3, 1)), np.zeros((2, 1)), 0.1, pose), 0.0), axes())
    forward, backward = ax.collections[0].get_colors()
    assert not np.allclose(forward, backward)


def test_a_trace_without_a_pose_is_refused():
    with pytest.raises(InvalidData, match="pose"):
        plot_trace(Trace(Trajectory(np.zeros((3, 1)), np.zeros((2, 1)), 0.1), 0.0), axes())


def inside(plot, key="k", label="a curve"):
    with style():
        figure = new_figure(4.0, 3.0)
        plot(figure.add_subplot())
        return inline_svg(figure, key, label)


@pytest.fixture(scope="module")
def inline(report):
    """Drawings of the page by name."""
    trace = report.matrix.cell("known_c", "known").traces[0]
    return {
        "curve": inside(lambda ax: plot_horizon_curve(report.prediction, ax), "curve"),
        "free run": inside(lambda ax: plot_free_run(report.prediction, 0, ax, models=["known"]), "free"),
        "fitness": inside(lambda ax: plot_fitness(report.matrix.champions[0], ax), "fitness"),
        "trace": inside(lambda ax: plot_trace(trace, ax), "trace"),
        "claims": inside(lambda ax: plot_claimed_measured(claiming(report), ax, label="measured"), "claims"),
    }


def test_a_drawing_is_an_element_of_the_page_in_its_fonts_and_the_colours_of_its_theme(inline):
    for name, svg in inline.items():
        assert not re.findall(r"(?:fill|stroke): (?!none|var\(--)[^;\"]+", svg), name
        assert "var(--ink)" in svg
        assert re.match(r'<svg viewBox="0 0 [\d.]+ [\d.]+" role="img" aria-label="[^"]+">', svg)
        assert svg.endswith("</svg>")
        assert "<style" not in svg
        assert "DejaVu" not in svg


@pytest.mark.parametrize(("width", "height"), [(3.55, 2.9), (5.6, 4.0)], ids=["phone", "desk"])
def test_a_long_label_of_claimed_against_measured_breaks_before_it_leaves_the_drawing(report, width, height):
    """Large values have wide tick labels, which take room from the axes."""
    far = [replace(one, claimed=Estimate(-12345.6, 1.0), achieved=Estimate(-9876.5, 1.0)) for one in claiming(report)]
    unit = "reward per second of the episode, mean"
    with style():
        figure = new_figure(width, height)
        ax = plot_claimed_measured(far, figure.add_subplot(), unit=unit, label=f"measured on my_robot:17 ({unit})")
        figure.draw_without_rendering()
        page = figure.bbox.padded(1.0)  # pixels
        for artist in (ax.xaxis.label, ax.yaxis.label, *ax.texts):
            box = artist.get_window_extent()
            assert page.x0 <= box.x0 <= box.x1 <= page.x1, artist
            assert page.y0 <= box.y0 <= box.y1 <= page.y1, artist


def test_ids_differ_between_drawings_and_are_found_within_each(inline):
    seen = set()
    for svg in inline.values():
        ids = re.findall(r' id="([^"]+)"', svg)
        assert len(ids) == len(set(ids))
        assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', svg)) == set(ids)
        assert not seen & set(ids)
        seen |= set(ids)


def test_coordinates_are_rounded_and_labels_are_not():
    def plot(ax):
        ax.plot([0.0, 1.0], [0.0, 1.0 / 3.0])
        ax.set_title("0.123456 <of> it")

    svg = inside(plot, label='say "it" & <go>')
    assert "0.123456 &lt;of&gt; it" in svg
    assert 'aria-label="say &quot;it&quot; &amp; &lt;go&gt;"' in svg
    assert not any(re.search(r"\.\d{3}", path) for path in re.findall(r' d="([^"]*)"', svg))


def test_the_theme_has_a_light_and_a_dark_form_of_every_colour_and_paper_gets_the_light_one():
    light, dark = style_sheet().split("@media screen and (prefers-color-scheme: dark)")
    for colour in THEME:
        assert f"--{colour.name}: {colour.light};" in light
        assert f"--{colour.name}: {colour.dark};" in dark
    assert len({colour.light for colour in THEME}) == len(THEME)


def contrast(first, second):
    """The contrast ratio of WCAG 2, section 1.4.3."""

    def luminance(colour):
        shares = [int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]
        linear = [share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4 for share in shares]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    low, high = sorted((luminance(first), luminance(second)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize(
    "text, behind", [(INK, PAPER), (INK, BOX), (INK, HEAT), (INK, ALARM), (MUTED, PAPER), (LINK, PAPER)]
)
def test_text_can_be_read_on_what_stands_behind_it(text, behind):
    assert contrast(text.light, behind.light) >= 4.5
    assert contrast(text.dark, behind.dark) >= 4.5
