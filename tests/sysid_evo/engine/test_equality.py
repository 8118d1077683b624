"""Compiled families against the reference: evolved controllers score the same, recordings are the same."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from sysid_evo.angles import wrap
from sysid_evo.controllers import RecurrentNetwork, View
from sysid_evo.data import Dataset
from sysid_evo.engine import Engine, rollout
from sysid_evo.engine.compiled.open_loop import final_errors
from sysid_evo.evolution.model_evolution import final_error, kernel_error
from sysid_evo.evolution.strategies.mu_plus_lambda import MuPlusLambda
from sysid_evo.kernels import ADVANCE, CONTROLLER, LANES, OBSERVE, KernelSource, Precision
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.models.kernels import Predictor, stepping_kernel
from sysid_evo.motion import PlanarBody
from sysid_evo.randomness import trial_seeds
from sysid_evo.system import Channel, System
from sysid_evo.tasks import PointToPoint
from sysid_evo.types import Array
from tests.sysid_evo.engine.running import PRECISIONS, RTOL, call_block

FAMILIES = {
    "parametrised": {"generations": 60},
    "nearest_neighbour": {},
    "linear": {},
    "linear with lags": {"state_lags": 2, "control_lags": 1},
}
ENOUGH = {"float64": 0.995, "float32": 0.99}


@pytest.fixture(scope="session", params=list(FAMILIES))
def model(request: Any, recording: Dataset) -> DynamicsModel:
    made = make_model(request.param.split()[0], **FAMILIES[request.param])
    return made.fit(recording, rng=np.random.default_rng(0))


@pytest.fixture(scope="session")
def drivers(model: DynamicsModel) -> Array:
    """The last parents (50, 78) of a short evolution of the paper's controller."""
    strategy = MuPlusLambda(n_parameters=78, seed=0)
    for generation in range(40):
        population = strategy.ask()
        seeds = trial_seeds(0, 3, generation=generation)
        run = rollout(model, RecurrentNetwork(), population, PointToPoint(), seeds)
        strategy.tell(population, run.fitness.mean(axis=1))
    return strategy.elite


@pytest.mark.parametrize("engine", ["float64", "float32"])
def test_evolved_controllers_score_as_in_the_reference(model: DynamicsModel, drivers: Array, engine: Engine) -> None:
    given = (model, RecurrentNetwork(), drivers[:20], PointToPoint(), trial_seeds(3, 10))
    exact, fast = rollout(*given, engine="reference"), rollout(*given, engine=engine)
    assert exact.fitness.mean() >= 5, "controllers that reach nothing prove nothing"
    assert (exact.fitness == fast.fitness).mean() >= ENOUGH[engine]
    assert (exact.clipped == fast.clipped).mean() >= ENOUGH[engine]
    assert abs(exact.fitness.mean() - fast.fitness.mean()) < 0.1


def test_recorded_trajectories_are_those_of_the_reference(model: DynamicsModel, drivers: Array) -> None:
    given = (model, RecurrentNetwork(), drivers[:3], PointToPoint(horizon=150), trial_seeds(3, 4))
    fast, exact = (rollout(*given, engine=engine, record=True) for engine in ("float64", "reference"))
    for a, b in zip(fast.trajectories, exact.trajectories, strict=True):
        assert a.name == b.name
        assert a.pose is not None
        assert b.pose is not None
        np.testing.assert_allclose(a.states, b.states, rtol=1e-7, atol=1e-7)
        np.testing.assert_array_equal(a.controls, b.controls)
        np.testing.assert_allclose(a.pose, b.pose, atol=1e-7)
    assert np.abs(exact.trajectories[0].pose).max() > 0.5


PLANES = [
    System((Channel("u"), Channel("v"), Channel("r")), (Channel("a", "", -1, 1),), 0.05, PlanarBody("u", "v", "r")),
    System((Channel("r"), Channel("u"), Channel("v")), (Channel("a", "", -1, 1),), 0.05, PlanarBody("u", "v", "r")),
    System((Channel("r"), Channel("u")), (Channel("a", "", -1, 1),), 0.05, PlanarBody("u", None, "r")),
]


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("system", PLANES, ids=["uvr", "ruv", "ru"])
def test_the_waypoint_task_observes_and_advances_step_by_step(precision: Precision, system: System) -> None:
    rng = np.random.default_rng(3)
    task = PointToPoint(horizon=40, waypoint_radius=0.8).bind(system)
    kernel = task.kernel()
    began = task.begin(trial_seeds(1, LANES))
    here: Any = dataclasses.replace(
        began, pose=np.stack([rng.normal(size=LANES) * size for size in (1.0, 1.0, 1e5)], axis=1)
    )
    rows, data = kernel.rows(here), kernel.trial_data(here)
    before, tolerance = rng.normal(size=(LANES, system.nx)), RTOL[precision]
    control = np.zeros((LANES, system.nu))
    for _ in range(40):
        observation = np.full((5, LANES), np.nan)
        seen = call_block(
            kernel.observe.function, OBSERVE, precision, [rows, before.T, observation, kernel.parameters]
        )[2]
        expected = task.observe(here, before)
        off = np.abs(seen.T - expected)
        off[:, 3] = np.minimum(off[:, 3], 2 * np.pi - off[:, 3])
        assert off.max() < 100 * tolerance
        after = 2.0 * rng.normal(size=(LANES, system.nx))
        after[:, system.state_names.index("r")] *= 200.0  # several turns in a step
        given = [rows, before.T, after.T, control.T, np.arange(LANES), data, kernel.parameters]
        rows = call_block(kernel.advance.function, ADVANCE, precision, given, kernel.advance.bindings)[0]
        here, _ = task.advance(here, before, after, control=control)
        back: Any = kernel.state(here, rows)
        np.testing.assert_array_equal(back.passed, here.passed)
        np.testing.assert_allclose(back.pose[:, :2], here.pose[:, :2], atol=100 * tolerance)
        np.testing.assert_allclose(wrap(back.pose[:, 2] - here.pose[:, 2]), 0.0, atol=100 * tolerance)
        assert (np.abs(back.pose[:, 2]) <= np.pi + 1e-6).all()
        assert (np.abs(here.pose[:, 2]) <= np.pi + 1e-6).all()
        rows, before = np.asarray(rows, dtype=float), after
        rows[2:5] = here.pose.T  # so that rounding does not add up
        rows[4] = np.remainder(rows[4] + np.pi, 2 * np.pi) - np.pi
    assert here.passed.max() >= 3


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("n_inputs, hidden, n_outputs", [(5, 6, 2), (1, 1, 1), (3, 9, 4)])
def test_the_recurrent_kernel_is_the_recurrent_network(
    precision: Precision, n_inputs: int, hidden: int, n_outputs: int
) -> None:
    rng = np.random.default_rng(1)
    network = RecurrentNetwork(hidden=hidden).bind(n_inputs, n_outputs)
    kernel = network.kernel()
    assert isinstance(kernel.source, KernelSource)
    theta = rng.normal(size=(LANES, network.n_parameters))
    memory, expected_memory = np.zeros((hidden, LANES)), np.zeros((LANES, 1, hidden))
    for _ in range(4):
        seen = rng.normal(size=(LANES, n_inputs))
        arguments = [
            theta.T, memory, seen.T, np.zeros((n_outputs, LANES)), kernel.parameters,
            np.zeros((kernel.n_scratch, LANES)),
        ]  # fmt: skip
        after = call_block(kernel.source.function, CONTROLLER, precision, arguments, kernel.source.bindings)
        view = View(seen[:, None], np.zeros((LANES, 1, 1)), None)  # type: ignore[arg-type]  # it looks at neither
        raw, expected_memory = network.act(theta, expected_memory, view)
        np.testing.assert_allclose(np.tanh(after[3].T), raw[:, 0], rtol=RTOL[precision], atol=RTOL[precision])
        memory = np.asarray(after[1], dtype=float)


def test_the_compiled_fit_has_the_error_of_the_plain_one(recording: Dataset) -> None:
    family: Any = make_model("parametrised", generations=3).fit(recording, rng=np.random.default_rng(0))
    rng = np.random.default_rng(5)
    windows = recording.windows(10)
    windows = windows[rng.integers(len(windows), size=131)]
    population = family.parameters_ * rng.uniform(0.5, 1.5, (37, 12))
    weight = np.array([2.0, 0.5, 7.0])
    plain = final_error(family._advance, population, windows, weight=weight)
    kernel, parameters = family._kernels(population)
    np.testing.assert_allclose(kernel_error(kernel, parameters, windows, weight=weight), plain, rtol=1e-4)
    given = (
        kernel.source, kernel.n_scratch, parameters, windows.start_states, windows.controls, windows.states[:, -1],
        weight,
    )  # fmt: skip
    alone = final_errors(*given, precision="float64")
    np.testing.assert_allclose(alone, plain, rtol=1e-9)
    for threads in (2, 3, 99):
        np.testing.assert_array_equal(final_errors(*given, precision="float64", threads=threads), alone)


def explode(x, u, p, y, scratch):
    for lane in range(LANES):
        y[lane] = p[0] * x[lane] * x[lane]


def test_a_candidate_that_diverges_has_the_largest_error() -> None:
    system = System((Channel("x"),), (Channel("u", "", -1, 1),), 0.1)
    start, controls, truth = np.full((5, 1), 2.0), np.zeros((5, 12, 1)), np.zeros((5, 1))
    kernel = stepping_kernel(Predictor(explode, np.array([1.0]), 0), system, output="next_state")
    parameters = np.tile(kernel.parameters, (2, 1))
    parameters[1, -1] = 0.1
    for precision in PRECISIONS:
        error = final_errors(kernel.source, kernel.n_scratch, parameters, start, controls, truth, precision=precision)
        assert not np.isfinite(error[0])
        assert np.isfinite(error[1])
