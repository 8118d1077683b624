"""The whole chain on systems that go nowhere: a recorded pendulum and a heated block, to the last table."""

import json
from dataclasses import replace

import numpy as np
import pytest

from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison
from evaluation.report.render.svg import drawn
from evaluation.report.report import to_json
from evaluation.report.sections.controllers import drive_command
from evaluation.report.sections.replay import traces_picture
from evaluation.report.sections.transfer import further_measures_table
from evaluation.running import gather_results, report_of
from sysid_evo.plan import Store, execute
from tests.fixtures.session import without_figures

SHORT = {
    "models": ("linear", "narx"), "minutes": 0.5, "generations": 1, "trials": 2, "selection_trials": 2,
    "transfer_trials": 3, "traces": 1, "ensembles": (), "strategy": "mu_plus_lambda(parents=2, children=2)",
    "reference": False, "procedure": "plain",
}  # fmt: skip


@pytest.fixture(scope="module", params=["pendulum swing_up(horizon=40)", "thermal set_point(horizon=40)"])
@without_figures()
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
    assert all(np.isfinite(cell.mean) for cell in found.matrix.cells.values())
    assert len(found.exploitability) == 2
    page = (folder / "report.html").read_text()
    assert "Other measures of the task" in page
    assert "grey: their targets with the tolerance" in page


def test_the_states_are_drawn_and_what_the_task_tells_is_in_a_table(report):
    found, _ = report
    picture, sheet = traces_picture(found.matrix), further_measures_table(found.matrix)
    assert len(picture.panels) == 6  # two by the controller evolved in each, one at rest, one at random
    assert found.data.system.states[0].name in drawn(picture.panels[0]).wide
    assert sheet.columns[2:] == ("settled\n(%\nof\ntrials)", "settling\ntime\n(s)", "overshoot\n(%)")
    assert len(sheet.rows) == 6  # two controllers in two systems, rest and random commands


def test_what_was_computed_is_found_again_as_it_was(report):
    found, folder = report
    comparison = plan_comparison(Experiment.of(found.settings))
    again = gather_results(comparison, Store(folder))
    assert json.dumps(to_json(again)["transfer"]) == json.dumps(to_json(found)["transfer"])
    trace = again.matrix.cell("linear", "linear").traces[0]
    assert trace.targets[0].channel == found.data.system.states[0]


def test_a_command_drives_the_robot_and_none_is_given_where_there_are_only_recordings(report):
    found, _ = report
    robot = found.settings["robot"]
    assert (drive_command(found, "linear") or "").endswith(f" --robot {robot}")
    recordings = {name: value for name, value in found.settings.items() if name != "robot"}
    assert drive_command(replace(found, settings=recordings), "linear") is None
