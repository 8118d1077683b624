"""What the page is told of a controller that drives: traces for every task, as they happened."""

import json

import numpy as np
import pytest

from hardware.driving.controller_driving import CONTROLLED, FINISHED, ControllerPanel, moment_of, moments, pace, play
from hardware.driving.trials import RobotRunner
from hardware.robot import find_robot
from hardware.run_report import Reason, Stops
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


def as_sent(*messages):
    return json.loads(json.dumps(messages, allow_nan=False))


@pytest.mark.parametrize(("spec", "robot"), CASES)
def test_a_trial_played_back_ends_with_its_score_and_shows_what_the_task_wanted(spec, robot):
    task, rollouts = simulated(spec, robot)
    panel = ControllerPanel("robot", task, "best")
    (setting,) = as_sent(panel.setting())
    assert not setting["by_hand"]
    for trial, trajectory in enumerate(rollouts.trajectories):
        shown = moments(task, SEEDS[trial : trial + 1], trajectory, trial + 1)
        assert [moment.step for moment in shown] == list(range(len(trajectory.states)))
        assert shown[-1].score == pytest.approx(rollouts.fitness[0, trial], rel=1e-4, abs=1e-4)
        panel.show(shown[len(shown) // 2])
        scenery, reading = as_sent(panel.scenery(), panel.reading())
        led = [trace["name"] for trace in setting["traces"]]
        assert len(scenery["targets"]) == len(led) == len(reading["state"])
        names = [task.system.state_names.index(name) for name in led]
        assert reading["state"] == pytest.approx(trajectory.states[len(shown) // 2][names])
        assert (reading["phase"], reading["trial"]) == (CONTROLLED, trial + 1)
        wanted = task.scene(task.begin(SEEDS[trial : trial + 1]), 0)
        assert [target["values"] for target in scenery["targets"] if target] == [
            pytest.approx(target.values) for target in wanted.targets
        ]
        assert len(scenery["walls"]) == len(wanted.walls)
    assert setting["top_view"] == (robot == "emulated_car")
    assert bool(setting["traces"]) == (spec.split("(")[0] not in ("walled_track", "point_to_point"))


def test_trials_are_played_in_the_time_they_took_and_those_of_a_slow_process_faster():
    task, rollouts = simulated(*SWING_UP)
    panel, watch = ControllerPanel("pendulum", task, "best"), ManualClock()
    shown = []
    panel.show = lambda moment: shown.append((watch.now, moment))
    play(panel, task, SEEDS, rollouts.trajectories, rollouts.fitness[0], stops=Stops(), clock=watch, sleep=watch.sleep)
    assert len(shown) == 2 * 32
    assert [moment.number for _, moment in shown] == [1] * 32 + [2] * 32
    assert shown[31][1].phase == FINISHED
    assert shown[30][0] - shown[0][0] == pytest.approx(1.5, abs=0.05)
    slow = make_task("set_point(horizon=900)").bind(find_robot("thermal").system)
    assert (pace(task), pace(slow)) == (1.0, 9.0)


def test_a_stop_from_outside_ends_the_play():
    task, rollouts = simulated(*SWING_UP)
    stops, panel = Stops(), ControllerPanel("pendulum", task, "best")
    watch = ManualClock(then=lambda now: stops.request(Reason.SIGINT) if now > 0.5 else None)
    play(panel, task, SEEDS, rollouts.trajectories, rollouts.fitness[0], stops=stops, clock=watch, sleep=watch.sleep)
    assert panel.reading()["phase"] == CONTROLLED
    assert 8 <= panel.reading()["step"] <= 11


def test_a_controller_on_a_robot_with_a_tracker_is_shown_as_it_drives():
    robot = find_robot("emulated_car")
    task = make_task("point_to_point(horizon=40)").bind(robot.system)
    panel, seen = ControllerPanel(robot.name, task, "pursuit"), []

    def told(series):
        panel.show(moment_of(series))
        seen.extend(as_sent(panel.reading()))

    runner = RobotRunner(robot, seed=1, told=told)
    controller = make_controller("pursuit").bind_to(task)
    rollouts = runner.run(controller, np.zeros((1, controller.n_parameters)), task, SEEDS)
    assert {reading["phase"] for reading in seen} == {"settling", CONTROLLED, FINISHED}
    driven = [reading for reading in seen if reading["phase"] == CONTROLLED and reading["trial"] == 2]
    assert [reading["step"] for reading in driven][:3] == [0, 1, 2]
    assert driven[-1]["pose"] is not None
    assert driven[-1]["waypoint"] is not None
    assert driven[-1]["speed"] > 0.1
    assert seen[-1]["scores"][-1] == pytest.approx(rollouts.fitness[0, 1])
