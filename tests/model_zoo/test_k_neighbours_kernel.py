"""The compiled form of the plane through neighbours against its NumPy step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.engine import DynamicsRunner, rollout
from sysid_evo.engine.compiled.compiler import compile_kernel
from sysid_evo.engine.compiled.workspace import aligned
from sysid_evo.evolution import ControllerEvolution, evolve_controller
from sysid_evo.kernels import DYNAMICS, LANES, Precision
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.system import Channel, System
from sysid_evo.testing import example_dataset
from sysid_evo.types import Array

pytestmark = pytest.mark.filterwarnings("ignore::sysid_evo.errors.DataWarning")  # some fits are to a few points

Step = Callable[[Array, Array], Array]
LAGS = ((0, 0), (0, 3), (2, 0), (1, 3))


def fitted(dataset: Dataset, neighbours: int = 8, lags: tuple[int, int] = (0, 0), **options: Any) -> DynamicsModel:
    model = make_model("k_neighbours", neighbours=neighbours, state_lags=lags[0], control_lags=lags[1], **options)
    return model.fit(dataset, rng=np.random.default_rng(0))


def compiled_step(model: DynamicsModel, precision: Precision = "float64") -> Step:
    """Return the kernel as a function of 64 carries and controls, like `DynamicsModel.step`."""
    kernel = model.kernel()
    assert kernel is not None
    function = compile_kernel(kernel.source, DYNAMICS, precision, pointer=False)
    parameters = aligned(kernel.parameters.astype(precision))
    guard = 7.0

    def step(carry: Array, control: Array) -> Array:
        rows, controls = (aligned(a.T.astype(precision).ravel()) for a in (carry, control))
        scratch = aligned(np.full((kernel.n_scratch + 1) * LANES, guard, precision))
        function(rows, controls, np.zeros(LANES, precision), parameters, scratch)
        assert (scratch[-LANES:] == guard).all(), "it writes beyond the room it asked for"
        return rows[: carry.size].reshape(carry.shape[::-1]).T.astype(np.float64)

    return step


def queries(model: Any, rng: np.random.Generator, away: float) -> tuple[Array, Array]:
    """Return 64 carries and legal controls: recorded ones of several steps, moved by ``away`` deviations."""
    carry = model.points_[rng.integers(len(model.points_), size=LANES)] / model.metric_
    control = model.points_[rng.integers(len(model.points_), size=LANES)] / model.metric_
    carry = carry + away * rng.standard_normal(carry.shape) / model.metric_
    return carry[:, : model.n_carry], control[:, model.n_carry :]


@pytest.mark.parametrize("lags", LAGS)
@pytest.mark.parametrize("neighbours", [1, 8, 20, 40])
@pytest.mark.parametrize("recording", ["switched", "proportional"])
def test_one_step_is_that_of_numpy_near_the_data_and_far_from_it(
    recording: str, neighbours: int, lags: tuple[int, int], request: pytest.FixtureRequest, rng: np.random.Generator
) -> None:
    model = fitted(request.getfixturevalue(recording), neighbours, lags)
    step = compiled_step(model)
    for away in (0.1, 0.5, 3.0, 100.0):
        carry, control = queries(model, rng, away)
        np.testing.assert_allclose(step(carry, control), model.step(carry, control), rtol=1e-9, atol=1e-9)


@pytest.mark.nightly
def test_a_step_in_float32_is_that_of_numpy_to_its_precision(proportional: Dataset, rng: np.random.Generator) -> None:
    model = fitted(proportional, 20, (1, 3))
    carry, control = queries(model, rng, 0.3)
    error = np.abs(compiled_step(model, "float32")(carry, control) - model.step(carry, control))
    assert np.median(error) < 1e-6


def test_controls_may_count_more_or_less(proportional: Dataset, rng: np.random.Generator) -> None:
    for weight in (0.2, 5.0):
        model = fitted(proportional, 8, (0, 1), control_weight=weight)
        carry, control = queries(model, rng, 0.5)
        np.testing.assert_allclose(compiled_step(model)(carry, control), model.step(carry, control), atol=1e-9)


def test_on_a_recorded_step_the_distance_is_zero(proportional: Dataset) -> None:
    model: Any = fitted(proportional, 8)
    asked = model.points_[:LANES] / model.metric_
    carry, control = asked[:, :3], asked[:, 3:]
    np.testing.assert_allclose(compiled_step(model)(carry, control), model.step(carry, control), atol=1e-9)


@pytest.mark.parametrize("steps", [1, 2, 5, 17, 300])
def test_fewer_points_than_neighbours_are_all_used(steps: int, rng: np.random.Generator) -> None:
    model: Any = fitted(example_dataset(episodes=1, steps=steps), 20)
    assert len(model.points_) <= steps
    carry, control = queries(model, rng, 0.5)
    np.testing.assert_allclose(compiled_step(model)(carry, control), model.step(carry, control), atol=1e-9)


def test_points_on_top_of_each_other_count_as_often_as_they_are_there(rng: np.random.Generator) -> None:
    """Five copies of an episode: every distance occurs five times, so that ties are within the neighbours."""
    once = example_dataset(episodes=1, steps=60)
    episode = once.episodes[0]
    copies = Dataset.from_arrays(once.system, [episode.states] * 5, [episode.controls] * 5)
    model = fitted(copies, 10)
    carry, control = queries(model, rng, 0.5)
    np.testing.assert_allclose(compiled_step(model)(carry, control), model.step(carry, control), atol=1e-9)


def test_one_state_and_one_control_are_enough(oscillator: Dataset, rng: np.random.Generator) -> None:
    system = System((Channel("speed"),), (Channel("force", low=-2.0, high=2.0),), dt=0.1)
    episodes = oscillator.episodes
    single = Dataset.from_arrays(system, [e.states[:, 1:] for e in episodes], [e.controls for e in episodes])
    for dataset in (oscillator, single):
        model = fitted(dataset, 8)
        carry, control = queries(model, rng, 0.5)
        np.testing.assert_allclose(compiled_step(model)(carry, control), model.step(carry, control), atol=1e-9)


def test_the_compiled_body_rests_where_that_of_numpy_does(switched: Dataset, rng: np.random.Generator) -> None:
    model = fitted(switched, 8, (0, 1), rest_hold=True)
    step = compiled_step(model)
    carry, control = queries(model, rng, 0.5)
    carry[::2], control[::2] = 0.0, 0.0
    found = step(carry, control)
    np.testing.assert_allclose(found, model.step(carry, control), atol=1e-9)
    assert (found[::2] == 0.0).all()


@pytest.mark.nightly
def test_scores_of_an_evolved_population_are_those_of_numpy() -> None:
    model = fitted(example_dataset(), 8, (0, 1))
    settings = ControllerEvolution(generations=12, trials=3, selection_trials=5)
    champion = evolve_controller("car", {"car": DynamicsRunner(model)}, model.system, settings, seed=3)
    rng = np.random.default_rng(0)
    size = len(champion.parameters)
    population = champion.parameters + 0.1 * np.abs(champion.parameters).mean() * rng.standard_normal((25, size))
    task = settings.make_task(model.system)
    controller, seeds = settings.make_controller(task), trial_seeds(5, 8)
    expected = rollout(model, controller, population, task, seeds, engine="reference")
    found = rollout(model, controller, population, task, seeds)
    assert found.engine == "compiled float64"
    assert expected.fitness.mean() > 2.0
    assert (found.fitness == expected.fitness).mean() >= 0.995
