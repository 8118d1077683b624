"""The whole chain on systems that go nowhere: a recorded pendulum and a heated block, to the last table."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison
from evaluation.plots import plot_state, plotted_places
from evaluation.report import save_report, to_json
from evaluation.report.render.svg import drawn
from evaluation.report.sections.controllers import drive_command
from evaluation.report.sections.replay import traces_picture
from evaluation.report.sections.transfer import measure_sheet
from evaluation.running import report_of
from evaluation.transfer import Trace
from sysid_evo.data import Trajectory
from sysid_evo.plan import Store, execute
from sysid_evo.system import Channel
from sysid_evo.tasks import Target
from sysid_evo.testing.examples import pendulum

SHORT: dict[str, Any] = {
    "models": ("linear", "narx"), "minutes": 0.5, "generations": 2, "trials": 2, "selection_trials": 2,
    "transfer_trials": 3, "traces": 1, "ensembles": (), "strategy": "mu_plus_lambda(children=5)",
    "yardstick": False, "recipe": "plain",
}  # fmt: skip


@pytest.fixture(scope="module", params=["pendulum swing_up(horizon=40)", "thermal set_point(horizon=40)"])
def report(request, tmp_path_factory):
    robot, task = request.param.split(" ")
    folder = tmp_path_factory.mktemp(robot)
    comparison = plan_comparison(Experiment(robot=robot, task=task, **SHORT))
    store = Store(folder)
    execute(comparison.plan, store)
    return report_of(comparison, store), folder


def test_every_part_of_the_report_is_there(report):
    found, folder = report
    assert found.all_failures == ()
    assert found.matrix is not None
    assert np.isfinite(found.matrix.means()).all()
    assert len(found.exploitability) == 2
    save_report(found, folder)
    page = (folder / "report.html").read_text()
    assert "What else was measured" in page
    assert "grey: what they were to do" in page


def test_the_states_are_drawn_and_what_the_task_tells_is_in_a_table(report):
    found, _ = report
    assert found.matrix is not None
    picture, sheet = traces_picture(found.matrix), measure_sheet(found.matrix)
    assert picture is not None
    assert len(picture.panels) == 5  # two by the controller evolved in each, one at rest
    assert found.data.system.states[0].name in drawn(picture.panels[0]).wide
    assert sheet is not None
    assert sheet.columns[2:] == ("settled\n(%\nof\ntrials)", "settling\ntime\n(s)", "overshoot\n(%)")
    assert len(sheet.rows) == 5  # two controllers in two systems, and rest


def test_what_was_computed_is_found_again_as_it_was(report):
    found, folder = report
    comparison = plan_comparison(Experiment.of(found.settings))
    again = report_of(comparison, Store(folder))
    assert json.dumps(to_json(again)["transfer"]) == json.dumps(to_json(found)["transfer"])
    assert again.matrix is not None
    trace = again.matrix.cell("linear", "linear").traces[0]
    assert trace.targets[0].channel == found.data.system.states[0]


def test_a_command_drives_the_robot_and_none_is_given_where_there_are_only_recordings(report):
    found, _ = report
    robot = found.settings["robot"]
    assert (drive_command(found, "linear") or "").endswith(f" --robot {robot}")
    recordings = {name: value for name, value in found.settings.items() if name != "robot"}
    assert drive_command(replace(found, settings=recordings), "linear") is None


def test_an_angle_is_drawn_beside_its_target_and_its_line_breaks_where_it_jumps():
    system = pendulum()
    states = np.array([[0.1, 0.0], [2.0, 0.0], [4.0, 0.0], [7.0, 0.0]])
    target = Target(Channel("angle", "rad", period=2 * np.pi), 0, np.array([np.pi]), 0.5)
    trace = Trace(Trajectory(states, np.zeros((3, 1)), 0.02), 1.0, targets=(target,))
    assert plotted_places(trace, system) == (0,)
    wanted, drawn = plot_state(trace, system, 0).get_lines()
    np.testing.assert_array_equal(wanted.get_ydata(), np.pi)
    np.testing.assert_allclose(drawn.get_ydata(), [0.1, 2.0, 4.0, np.nan], atol=1e-12)
    assert plotted_places(Trace(trace.trajectory, 1.0), system) == (0, 1)
