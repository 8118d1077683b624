"""Imagined trials in their compiled form: the same scores as in NumPy, for every task and in the middle of trials."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from sysid_evo import make_model, make_task
from sysid_evo.data import Dataset
from sysid_evo.engine import rollout
from sysid_evo.engine.imagined import Engine, Imagination
from sysid_evo.kernels import DynamicsKernel, Lifted
from sysid_evo.models import Dynamics
from sysid_evo.predictive_control import Predictive
from sysid_evo.randomness import trial_seeds
from sysid_evo.system import System
from sysid_evo.tasks import Reward, Task
from sysid_evo.tasks.task import TaskState
from sysid_evo.testing import example_dataset
from sysid_evo.testing.examples import ExampleDynamics, continuous_car, pendulum
from sysid_evo.types import Array

CASES: list[tuple[str, System]] = [
    ("point_to_point(horizon=40, waypoint_radius=0.6, arena_radius=0.8)", continuous_car()),
    ("walled_track(horizon=40, radius=0.5, width=0.3, collision=slow)", continuous_car()),
    ("walled_track(horizon=40, radius=0.5, width=0.3, collision=end)", continuous_car()),
    ("set_point(channels=angular_speed, low=-1, high=1, tolerance=0.2, horizon=40)", pendulum()),
    ("track_reference(channels=angular_speed, low=-1, high=1, horizon=40)", pendulum()),
    ("swing_up(horizon=40)", pendulum()),
    ("balance(horizon=40, effort=0.1)", pendulum()),
]
ENGINES: tuple[Engine, ...] = ("float64", "reference")


def middle(task: Task, body: Dynamics, steps: int) -> tuple[TaskState, Array]:
    """Return five trials after some steps, some of which may be over, and the states in them."""
    here: Any = task.begin(trial_seeds(3, 5))
    carry, rng = body.start(here.state[:, None], np.zeros((5, 0, task.system.nu))), np.random.default_rng(0)
    for _ in range(steps):
        control = task.system.actuate(rng.uniform(-0.4, 0.4, (5, task.system.nu)))
        after = body.step(carry, control)
        advanced, state = task.advance(here, carry[:, : task.system.nx], after[:, : task.system.nx], control=control)
        here = here.keep(advanced, here.alive)
        carry = np.concatenate([state, after[:, task.system.nx :]], axis=1)
    return task.foreseen(here), carry[:, : task.system.nx]


def both(
    task: Task, body: Dynamics, steps: int = 25, *, done: int = 6, engine: Engine = "float64"
) -> tuple[Array, Array]:
    """Return the scores of the same sequences, compiled and in NumPy, for trials ``done`` steps old."""
    known, state = middle(task, body, done)
    sequences = np.random.default_rng(1).uniform(-1.2, 1.2, (30, 5, steps, task.system.nu))
    forms = [Imagination(body, task, engine=one) for one in (engine, "reference")]
    assert forms[0].compiled is not None
    assert forms[1].compiled is None
    compiled, reference = (form.scores(state[:, None], np.zeros((5, 0, task.system.nu)), sequences, known)
                           for form in forms)  # fmt: skip
    return compiled, reference


@pytest.mark.parametrize("engine, bound", [("float64", 1e-6), ("float32", 1e-4)])
@pytest.mark.parametrize("spec, system", CASES, ids=[spec.split(", horizon")[0].split("(h")[0] for spec, _ in CASES])
def test_scores_are_those_of_numpy(spec: str, system: System, engine: Engine, bound: float) -> None:
    done = 1 if "balance" in spec else 6
    compiled, reference = both(make_task(spec).bind(system), ExampleDynamics(system), done=done, engine=engine)
    assert np.ptp(reference, axis=0).max() > 0.01, "sequences that score alike prove nothing"
    np.testing.assert_allclose(compiled, reference, rtol=bound, atol=bound)


def worth(states: Array, controls: Array) -> Array:
    return -(states[:, 0] ** 2) - 0.1 * controls[:, 0] ** 2


def worth_of_one(x: Any, u: Any) -> Any:
    return -(x[0] * x[0]) - 0.1 * u[0] * u[0]


def test_scores_of_a_reward_are_those_of_numpy() -> None:
    task = Reward(worth, scalar=worth_of_one, lowest=-20.0, horizon=40).bind(pendulum())
    compiled, reference = both(task, ExampleDynamics(pendulum()))
    assert np.ptp(reference, axis=0).min() > 0.01
    np.testing.assert_allclose(compiled, reference, rtol=1e-6, atol=1e-6)


@dataclass
class Jumping(ExampleDynamics):
    """Its speed becomes ``peak`` under more than half of the torque; an envelope holds it within 3 rad/s."""

    peak: float

    def __post_init__(self) -> None:
        super().__init__(pendulum())

    @property
    def envelope(self) -> Array:
        return np.array([[-np.inf, -3.0], [np.inf, 3.0]])

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        speed = np.where(control[:, 0] > 1.0, self.peak, 0.5 * carry[:, 1] + control[:, 0])
        return np.stack([carry[:, 0] + 0.1 * carry[:, 1], speed], axis=1)

    def kernel(self) -> DynamicsKernel:
        return DynamicsKernel(Lifted(jumping, n_carry=2, nu=1), np.array([self.peak]))


def jumping(x: Any, u: Any, p: Any) -> Any:
    return x[0] + 0.1 * x[1], p[0] if u[0] > 1.0 else 0.5 * x[1] + u[0]


@pytest.mark.parametrize("peak", [np.inf, 1e6])
def test_what_diverges_is_the_worst_and_what_has_an_envelope_is_clipped(peak: float) -> None:
    task = make_task("set_point(channels=angular_speed, low=-1, high=1, tolerance=0.5, horizon=40)").bind(pendulum())
    compiled, reference = both(task, Jumping(peak), steps=8)
    np.testing.assert_allclose(compiled, reference, rtol=1e-6, atol=1e-6)
    lost = compiled == task.worst - 1.0
    assert lost.any() == np.isinf(peak)
    assert not lost.all()


def test_two_candidates_in_the_same_trials_are_imagined_apart() -> None:
    """Targets that change stand once for each trial, however many candidates there are."""
    system = pendulum()
    task, body = (
        make_task("track_reference(channels=angular_speed, low=-1, high=1, horizon=40)"),
        ExampleDynamics(system),
    )
    bound = task.bind(system)
    known = bound.begin(trial_seeds(3, 3)).tile(2)
    sequences = np.random.default_rng(1).uniform(-1.0, 1.0, (20, 6, 25, 1))
    compiled, reference = (
        Imagination(body, bound, engine=engine).scores(known.state[:, None], np.zeros((6, 0, 1)), sequences, known)
        for engine in ENGINES
    )
    np.testing.assert_allclose(compiled, reference, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("family, lags", [("linear", (1, 2)), ("nearest_neighbour", (0, 0))])
def test_a_fitted_model_inside_drives_as_its_numpy_form(family: str, lags: tuple[int, int]) -> None:
    data: Dataset = example_dataset()
    model = make_model(family, state_lags=lags[0], control_lags=lags[1]).fit(data, rng=np.random.default_rng(0))
    task, body = make_task("point_to_point(horizon=12)"), ExampleDynamics(data.system)
    runs = []
    for engine in ENGINES:
        law = Formed(model=model, samples=24, horizon=8, engine=engine)
        runs.append(rollout(body, law, np.zeros((1, 2)), task, trial_seeds(1, 2), record=True))
    for fast, exact in zip(*(run.trajectories for run in runs), strict=True):
        np.testing.assert_array_equal(fast.controls, exact.controls)
        np.testing.assert_allclose(fast.states, exact.states, atol=1e-9)


class Formed(Predictive):
    """Predictive with either form of imagination."""

    def __init__(self, *, engine: Engine, **settings: Any) -> None:
        super().__init__(**settings)
        self.engine = engine

    def bind_to(self, task: Task) -> Any:
        bound = super().bind_to(task)
        bound.imagined = tuple(Imagination(one.dynamics, task, engine=self.engine) for one in bound.imagined)
        return bound


def test_a_plan_longer_than_a_trial_is_made_in_numpy() -> None:
    """The data of a task are as long as its trials: nothing beyond them is read."""
    system = continuous_car()
    task = make_task("point_to_point(horizon=3, waypoint_radius=0.2)").bind(system)
    known = task.foreseen(task.begin(trial_seeds(0, 2)))
    sequences, past = np.ones((4, 2, 6, 2)), np.zeros((2, 0, 2))
    body = ExampleDynamics(system)
    given = (known.state[:, None], past, sequences, known)
    np.testing.assert_array_equal(
        Imagination(body, task).scores(*given), Imagination(body, task, engine="reference").scores(*given)
    )
