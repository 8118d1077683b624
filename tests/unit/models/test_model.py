"""What every model family inherits: carry, free run, clipping, and what surrounds `fit`."""

import numpy as np
import pytest

from sysid_evo.carry import clip_state
from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem, NotFitted, ShapeError
from sysid_evo.models import DynamicsModel, require_planar, training_bounds
from sysid_evo.system import Channel, System

PAIR = System((Channel("a"), Channel("b")), (Channel("u"),), dt=0.1)


class Lagged(DynamicsModel):
    """The next state is fixed weights times carry and control, drawn for the sizes at hand."""

    def __init__(self, *, state_lags=0, control_lags=0):
        self.state_lags = state_lags
        self.control_lags = control_lags

    def fit(self, dataset, *, rng, progress=None):
        self.weights_ = 0.3 * rng.standard_normal((self.n_carry + dataset.system.nu, dataset.system.nx))
        return self

    def next_state(self, carry, control):
        return np.concatenate([carry, control], axis=1) @ self.weights_


class Shaken(DynamicsModel):
    """A random walk, started with a random offset."""

    n_noise = 2
    n_draws = 2

    def fit(self, dataset, *, rng, progress=None):
        return self

    def start(self, states, controls, draws=None):
        return super().start(states, controls) + 10.0 * draws

    def next_state(self, carry, control):
        return carry

    def step(self, carry, control, noise=None):
        assert noise is not None
        return carry + noise

    @property
    def state_bounds(self):
        return None


class Falling(DynamicsModel):
    """An acceleration of (1, nan where the control is negative)."""

    def fit(self, dataset, *, rng, progress=None):
        return self

    def acceleration(self, carry, control):
        return np.concatenate([np.ones_like(control), np.where(control < 0, np.nan, 0.0)], axis=1)


@pytest.fixture
def walk(rng):
    return Dataset.from_arrays(PAIR, [rng.uniform(-1, 1, (41, 2))], [rng.uniform(-1, 1, (40, 1))])


def test_the_carry_holds_earlier_states_then_earlier_controls_newest_first(walk):
    model = Lagged(state_lags=2, control_lags=3).fit(walk, rng=0)
    assert (model.n_lags, model.n_carry) == (3, 2 + 4 + 3)
    states, controls = np.arange(8.0).reshape(1, 4, 2), np.array([[[10.0], [11.0], [12.0]]])
    carry = model.start(states, controls)
    np.testing.assert_array_equal(carry, [[6, 7, 4, 5, 2, 3, 12, 11, 10]])
    after = model.step(carry, np.array([[13.0]]))
    np.testing.assert_array_equal(after[:, 2:], [[6, 7, 4, 5, 13, 12, 11]])
    np.testing.assert_array_equal(after[:, :2], model.next_state(carry, np.array([[13.0]])))


@pytest.mark.parametrize("state_lags, control_lags", [(0, 0), (2, 0), (0, 2), (1, 3)])
def test_a_carry_from_start_is_the_carry_of_the_transitions(walk, state_lags, control_lags):
    model = Lagged(state_lags=state_lags, control_lags=control_lags).fit(walk, rng=0)
    windows = walk.windows(1, history=model.n_lags)
    transitions = walk.transitions(state_lags=state_lags, control_lags=control_lags)
    np.testing.assert_array_equal(model.start(windows.past_states, windows.past_controls), transitions.carry)


@pytest.mark.parametrize("state_lags, control_lags", [(0, 0), (2, 1), (0, 3)])
def test_a_simulation_equals_chained_steps(walk, state_lags, control_lags):
    model = Lagged(state_lags=state_lags, control_lags=control_lags).fit(walk, rng=0)
    windows = walk.windows(6, history=model.n_lags, stride=5)
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    assert simulated.shape == windows.states.shape
    history = list(np.moveaxis(windows.past_states, 1, 0))
    controls = list(np.moveaxis(windows.past_controls, 1, 0))
    for k in range(6):
        past = [history[-1 - lag] for lag in range(state_lags + 1)]
        past += [controls[-1 - lag] for lag in range(control_lags)]
        history.append(np.concatenate([*past, windows.controls[:, k]], axis=1) @ model.weights_)
        controls.append(windows.controls[:, k])
        np.testing.assert_allclose(simulated[:, k], history[-1], rtol=1e-12, atol=1e-12)


def test_more_history_than_needed_is_ignored_and_a_run_without_a_state_is_an_error(walk):
    model = Lagged(state_lags=1).fit(walk, rng=0)
    long, short = walk.windows(4, history=5), walk.windows(4, history=1, first=5)
    np.testing.assert_array_equal(
        model.simulate(long.past_states, long.past_controls, long.controls),
        model.simulate(short.past_states, short.past_controls, short.controls),
    )
    with pytest.raises(ShapeError, match=r"states: expected one measured state of each run or more, got \(1, 0, 2\)"):
        model.simulate(np.zeros((1, 0, 2)), np.zeros((1, 0, 1)), np.zeros((1, 5, 1)))


@pytest.mark.parametrize(
    "shapes, message",
    [
        (((1, 1, 3), (1, 0, 1), (1, 5, 1)), r"states: expected shape \(any, any, 2\), got \(1, 1, 3\)"),
        (((2, 1, 2), (2, 0, 1), (1, 5, 1)), r"controls: expected shape \(2, any, 1\), got \(1, 5, 1\)"),
        (((1, 3, 2), (1, 3, 1), (1, 5, 1)), r"past_controls: expected shape \(1, 2, 1\), got \(1, 3, 1\)"),
    ],
)
def test_simulate_names_the_array_of_the_wrong_shape(walk, shapes, message):
    model = Lagged().fit(walk, rng=0)
    with pytest.raises(ShapeError, match=message):
        model.simulate(*(np.zeros(shape) for shape in shapes))


def test_a_simulation_is_clipped_to_the_state_bounds_and_nan_becomes_the_upper_bound(walk):
    model = Falling().fit(walk, rng=0)
    model.state_bounds_ = np.array([[-1.0, -2.0], [0.25, 3.0]])
    simulated = model.simulate(np.zeros((1, 1, 2)), np.zeros((1, 0, 1)), np.array([[[1.0], [1.0], [1.0], [-1.0]]]))
    np.testing.assert_allclose(simulated[0], [[0.1, 0.0], [0.2, 0.0], [0.25, 0.0], [0.25, 3.0]])
    del model.state_bounds_  # without one a nan stays visible
    simulated = model.simulate(np.zeros((1, 1, 2)), np.zeros((1, 0, 1)), -np.ones((1, 2, 1)))
    assert np.isnan(simulated[..., 1]).all()


def test_clipping_tells_which_rows_it_changed_and_leaves_the_rest_of_the_carry():
    carry = np.array([[0.5, 7.0], [2.0, 8.0], [np.nan, 9.0], [-np.inf, 9.0]])
    kept = carry.copy()
    clipped, touched = clip_state(carry, np.array([[-1.0], [1.0]]))
    np.testing.assert_array_equal(clipped, [[0.5, 7.0], [1.0, 8.0], [1.0, 9.0], [-1.0, 9.0]])
    np.testing.assert_array_equal(touched, [False, True, True, True])
    np.testing.assert_array_equal(carry, kept)
    same, touched = clip_state(carry, None)
    assert same is carry
    assert not touched.any()


def test_a_stochastic_model_is_run_as_often_as_asked(walk):
    model = Shaken().fit(walk, rng=0)
    windows = walk.windows(5, stride=10)
    arguments = (windows.past_states, windows.past_controls, windows.controls)
    runs = model.simulate(*arguments, samples=400, rng=np.random.default_rng(3))
    assert runs.shape == (400, *windows.states.shape)
    np.testing.assert_array_equal(runs, model.simulate(*arguments, samples=400, rng=np.random.default_rng(3)))
    offset = runs - windows.start_states[:, None]
    # variance 100 of the start plus 1 a step; the mean of 400 has a standard error of about 0.5
    assert np.abs(offset.mean(axis=0)).max() < 2.5
    np.testing.assert_allclose(offset.var(axis=0), 100.0, rtol=0.35)
    np.testing.assert_allclose((runs[:, :, 4] - runs[:, :, 3]).var(axis=(0, 1)), 1.0, rtol=0.15)
    assert model.simulate(*arguments).shape == windows.states.shape


@pytest.mark.parametrize("samples", [None, 3])
def test_no_windows_give_no_simulation(walk, samples):
    model = Shaken().fit(walk, rng=0)
    empty = model.simulate(np.zeros((0, 1, 2)), np.zeros((0, 0, 1)), np.zeros((0, 4, 1)), samples=samples)
    assert empty.shape == ((0, 4, 2) if samples is None else (3, 0, 4, 2))


def test_every_sample_of_a_model_without_noise_is_its_one_simulation(walk):
    model = Lagged(state_lags=1, control_lags=2).fit(walk, rng=0)
    windows = walk.windows(5, stride=10, history=2)
    arguments = (windows.past_states, windows.past_controls, windows.controls)
    runs = model.simulate(*arguments, samples=3)
    for run in runs:
        np.testing.assert_allclose(run, model.simulate(*arguments), rtol=1e-12)


@pytest.mark.parametrize("use", [lambda m: m.system, lambda m: m.n_carry, lambda m: m.simulate(0, 0, 0)])
def test_an_unfitted_model_gives_a_clear_error(use):
    with pytest.raises(NotFitted, match=r"Lagged is not fitted yet: call fit\(dataset, rng=...\) first"):
        use(Lagged())


def test_fit_records_the_system_and_twice_the_range_of_the_training_states(walk):
    model = Lagged().fit(walk, rng=0)
    states = walk.episodes[0].states
    low, high = states.min(axis=0), states.max(axis=0)
    assert model.system is PAIR
    np.testing.assert_allclose(model.state_bounds_, [low - (high - low) / 2, high + (high - low) / 2])
    state_bounds = training_bounds(
        np.array([[1.0, 5.0], [3.0, 5.0]]), 3.0
    )  # a state that never changed keeps its value
    np.testing.assert_allclose(state_bounds, [[-1.0, 5.0], [5.0, 5.0]])


def test_a_fit_that_does_not_return_the_model_is_refused(walk):
    class Forgetful(Lagged):
        def fit(self, dataset, *, rng, progress=None):
            return None

    with pytest.raises(TypeError, match=r"Forgetful\.fit must return self, got NoneType"):
        Forgetful().fit(walk, rng=0)


def test_a_system_is_checked_before_anything_is_learned(walk):
    class Planar(Lagged):
        def check_system(self, system):
            require_planar(self, system)

        def fit(self, dataset, *, rng, progress=None):
            raise AssertionError("never reached")

    model = Planar()
    with pytest.raises(IncompatibleSystem, match="Planar describes a planar body, but the system has no motion"):
        model.fit(walk, rng=0)
    assert not hasattr(model, "system_")


def test_a_family_without_a_step_gives_an_error_with_the_methods_to_define(walk):
    class Empty(DynamicsModel):
        def fit(self, dataset, *, rng, progress=None):
            return self

    with pytest.raises(TypeError, match="Empty must define one of acceleration, next_state, step"):
        Empty().fit(walk, rng=0).step(np.zeros((1, 2)), np.zeros((1, 1)))
