"""Controllers in an environment itself: the same as a loop written by hand, trial by trial."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import gymnasium
import numpy as np
import pytest

from hardware.simulators.gymnasium_robot import GymnasiumRobot
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.errors import InvalidArgument
from sysid_evo.randomness import trial_seeds
from sysid_evo.system import Channel
from sysid_evo.tasks import Task, TaskState
from sysid_evo.types import Array
from tests.fixtures.environments import BREAKS, NAME, register

register()
SEEDS = trial_seeds(5, 4)


@dataclass(frozen=True)
class Counted(TaskState):
    count: Array


class Counting(Task):
    """Counts what the control is, and ends where the first state passes ``end``."""

    worst = -1e6

    def __init__(self, horizon=30, end=np.inf, start=0.0):
        self.horizon, self.end, self.start = horizon, end, start

    def check_system(self, system):
        self.observations = tuple(Channel(name) for name in (*system.regressor_names, "bias"))

    def begin(self, seeds):
        state = np.tile(self.system.neutral_state, (len(seeds), 1))
        state[:, 0] += self.start + 1e-3 * np.arange(len(seeds))
        return Counted(state, np.zeros((len(seeds), 0)), np.ones(len(seeds), dtype=bool), np.zeros(len(seeds)))

    def observe(self, task_state, state):
        return np.column_stack([self.system.regressors(state), np.ones(len(state))])

    def advance(self, task_state, before, after, *, control, pose=None):
        count = task_state.count + control[:, 0]
        return replace(task_state, count=count, alive=after[:, 0] <= self.end), after

    def fitness(self, task_state):
        return task_state.count.copy()


def network(task, system, candidates=2):
    controller = RecurrentNetwork(hidden=3)
    size = controller.bind(len(task.bind(system).observations), system.nu).n_parameters
    return controller, np.random.default_rng(0).standard_normal((candidates, size))


def by_hand(robot, task, parameters, seed, at):
    """Return fitness and states of one trial, with the environment as its maker gave it."""
    env = gymnasium.make(robot.name)
    observation, _ = env.reset(seed=int(seed) % 2**31)
    if at is not None:
        inner: Any = env.unwrapped
        inner.state = np.array(at)
    task, total = task.bind(robot.system), 0.0
    controller = RecurrentNetwork(hidden=3).bind(len(task.observations), robot.system.nu)
    states = [robot.simulator.observations.state(observation) if at is None else at]
    memory = np.zeros(3)
    i, h = len(task.observations), 3
    w_in, w_h = parameters[: i * h].reshape(i, h), parameters[i * h : (i + h) * h].reshape(h, h)
    for _ in range(task.horizon):
        seen = np.append(robot.system.regressors(states[-1]), 1.0)
        memory = np.tanh(seen @ w_in + memory @ w_h)
        raw = np.tanh(memory @ parameters[(i + h) * h :].reshape(h, -1))
        control = robot.system.actuate(raw)
        total += control[0]
        observation, _, ended, late, _ = env.step(robot.simulator.actions.action(control))
        states.append(robot.system.near(robot.simulator.observations.state(observation), states[-1]))
        if ended or late or states[-1][0] > task.end:
            break
    assert controller.n_parameters == len(parameters)
    return total, np.array(states)


@pytest.mark.parametrize("name", ["Pendulum-v1", "CartPole-v1", "MountainCar-v0", NAME])
def test_every_trial_is_what_a_loop_written_by_hand_gives(name):
    robot, task = GymnasiumRobot(id=name), Counting(start=0.05)
    controller, parameters = network(task, robot.system)
    found = robot.runner().run(controller, parameters, task, SEEDS, record=True)
    starts = task.bind(robot.system).begin(SEEDS).state
    trajectories = iter(found.trajectories)
    for candidate in range(2):
        for trial, seed in enumerate(SEEDS):
            at = starts[trial] if robot.simulator.settable else None
            fitness, states = by_hand(robot, task, parameters[candidate], seed, at)
            assert found.fitness[candidate, trial] == pytest.approx(fitness, abs=1e-5)
            assert found.survived[candidate, trial] == len(states) - 1
            np.testing.assert_allclose(next(trajectories).states, states, atol=1e-5)


def test_the_same_trials_give_the_same_fitness_however_many_candidates_run_beside():
    robot, task = GymnasiumRobot(id="CartPole-v1"), Counting()
    controller, parameters = network(task, robot.system, candidates=70)
    all_of_them = robot.runner().run(controller, parameters, task, SEEDS)
    alone = robot.runner().run(controller, parameters[65:66], task, SEEDS)
    np.testing.assert_array_equal(all_of_them.fitness[65], alone.fitness[0])
    np.testing.assert_array_equal(all_of_them.behaviour[65], alone.behaviour[0])
    assert all_of_them.fitness.shape == (70, 4)


def test_a_trial_is_over_when_the_environment_ends_it():
    robot, task = GymnasiumRobot(id=NAME), Counting(horizon=100)
    controller, _ = network(task, robot.system)
    full = np.zeros((1, 3 * (4 + 3 + 1)))
    full[0, 9:12], full[0, 21:24] = 5.0, 5.0  # the bias drives the outputs to the limit
    found = robot.runner().run(controller, full, task, SEEDS, record=True)
    assert (found.survived == 30).all()
    assert all(abs(t.states[-1, 0]) > BREAKS >= abs(t.states[-2, 0]) - 1e-5 for t in found.trajectories)


def test_a_trial_is_over_when_the_task_ends_it():
    robot, task = GymnasiumRobot(id=NAME), Counting(horizon=100, end=0.55)
    full = np.zeros((1, 24))
    full[0, 9:12], full[0, 21:24] = 5.0, 5.0
    assert (robot.runner().run(RecurrentNetwork(hidden=3), full, task, SEEDS).survived == 6).all()


def test_an_environment_that_returns_no_number_is_a_trial_that_diverged():
    robot, task = GymnasiumRobot(id=NAME, settings={"bad": True}), Counting(horizon=40)
    full = np.zeros((1, 24))
    full[0, 9:12], full[0, 21:24] = 5.0, 5.0
    found = robot.runner().run(RecurrentNetwork(hidden=3), full, task, SEEDS)
    assert (found.survived == 5).all()
    np.testing.assert_allclose(found.fitness, task.worst - 1.0 + 5 / 40)


def test_a_run_without_a_trial_is_refused():
    robot, task = GymnasiumRobot(id=NAME), Counting()
    controller, parameters = network(task, robot.system)
    with pytest.raises(InvalidArgument, match="at least one candidate and one seed"):
        robot.runner().run(controller, parameters, task, SEEDS[:0])
