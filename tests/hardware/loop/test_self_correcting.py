"""A predictive controller whose model learns while it drives a car whose tyres grip half as well."""

from __future__ import annotations

import numpy as np
import pytest

from hardware.loop.robot_runner import RobotRunner
from hardware.loop.trials import Tape, TrialSeries
from sysid_evo.arrays import Array
from sysid_evo.controllers.self_correcting import SelfCorrecting
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.engine import DynamicsRunner
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_model, make_robot
from sysid_evo.tasks import PointToPoint
from tests.benchmarks.shift.emulated import cars, recorded

ZEROS = np.zeros((1, 2))


@pytest.fixture(scope="module")
def model() -> DynamicsModel:
    """A model of the car with good tyres."""
    data: Dataset = recorded(make_robot("emulated_car").dynamics, seconds=40.0, seed=0)
    return make_model("linear", control_lags=2).fit(data, rng=0)


def test_in_the_20_hz_loop_it_learns_from_the_states_that_it_was_shown_and_the_commands_it_gave(
    model: DynamicsModel,
) -> None:
    controller = SelfCorrecting(model=model, samples=12, horizon=8, learned_steps=5)
    memories, tapes = list[Array](), list[Tape]()

    def told(series: TrialSeries) -> None:
        memories.append(series._memory[0, 0].copy())
        tapes[:] = series.tapes

    task = PointToPoint(horizon=60)
    assert np.isfinite(
        RobotRunner(cars()["half the grip"], told=told).run(controller, ZEROS, task, trial_seeds(1, 1)).fitness
    ).all()
    learning, tape = controller.bind_to(task.bind(model.system)).learning, tapes[0]
    assert tape.ticks == list(range(61))
    driven = Trajectory(np.array(tape.states), np.array(tape.controls), model.system.dt)
    offline = list(learning.along(driven))[59]
    place = learning.places["now"]
    assert np.abs(offline[0, place]).max() > 0.01
    np.testing.assert_allclose(memories[-1][place], offline[0, place], rtol=1e-6, atol=1e-9)


def test_several_trials_are_driven_at_once(model: DynamicsModel) -> None:
    controller = SelfCorrecting(model=model, samples=12, horizon=8, learned_steps=5)
    run = DynamicsRunner(cars()["half the grip"].dynamics).run(
        controller, ZEROS, PointToPoint(horizon=30), trial_seeds(1, 3)
    )
    assert run.fitness.shape == (1, 3)
    assert np.isfinite(run.fitness).all()
