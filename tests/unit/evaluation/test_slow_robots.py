"""A robot whose step takes long is timed before a comparison with it is planned."""

from types import SimpleNamespace

import numpy as np
import pytest

from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison
from hardware.emulation.sensed_robot import Equations, SensedRobot
from hardware.simulators.simulator import ExternalSimulator, SimulatorRunner, SimulatorSession
from hardware.simulators.simulator_robot import SimulatorRobot
from sysid_evo.controllers.controller import make_controller
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import robots
from sysid_evo.system import Channel, System
from sysid_evo.tasks.task import make_task

SYSTEM = System([Channel("x", "m"), Channel("v", "m/s")], [Channel("u", "N", low=-1.0, high=1.0)], dt=0.05)
EACH = 0.002  # s that a step of one trial takes


class Clock:
    """What the time is: it goes on when it is looked at, and by what a slow step takes."""

    now = 0.0

    @classmethod
    def look(cls):
        cls.now += 1e-4
        return cls.now


class Cart(Equations):
    """A cart in NumPy, all trials at once."""

    system = SYSTEM
    substeps = 1

    def rates_of_change(self, states, controls):
        return np.column_stack([states[:, 1], controls[:, 0] - states[:, 1]])


class OneByOne(Cart):
    """The same cart, which computes one trial after the other, and long."""

    def step(self, carry, control, noise=None):
        Clock.now += EACH * len(carry)
        return super().step(carry, control, noise)


class Slow(ExternalSimulator, SimulatorSession):
    """A simulator that takes its time for a step that is not neutral; its episodes last ten steps."""

    name, system, settable = "slow", SYSTEM, False
    steps = 0

    def open(self):
        return self

    def reset(self, seed, at=None):
        self.steps = 0
        return np.zeros(2)

    def step(self, control):
        assert self.steps < 10, "stepped beyond the end of an episode"
        self.steps += 1
        Clock.now += EACH if control[0] else 0.0
        return np.zeros(2), 0.0, self.steps == 10, False

    def close(self):
        pass


@pytest.fixture(autouse=True)
def _carts(register, monkeypatch):
    register(robots, "cart", lambda: SensedRobot("cart", Cart()))
    register(robots, "slow_cart", lambda: SensedRobot("slow_cart", OneByOne()))
    for module in ("hardware.robot", "hardware.simulators.simulator_robot"):
        monkeypatch.setattr(f"{module}.time", SimpleNamespace(perf_counter=Clock.look))


def planned(robot, reference=None, channel="x", **settings):
    task = f"set_point(channels={channel}, low=-1, high=1)"
    given = {"models": ("linear",), "minutes": 2.0, "task": task, "reference": reference}
    return plan_comparison(Experiment(robot=robot, **{**given, **settings}))


def on_itself(comparison):
    return [cell for cell in comparison.plan.of_kind("evolve") if cell.settings.members[0].robot is not None]


def seconds_on(comparison, robot):
    return next(cell.expected_seconds for cell in comparison.plan.of_kind("run") if cell.settings.column.label == robot)


def test_no_controller_is_evolved_on_a_slow_robot_unless_it_is_asked_for():
    began = Clock.now
    slow = planned("slow_cart")
    assert Clock.now - began < 20.0, "timing it does not take long"
    assert on_itself(slow) == []
    (remark,) = (text for text in slow.plan.remarks if "itself" in text)
    assert "no controller is evolved on slow_cart itself: a step of it takes 2" in remark
    assert "hours. Use --reference yes to do it anyway" in remark
    assert slow.experiment.reference is False, "a busier machine that plans it again decides the same"
    assert seconds_on(slow, "slow_cart") == pytest.approx(100 * 300 * EACH, rel=0.2)
    assert slow.data.expected_seconds >= 2 * 60 / SYSTEM.dt * EACH
    (asked,) = on_itself(planned("slow_cart", reference=True))
    assert asked.expected_seconds > 3600.0


def test_what_numpy_steps_for_all_trials_at_once_is_not_slow():
    quick = planned("cart")
    assert len(on_itself(quick)) == 1
    assert quick.experiment.reference is True
    assert seconds_on(quick, "cart") < 10.0
    assert planned("cart", reference=False).experiment.reference is False


@pytest.mark.parametrize(("engine", "decided"), [("auto", None), ("reference", True)])
def test_what_is_compiled_is_timed_only_where_numpy_steps_it(engine, decided, monkeypatch):
    monkeypatch.setenv("SYSID_EVO_ENGINE", engine)
    compiled = planned("pendulum", channel="angle")
    assert len(on_itself(compiled)) == 1
    assert compiled.experiment.reference is decided


def test_a_simulator_is_timed_while_it_is_driven():
    assert SimulatorRobot(Slow()).step_seconds() == pytest.approx(EACH + 1e-4)


def trials_on(comparison, robot):
    return {cell.settings.trials for cell in comparison.plan.of_kind("run") if cell.settings.column.label == robot}


def test_controllers_run_in_fewer_trials_on_a_slow_robot_and_the_plan_says_so():
    slow = planned("slow_cart", task="set_point(channels=x, low=-1, high=1, horizon=1500)")
    assert len(slow.matrix.controllers) == 3
    assert trials_on(slow, "slow_cart") == {20}, "240 s for trials of 3 s with three controllers"
    assert trials_on(slow, "linear") == {100}
    (remark,) = (text for text in slow.plan.remarks if "trials" in text)
    assert remark.startswith("each controller is run in 20 trials on slow_cart instead of 100: a step of it takes 2")
    assert "a trial of 1500 steps 3" in remark
    assert slow.experiment.robot_trials == 20, "a busier machine that plans it again decides the same"


@pytest.mark.parametrize(
    ("settings", "trials"), [({"robot_trials": 7}, 7), ({"transfer_trials": 90}, 90), ({"transfer_trials": 3}, 3)]
)
def test_trials_that_are_given_are_kept(settings, trials):
    assert trials_on(planned("slow_cart", **settings), "slow_cart") == {trials}


def test_a_quick_robot_runs_all_trials():
    quick = planned("cart")
    assert trials_on(quick, "cart") == {100}
    assert not any("instead of" in text for text in quick.plan.remarks)


def test_the_steps_of_a_slow_robot_are_those_of_the_task():
    def seconds(horizon):
        task = f"set_point(channels=x, low=-1, high=1, horizon={horizon})"
        return seconds_on(planned("slow_cart", task=task, robot_trials=10), "slow_cart")

    assert seconds(400) - seconds(100) == pytest.approx(10 * 300 * EACH, rel=0.2)


def test_a_simulator_reports_the_steps_of_a_trial():
    reported = []
    runner = SimulatorRunner(Slow()).reporting(lambda done, total, note="": reported.append((done, total)))
    task = make_task("set_point(channels=x, low=-1, high=1, horizon=30)")
    runner.bind(make_controller("random"), task)(np.zeros((1, 0)), trial_seeds(0, 1))
    assert reported[:3] == [(1, 30), (2, 30), (3, 30)]
    assert reported[-1] == (30, 30), "trials that are over count as done"
