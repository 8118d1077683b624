"""Plots: units on every axis, drawn where asked, the same every time."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.axes import Axes

from evaluation.plot_style import new_figure, to_svg
from evaluation.plots import (
    plot_claims,
    plot_fitness,
    plot_free_run,
    plot_horizon_curve,
    plot_probes,
    plot_trace,
    plot_transfer,
)
from evaluation.report import Report
from evaluation.transfer import Trace
from sysid_evo.data import Trajectory
from sysid_evo.errors import InvalidData
from tests.fixtures.known_models import Known, Sliding, fitted
from tests.fixtures.reports import make_report


@pytest.fixture(scope="module")
def report() -> Report:
    return make_report({"known": fitted(Known()), "sliding": fitted(Sliding())})


def _draw(report: Report, on: Callable[[], Axes | None] = lambda: None) -> dict[str, Axes]:
    assert report.prediction is not None
    assert report.matrix is not None
    assert report.transfer is not None
    trace = report.matrix.cell("known_c", "known").traces[0]
    return {
        "curve": plot_horizon_curve(report.prediction, on()),
        "free run": plot_free_run(report.prediction, 2, ax=on()),
        "fitness": plot_fitness(report.matrix.champions[0], on(), unit="waypoints"),
        "claims": plot_claims(report.transfer, on(), unit="waypoints"),
        "trace": plot_trace(trace, on()),
        "transfer": plot_transfer(report.matrix, on()),
        "probes": plot_probes(report.exploitability, on()),
    }


def test_axes_carry_their_units(report: Report) -> None:
    drawn = _draw(report)
    labels = {name: (ax.get_xlabel(), ax.get_ylabel()) for name, ax in drawn.items()}
    assert labels["curve"] == ("horizon (s)", "N (standard deviations)")
    assert labels["free run"] == ("time (s)", "yaw_rate (rad/s)")
    assert labels["fitness"] == ("generation", "fitness (waypoints)")
    assert labels["claims"][0] == "fitness (waypoints)"
    assert labels["trace"] == ("x (m)", "y (m)")


def test_a_plot_is_drawn_on_the_axes_it_is_given(report: Report) -> None:
    given: list[Axes] = []

    def fresh() -> Axes:
        given.append(new_figure(4.0, 3.0).add_subplot())
        return given[-1]

    assert list(_draw(report, fresh).values()) == given


def test_the_same_plot_gives_the_same_svg(report: Report) -> None:
    one, two = (to_svg(_draw(report)["transfer"].figure) for _ in range(2))  # type: ignore[arg-type]
    assert one == two
    assert "<dc:date>" not in one


def test_traces_have_equal_axes_in_metres(report: Report) -> None:
    ax = _draw(report)["trace"]
    assert ax.get_aspect() == 1.0
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    assert right - left == pytest.approx(high - low)


def test_driving_backwards_has_its_own_colour() -> None:
    pose = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    ax = plot_trace(Trace(Trajectory(np.zeros((3, 1)), np.zeros((2, 1)), 0.1, pose), 0.0))
    forward, backward = ax.collections[0].get_colors()  # type: ignore[attr-defined]
    assert not np.allclose(forward, backward)


def test_a_trace_without_a_pose_is_refused() -> None:
    with pytest.raises(InvalidData, match="pose"):
        plot_trace(Trace(Trajectory(np.zeros((3, 1)), np.zeros((2, 1)), 0.1), 0.0))


def test_plotting_leaves_pyplot_alone(report: Report) -> None:
    _draw(report)
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or not pyplot.get_fignums()
