"""Fitting a model's parameters by evolution on its multi-step error."""

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidData
from sysid_evo.evolution import ModelEvolution
from sysid_evo.evolution.model_evolution import final_error
from sysid_evo.system import Channel, System

SYSTEM = System((Channel("x"),), (Channel("u", low=-1.0, high=1.0),), dt=0.1)
TRUTH = np.array([0.8, 0.5])


def linear(parameters, state, control):
    return parameters[:, :1, None] * state + parameters[:, 1:, None] * control


def runaway(parameters, state, control):
    return state * 1e200 * (parameters[:, :1, None] > 0)


@pytest.fixture(scope="module")
def recorded():
    """x' = 0.8 x + 0.5 u without noise, in two episodes."""
    rng = np.random.default_rng(1)
    controls = [rng.uniform(-1, 1, (150, 1)) for _ in range(2)]
    states = []
    for u in controls:
        x = [rng.standard_normal(1)]
        for k in range(len(u)):
            x.append(TRUTH[0] * x[-1] + TRUTH[1] * u[k])
        states.append(np.array(x))
    return Dataset.from_arrays(SYSTEM, states, controls)


@pytest.mark.parametrize("seed", [1, 2])
def test_two_known_parameters_are_found_from_far_away(recorded, seed):
    """Fifty children of deviation 0.1 in two dimensions leave a distance of about 0.1 / sqrt(50 g) after g visits."""
    told = []
    found = ModelEvolution(generations=60, windows=40, horizon=5).run(
        linear, recorded, initial=np.array([-0.5, -0.5]), spread=0.1, rng=np.random.default_rng(seed),
        progress=lambda done, total: told.append(done),
    )  # fmt: skip
    np.testing.assert_allclose(found, TRUTH, atol=0.01)
    assert told == list(range(1, 61))


def test_the_same_generator_finds_the_same_parameters(recorded):
    search = ModelEvolution(generations=5, windows=10, horizon=5, parents=5, children=5)
    given = {"initial": np.zeros(2), "spread": 0.5}
    found = [search.run(linear, recorded, rng=np.random.default_rng(seed), **given) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(found[0], found[1])
    assert not np.isin(found[2], found[0]).any()


def test_the_error_is_that_of_the_last_state_after_the_horizon(recorded):
    windows = recorded.windows(7, stride=30)
    wrong = np.array([[0.7, 0.5], TRUTH])
    state = windows.start_states.copy()
    for k in range(7):
        state = 0.7 * state + 0.5 * windows.controls[:, k]
    error = final_error(linear, wrong, windows)
    assert error[0] == pytest.approx(np.mean((state - windows.states[:, -1]) ** 2))
    assert error[1] == pytest.approx(0.0, abs=1e-20)


def test_every_candidate_of_a_generation_meets_the_same_windows_and_the_next_one_others(recorded):
    met = []

    def watched(parameters, state, control):
        assert (state == state[:1]).all()
        met.append(state[0])
        return linear(parameters, state, control)

    ModelEvolution(generations=3, windows=10, horizon=1, parents=4, children=4).run(
        watched, recorded, initial=np.zeros(2), spread=0.5, rng=np.random.default_rng(1)
    )
    assert [len(states) for states in met[:3]] == [10, 10, 10]
    assert not np.array_equal(met[0], met[1])
    assert not np.array_equal(met[1], met[2])


def test_a_candidate_that_diverges_has_the_largest_error_and_no_nan(recorded):
    error = final_error(runaway, np.array([[1.0], [-1.0]]), recorded.windows(5))
    assert error[0] == np.finfo(float).max
    assert error[1] < 10.0


def test_episodes_shorter_than_the_horizon_are_refused(recorded):
    with pytest.raises(InvalidData, match="no episode is longer than 200 steps, the horizon of the fit"):
        ModelEvolution(horizon=200).run(linear, recorded, initial=np.zeros(2), spread=0.5, rng=np.random.default_rng(1))


@pytest.mark.parametrize(("weights", "found"), [("spread", 0.36), ("paper", 0.9)])
def test_states_of_different_size_count_alike_unless_the_paper_is_followed(weights, found):
    """One gain g for two states that keep k = 0.9 and 0.3 of themselves.

    By spread the sum of (g - k)^2 / k^2 is least, at g = 0.36; in their own units only the large one counts.
    """
    system = System((Channel("large"), Channel("small")), (), dt=0.1)
    kept, start = np.array([0.9, 0.3]), np.random.default_rng(3).standard_normal((80, 2)) * [1.0, 1e-3]
    data = Dataset.from_arrays(system, list(np.stack([start, start * kept], axis=1)), [np.zeros((1, 0))] * 80)
    best = ModelEvolution(generations=40, windows=80, horizon=1, error_units=weights).run(
        lambda population, state, control: population[:, :, None] * state, data,
        initial=np.array([0.5]), spread=0.1, rng=np.random.default_rng(1),
    )  # fmt: skip
    np.testing.assert_allclose(best, [found], atol=0.05)


@pytest.mark.parametrize("horizon", [1, 7])
def test_the_search_looks_as_far_ahead_as_it_is_told(horizon, recorded):
    seen = []

    def watched(parameters, state, control):
        seen.append(len(parameters))
        return linear(parameters, state, control)

    ModelEvolution(generations=1, windows=5, horizon=horizon, parents=4, children=4).run(
        watched, recorded, initial=np.zeros(2), spread=0.5, rng=np.random.default_rng(1)
    )
    assert len(seen) % horizon == 0
    assert seen[:horizon] == [seen[0]] * horizon
    assert len(seen) == 2 * horizon  # the generation, and the choice at the end


def delayed(parameters, carry, control):
    """x' = a x + b u[-1]; the carry is the state and the control before."""
    state = parameters[:, :1, None] * carry[..., :1] + parameters[:, 1:, None] * carry[..., 1:]
    return np.concatenate([state, np.broadcast_to(control, state.shape)], axis=2)


def test_a_model_with_memory_starts_from_measured_history():
    rng = np.random.default_rng(4)
    u, x = rng.uniform(-1, 1, (150, 1)), [np.zeros(1), np.zeros(1)]
    for k in range(1, 150):
        x.append(TRUTH[0] * x[-1] + TRUTH[1] * u[k - 1])
    late = Dataset.from_arrays(SYSTEM, [np.array(x)], [u])

    def start(states, controls):
        return np.concatenate([states[:, -1], controls[:, -1]], axis=1)

    error = final_error(delayed, TRUTH[None], late.windows(5, history=1), start)
    assert error[0] == pytest.approx(0.0, abs=1e-20)
    search = ModelEvolution(generations=60, windows=40, horizon=5)
    options = {"initial": np.array([-0.5, -0.5]), "spread": 0.1, "rng": np.random.default_rng(1)}
    found = search.run(delayed, late, start=start, history=1, **options)
    np.testing.assert_allclose(found, TRUTH, atol=0.01)
