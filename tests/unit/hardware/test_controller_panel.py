"""What the page is told of a controller that drives: traces for every task, as they happened."""

import json
import re

import numpy as np
import pytest

from hardware.driving.controller_driving import ControllerPanel, play, playback_speed, readings, shown_of
from hardware.driving.page_messages import Phase, as_text, messages_script
from hardware.driving.server import PAGE
from hardware.driving.trials import RobotRunner
from hardware.robot import find_robot
from hardware.run_report import StopReason, StopRequest
from sysid_evo.controllers.controller import make_controller
from sysid_evo.tasks.task import make_task
from tests.fixtures.panels import SEEDS, simulated
from tests.fixtures.robots import ManualClock

SWING_UP = "swing_up(horizon=30)", "pendulum"
CASES = [
    ("set_point(channels=temperature, horizon=30)", "thermal"),
    ("track_reference(channels=[angle, angular_speed], horizon=30)", "pendulum"),
    SWING_UP,
    ("balance(horizon=30)", "cart_pole"),
    ("environment(id='CartPole-v1', horizon=30)", "gymnasium(id='CartPole-v1')"),
    ("walled_track(horizon=30)", "emulated_car"),
    ("point_to_point(horizon=30)", "emulated_car"),
    ("set_point(channels=forward_speed, horizon=30)", "emulated_car"),
]


IN_JAVASCRIPT = {bool: "boolean", int: "number", float: "number", str: "string", list: "array", type(None): "null"}


TABLE = json.loads(messages_script().removeprefix("export const MESSAGES = ").removesuffix(";\n"))


def as_sent(message):
    """Return a message as it comes to the page, which takes it."""
    said = json.loads(as_text(message))
    assert said.keys() == {"type", *TABLE[said["type"]]}
    assert all(IN_JAVASCRIPT[type(said[name])] in kinds for name, kinds in TABLE[said["type"]].items())
    return said


def test_the_page_reads_every_field_that_it_is_sent_and_no_other():
    scripts = "".join(path.read_text() for path in PAGE.glob("*.js"))
    for kind, called in (("setting", "setting"), ("scenery", "scenery"), ("reading", "(?:reading|message)")):
        read = re.findall(rf"\b{called}\??\.(\w+)", scripts)
        taken = re.findall(rf"const {{ ([^}}]+) }} = (?:this\.|view\.)?{called}\b", scripts)
        names = {*read, *(part.split(":")[0] for some in taken for part in some.split(", "))}
        assert names - {"type"} == TABLE[kind].keys()
    (said,) = re.findall(r"message = {(.+)};", scripts)
    assert re.findall(r"(\w+)(?=: )", re.sub(r"\?[^,]+", "", said)) == ["type", *TABLE["keys"]]


@pytest.mark.parametrize(("spec", "robot"), CASES)
def test_a_trial_played_back_ends_with_its_score_and_shows_what_the_task_wanted(spec, robot):
    task, rollouts = simulated(spec, robot)
    panel = ControllerPanel("robot", task, "best")
    setting = as_sent(panel.setting())
    assert setting["controller"] == "best"
    for trial, trajectory in enumerate(rollouts.trajectories):
        shown = readings(task, SEEDS[trial : trial + 1], trajectory, trial + 1)
        assert [reading.step for reading in shown] == list(range(len(trajectory.states)))
        assert shown[-1].score == pytest.approx(rollouts.fitness[0, trial], rel=1e-4, abs=1e-4)
        wanted = task.scene(task.begin(SEEDS[trial : trial + 1]), 0)
        panel.show(shown[len(shown) // 2], wanted)
        scenery, reading = as_sent(panel.scenery()), as_sent(panel.reading())
        assert all(task.system.state_names[trace["place"]] == trace["name"] for trace in setting["traces"])
        assert reading["state"] == pytest.approx(trajectory.states[len(shown) // 2])
        assert (reading["phase"], reading["trial"]) == ("driving", trial + 1)
        led = {target["place"]: target["values"] for target in scenery["targets"]}
        assert led == {target.place: pytest.approx(target.values) for target in wanted.targets}
        assert not led or list(led) == [trace["place"] for trace in setting["traces"]]
        assert len(scenery["walls"]) == len(wanted.walls)
    assert setting["top_view"] == (robot == "emulated_car")
    assert bool(setting["traces"]) == (spec.split("(")[0] not in ("walled_track", "point_to_point"))


def test_trials_are_played_in_the_time_they_took_and_those_of_a_slow_process_faster():
    task, rollouts = simulated(*SWING_UP)
    panel, watch = ControllerPanel("pendulum", task, "best"), ManualClock()
    shown = []
    panel.show = lambda reading, scene: shown.append((watch.now, reading))
    play(
        panel,
        task,
        SEEDS,
        rollouts.trajectories,
        rollouts.fitness[0],
        stop=StopRequest(),
        clock=watch,
        sleep=watch.sleep,
    )
    assert len(shown) == 2 * 32
    assert [reading.trial for _, reading in shown] == [1] * 32 + [2] * 32
    assert shown[31][1].phase is Phase.FINISHED
    assert shown[30][0] - shown[0][0] == pytest.approx(1.5, abs=0.05)
    slow = make_task("set_point(horizon=900)").bind(find_robot("thermal").system)
    assert (playback_speed(task), playback_speed(slow)) == (1.0, 9.0)


def test_a_stop_from_outside_ends_the_play():
    task, rollouts = simulated(*SWING_UP)
    stops, panel = StopRequest(), ControllerPanel("pendulum", task, "best")
    watch = ManualClock(then=lambda now: stops.request(StopReason.SIGINT) if now > 0.5 else None)
    play(panel, task, SEEDS, rollouts.trajectories, rollouts.fitness[0], stop=stops, clock=watch, sleep=watch.sleep)
    assert panel.reading().phase is Phase.DRIVING
    assert 8 <= panel.reading().step <= 11


def test_a_controller_on_a_robot_with_a_tracker_is_shown_as_it_drives():
    robot = find_robot("emulated_car")
    task = make_task("point_to_point(horizon=40)").bind(robot.system)
    panel, seen = ControllerPanel(robot.name, task, "pursuit"), []

    def told(series):
        panel.show(*shown_of(series))
        seen.append(as_sent(panel.reading()))

    runner = RobotRunner(robot, seed=1, on_decision=told)
    controller = make_controller("pursuit").bind_to(task)
    rollouts = runner.bind(controller, task)(np.zeros((1, controller.n_parameters)), SEEDS)
    assert {reading["phase"] for reading in seen} == {"settling", "driving", "finished"}
    driven = [reading for reading in seen if reading["phase"] == "driving" and reading["trial"] == 2]
    assert [reading["step"] for reading in driven][:3] == [0, 1, 2]
    assert driven[-1]["pose"] is not None
    assert driven[-1]["waypoint"] is not None
    assert driven[-1]["state"][panel.setting().forward] > 0.1
    assert seen[-1]["scores"][-1] == pytest.approx(rollouts.fitness[0, 1])
