"""What the page is told, and shows, of a controller that drives: traces for every task, as they happened."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import expect

from hardware.driving.controller_driving import (
    CONTROLLED,
    FINISHED,
    ControllerPanel,
    Moment,
    moment_of,
    moments,
    pace,
    play,
)
from hardware.driving.keyboard import Keyboard
from hardware.driving.server import PageServer
from hardware.driving.trials import RobotRunner
from hardware.robot import find_robot
from hardware.run_report import Reason, Stops
from sysid_evo.controllers.controller import make_controller
from sysid_evo.engine import Rollouts
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks import Task
from sysid_evo.tasks.task import make_task
from tests.fixtures.browser import Visitor, seen, sideways

SEEDS = trial_seeds(3, 2)
CASES = {
    "set_point(channels=temperature, horizon=30)": "thermal",
    "track_reference(channels=[angle, angular_speed], horizon=30)": "pendulum",
    "swing_up(horizon=30)": "pendulum",
    "balance(horizon=30)": "cart_pole",
    "environment(id='CartPole-v1', horizon=30)": "gymnasium(id='CartPole-v1')",
    "walled_track(horizon=30)": "emulated_car",
    "point_to_point(horizon=30)": "emulated_car",
    "set_point(channels=forward_speed, horizon=30)": "emulated_car",
}


def simulated(spec: str) -> tuple[Task, Rollouts]:
    """Return a task, bound to its robot, and two trials of a linear controller there."""
    robot = find_robot(CASES[spec])
    task = make_task(spec).bind(robot.system)
    controller = make_controller("linear").bind_to(task)
    parameters = np.random.default_rng(0).standard_normal((1, controller.n_parameters))
    runner = robot.runner()
    assert runner is not None
    return task, runner.run(make_controller("linear"), parameters, make_task(spec), SEEDS, record=True)


@pytest.mark.parametrize("spec", CASES)
def test_a_trial_played_back_ends_with_its_score_and_shows_what_the_task_wanted(spec: str) -> None:
    task, rollouts = simulated(spec)
    panel = ControllerPanel("robot", task, "best")
    setting = json.loads(json.dumps(panel.setting(), allow_nan=False))
    assert not setting["by_hand"]
    for trial, trajectory in enumerate(rollouts.trajectories):
        shown = moments(task, SEEDS[trial : trial + 1], trajectory, trial + 1)
        assert [moment.step for moment in shown] == list(range(len(trajectory.states)))
        assert shown[-1].score == pytest.approx(rollouts.fitness[0, trial], rel=1e-4, abs=1e-4)
        panel.show(shown[len(shown) // 2])
        scenery, reading = json.loads(json.dumps([panel.scenery(), panel.reading()], allow_nan=False))
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
    assert setting["top_view"] == (CASES[spec] == "emulated_car")
    assert bool(setting["traces"]) == (spec.split("(")[0] not in ("walled_track", "point_to_point"))


class Watch:
    """A clock that goes on while somebody sleeps."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def test_trials_are_played_in_the_time_they_took_and_those_of_a_slow_process_faster() -> None:
    task, rollouts = simulated("swing_up(horizon=30)")
    panel, watch = ControllerPanel("pendulum", task, "best"), Watch()
    shown: list[tuple[float, Moment]] = []
    panel.show = lambda moment: shown.append((watch.now, moment))  # type: ignore[method-assign]  # to see all
    play(panel, task, SEEDS, rollouts.trajectories, rollouts.fitness[0], stops=Stops(), clock=watch, sleep=watch.sleep)
    assert len(shown) == 2 * 32
    assert [moment.number for _, moment in shown] == [1] * 32 + [2] * 32
    assert shown[31][1].phase == FINISHED
    assert shown[30][0] - shown[0][0] == pytest.approx(1.5, abs=0.05)
    slow = make_task("set_point(horizon=900)").bind(find_robot("thermal").system)
    assert (pace(task), pace(slow)) == (1.0, 9.0)


def test_a_stop_from_outside_ends_the_play() -> None:
    task, rollouts = simulated("swing_up(horizon=30)")
    stops, watch, panel = Stops(), Watch(), ControllerPanel("pendulum", task, "best")

    def sleep(seconds: float) -> None:
        watch.sleep(seconds)
        if watch.now > 0.5:
            stops.request(Reason.SIGINT)

    play(panel, task, SEEDS, rollouts.trajectories, rollouts.fitness[0], stops=stops, clock=watch, sleep=sleep)
    assert panel.reading()["phase"] == CONTROLLED
    assert 8 <= panel.reading()["step"] <= 11


def test_a_controller_on_a_robot_with_a_tracker_is_shown_as_it_drives() -> None:
    robot = find_robot("emulated_car")
    task = make_task("point_to_point(horizon=40)").bind(robot.system)
    panel, seen = ControllerPanel(robot.name, task, "pursuit"), []

    def told(series: Any) -> None:
        panel.show(moment_of(series))
        seen.append(json.loads(json.dumps(panel.reading(), allow_nan=False)))

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


BLUE, GREY = (0x00, 0x72, 0xB2), (0x8D, 0x98, 0xA5)


def count(pixels: np.ndarray, colour: tuple[int, int, int]) -> int:
    return int((np.abs(pixels - np.array(colour) / 255.0).max(axis=2) < 0.15).sum())


@pytest.mark.parametrize("size", [(1280, 800), (375, 667)])
@pytest.mark.parametrize("spec", ["set_point(channels=temperature, horizon=30)", "swing_up(horizon=30)"])
def test_the_page_draws_the_states_beside_their_targets_and_offers_no_keys(
    visitor: Visitor, spec: str, size: tuple[int, int]
) -> None:
    task, rollouts = simulated(spec)
    panel = ControllerPanel(CASES[spec], task, "best")
    shown = moments(task, SEEDS[:1], rollouts.trajectories[0], 1)
    panel.show(shown[0])
    with PageServer(panel, Keyboard(life=1.0), host="127.0.0.1", port=0, died=print) as server:
        page = visitor.open(server.url, width=size[0], height=size[1])
        expect(page.locator("#banner")).to_have_text("best drives")
        before = seen(page)
        for moment in shown[1:-1:4]:
            panel.show(moment)
            left = (30 - moment.step) * task.system.dt
            page.wait_for_function(
                f"() => Math.abs(Number(document.getElementById('time').textContent) - {left}) < 0.06"
            )
        pixels = seen(page)
        assert count(pixels, BLUE) > count(before, BLUE) + 50
        assert count(pixels, GREY) > 100
        assert sideways(page) == 0
        expect(page.locator("#pad")).to_be_hidden()
        expect(page.locator("#view")).to_be_hidden()
        panel.show(replace(shown[-1], phase=FINISHED, score=12.345))
        expect(page.locator("#banner")).to_have_text("Trial over, score 12.35.")
        page.close()
