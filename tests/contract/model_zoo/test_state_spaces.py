"""Families with hidden states: their derivatives, training and stability, and an observer in the carry."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from model_zoo.state_space import estimation
from model_zoo.state_space.estimation import EstimationProblem, StateObserver, flowing, observer, radius, stabilised
from model_zoo.state_space.nonlinear_state_space import mean_weights, networks, with_whole_orders
from model_zoo.state_space.recordings import ScaledEpisode, Scales, ShootingWindows
from model_zoo.state_space.shooting import DIVERGED_DISTANCE, StateSpaceBatch, train
from model_zoo.state_space.units import GATE, SHARP, SHARP_INPUT, UNITS
from sysid_evo.data import Dataset
from sysid_evo.models.base import make_model
from tests.fixtures.systems import OSCILLATOR, OUTPUT_ONLY, chain, one_output


def spaces(*, flow=False):
    rng, kinds = np.random.default_rng(0), [[kind, UNITS.index("gate"), UNITS.index("smooth")] for kind in range(4)]
    outer, inner = 0.3 * rng.standard_normal((4, 2, 7)), rng.standard_normal((4, 3, 4))
    return StateSpaceBatch(outer, inner, np.array([0.3, 0.2]), np.array(kinds), flow)


FORMS = pytest.mark.parametrize("flow", [False, True], ids=["step by step", "differential equation"])


def each(spaces):
    """Return the spaces of a batch one by one."""
    return [spaces[[s]] for s in range(len(spaces))]


def linear_growth(rate):
    """Return a space of one state that grows by ``rate`` a step."""
    return StateSpaceBatch.linear(np.array([[[rate, 0.1, 0.0]]]), np.ones(1))


@FORMS
def test_derivatives_are_those_of_finite_differences(flow):
    """By every parameter and every initial state, of each kind of unit."""
    many, rng = spaces(flow=flow), np.random.default_rng(1)
    windows = ShootingWindows(np.zeros((2, 7, 1)), rng.standard_normal((2, 6, 1)), np.ones((2, 7)))
    starts = rng.standard_normal((2, 2))
    flat, step = many.flat, 1e-6
    for s in range(len(many)):
        outputs, derivatives = many.sensitivities(s, starts, windows)

        def run(flat, starts, s=s):
            return many.with_flat(flat).run(starts[None].repeat(4, axis=0), windows.controls)[s, ..., :1]

        np.testing.assert_allclose(outputs, run(flat, starts))
        for place in range(flat.shape[1]):
            found = (run(flat + step * np.eye(flat.shape[1])[place], starts) - outputs) / step
            np.testing.assert_allclose(derivatives[..., place], found, rtol=1e-4, atol=1e-4)
        for state in range(2):
            found = (run(flat, starts + step * np.eye(2)[state]) - outputs) / step
            np.testing.assert_allclose(derivatives[..., flat.shape[1] + state], found, atol=1e-4)


def test_a_simulation_is_bounded_and_its_derivatives_are_those_without_bounds():
    """A bound has no slope, and training would stop at it."""
    growing, windows = linear_growth(0.5), ShootingWindows(np.zeros((1, 7, 1)), np.zeros((1, 6, 1)), np.ones((1, 7)))
    outputs, derivatives = growing.sensitivities(0, np.array([[10.0]]), windows)
    np.testing.assert_allclose(outputs[0, :, 0], 10.0 * 1.5 ** np.arange(7))
    np.testing.assert_allclose(derivatives[0, :, 0, -1], 1.5 ** np.arange(7))
    assert growing.run(np.array([[[10.0]]]), windows.controls).max() == DIVERGED_DISTANCE


@FORMS
def test_compiled_simulations_are_chained_steps_and_the_slope_is_their_difference(flow):
    many, rng = spaces(flow=flow), np.random.default_rng(1)
    starts, controls = rng.standard_normal((4, 3, 2)), rng.standard_normal((3, 5, 1))
    states, chained = starts, [starts]
    for k in range(5):
        states = many.step(states, controls[:, k])
        chained.append(states)
    np.testing.assert_allclose(many.run(starts, controls), np.stack(chained, axis=2), rtol=1e-9)
    for state in range(2):
        moved = many.step(starts + 1e-6 * np.eye(2)[state], controls[:, 0]) - many.step(starts, controls[:, 0])
        np.testing.assert_allclose(many.jacobian(starts, controls[:, 0])[..., state], moved / 1e-6, atol=1e-4)


def test_training_finds_the_space_that_made_the_data():
    rng, outer = np.random.default_rng(2), np.array([[[-0.5, 1.0, 0.3, 0.1], [-1.0, -0.5, 0.5, 0.0]]])
    true = StateSpaceBatch.linear(outer, np.array([0.3, 0.2]))
    controls = rng.standard_normal((1, 200, 1))
    outputs = true.run(np.zeros((1, 1, 2)), controls)[0, :, :, :1]
    windows = ShootingWindows.of([ScaledEpisode(outputs[0], controls[0])], 50)
    off = true.with_flat(true.flat + 0.05 * rng.standard_normal(true.flat.shape))
    starts = np.zeros((1, len(windows), 2))
    starts[..., 0] = windows.outputs[:, 0, 0]
    trained = train(off, windows, starts, 40)
    assert trained.error[0] < 1e-8


def test_a_differential_equation_steps_as_the_linear_space_it_was_made_of():
    """To the error of the Runge-Kutta method, which is small for what changes little in a sample."""
    rates = np.array([[-0.02, 0.1, 0.05, 0.01], [-0.1, -0.05, 0.02, 0.0]])
    steps, flows = (
        StateSpaceBatch.linear(rates[None], np.ones(2)),
        StateSpaceBatch.linear(flowing(rates)[None], np.ones(2), flow=True),
    )
    rng = np.random.default_rng(0)
    starts, controls = rng.standard_normal((1, 2, 2)), rng.standard_normal((2, 50, 1))
    np.testing.assert_allclose(flows.run(starts, controls), steps.run(starts, controls), atol=1e-6)
    assert radius(flows) == pytest.approx(radius(steps), rel=1e-6)


def test_a_mode_that_no_differential_equation_has_becomes_one_that_decays_fast():
    flipping = StateSpaceBatch.linear(flowing(np.array([[-1.8, 0.1, 0.0]]))[None], np.ones(1), flow=True)
    assert radius(flipping) < 0.6
    fixed = flipping.run(np.zeros((1, 1, 1)), np.ones((1, 60, 1)))[0, 0, -1, 0]
    assert fixed == pytest.approx(0.1 / 1.8)


def test_a_differential_equation_that_grows_is_brought_back():
    growing = StateSpaceBatch.linear(np.array([[[0.2, 1.0, 0.0, 0.0], [-1.0, 0.2, 0.1, 0.0]]]), np.ones(2), flow=True)
    assert radius(growing) > 1.15
    assert radius(stabilised(growing)) == pytest.approx(0.999, abs=0.01)


def test_a_unit_of_the_controls_never_sees_states_and_none_is_no_unit():
    problem = EstimationProblem.of(one_output(0, bend=0.03), 100)
    linear = problem.linear_trained(2, 3, 3, lambda: None)
    begun = networks(linear.spaces, [(SHARP_INPUT, GATE, None)], 3, np.random.default_rng(0))
    trained = train(begun, problem.short, problem.initial_states(problem.short, begun), 3).spaces
    assert np.abs(trained.outer[0, :, 4:6]).min() > 0.0
    assert (trained.inner[0, 0] == 0.0).tolist() == [True, True, False, False]
    assert (trained.inner[0, 1] != begun.inner[0, 1]).all()
    assert not trained.inner[0, 2].any()
    assert not trained.outer[0, :, 6].any()


def test_the_first_guess_of_the_states_does_not_depend_on_how_often_the_data_are_there():
    rng = np.random.default_rng(0)
    space = StateSpaceBatch.linear(np.array([[[0.9, 0.1, 0.1, 0.0], [0.0, 0.8, 0.2, 0.0]]]), np.ones(2))
    parts = [ScaledEpisode(rng.standard_normal((61, 1)), rng.standard_normal((60, 1)))]
    runs = rng.standard_normal((20, 2))
    once, twice = (observer(space, np.tile(runs, (n, 1)), np.tile(runs[:, :1], (n, 1)), parts).first for n in (1, 2))
    np.testing.assert_allclose(once, twice, rtol=1e-11)


def test_a_sample_counts_once_whatever_the_windows():
    parts = [
        ScaledEpisode(np.arange(11.0)[:, None], np.zeros((10, 1))),
        ScaledEpisode(np.arange(20.0, 25.0)[:, None], np.ones((4, 1))),
    ]
    windows = ShootingWindows.of(parts, 4)
    assert windows.rows(windows.outputs)[:, 0].tolist() == [*range(11), *range(20, 25)]
    assert windows.rows(windows.outputs)[windows.begins, 0].tolist() == windows.outputs[:, 0, 0].tolist()


def test_an_unstable_space_is_found_and_brought_back():
    assert radius(linear_growth(0.1)) == pytest.approx(1.1)
    assert radius(stabilised(linear_growth(0.1))) == pytest.approx(0.999)
    calm = linear_growth(-0.2)
    assert stabilised(calm) is calm


def test_spaces_that_diverge_under_other_controls_are_detected():
    problem = EstimationProblem.of(one_output(0), 100)
    trained = problem.linear_trained(2, 3, 3, lambda: None)
    growing = trained.spaces.outer.copy()
    growing[0, 0, 0] += 0.5 / trained.spaces.rate_scale[0]
    both = StateSpaceBatch.linear(np.concatenate([trained.spaces.outer, growing]), trained.spaces.rate_scale)
    assert problem.escapes(each(both), problem.observers(trained) * 2).tolist() == [False, True]


def quiet_recording():
    """Return the same oscillator under controls that are mostly far from their ends."""
    rng, state, outputs = np.random.default_rng(4), np.zeros(2), [0.0]
    controls = np.repeat(np.clip(0.3 * rng.standard_normal(80), -1.0, 1.0), 5)
    for u in controls:
        state = OSCILLATOR @ state + np.array([0.0, 0.15 * u])
        outputs.append(state[0])
    return Dataset.from_arrays(OUTPUT_ONLY, np.array(outputs), controls)


@pytest.mark.parametrize(
    ("data", "name", "place"),
    [(one_output(0), "HOLD_FACTOR", 3.1), (quiet_recording(), "AMPLITUDE_FACTOR", 2.8)],
    ids=["longer", "larger"],
)
def test_a_space_that_diverges_only_outside_the_recorded_range_is_detected(data, name, place, monkeypatch):
    """One of three equal spaces grows from a ``place`` on that no output reaches under the controls as recorded.

    Of a sharp unit, |s| / 2, and of s / 2 beside it a ramp is made.
    """
    problem, steep = EstimationProblem.of(data, 100), 4.0
    trained = problem.linear_trained(2, 3, 3, lambda: None)
    observers = problem.observers(trained) * 3
    three = networks(trained.spaces, [(SHARP,)] * 3, 1, np.random.default_rng(0))
    three.inner[2, 0] = [1.0, 0.0, 0.0, -place]
    three.outer[2, 0] += [steep / 2, 0.0, 0.0, -steep * place / 2, steep]
    told = getattr(estimation, name)
    for other, none in (("HOLD_FACTOR", 1), ("AMPLITUDE_FACTOR", 1), ("SHUFFLES", 0)):
        monkeypatch.setattr(estimation, other, none)
    assert not problem.escapes(each(three), observers).any()
    monkeypatch.setattr(estimation, name, told)
    assert problem.escapes(each(three), observers).tolist() == [False, False, True]
    assert not problem.escapes(each(three[[0, 2]]), observers[:2]).any()


def test_a_space_far_from_all_others_counts_as_diverged():
    problem = EstimationProblem.of(one_output(0), 100)
    trained = problem.linear_trained(2, 3, 3, lambda: None)
    outer = trained.spaces.outer.repeat(3, axis=0)
    outer[2, :, 2] *= 1.3
    three = StateSpaceBatch.linear(outer, trained.spaces.rate_scale)
    assert problem.escapes(each(three), problem.observers(trained) * 3).tolist() == [False, False, True]


def test_a_space_that_diverges_is_trained_without_a_warning():
    steps = 700
    windows = ShootingWindows(np.zeros((1, steps + 1, 1)), np.zeros((1, steps, 1)), np.ones((1, steps + 1)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        train(linear_growth(1.0), windows, np.ones((1, 1, 1)), 2)


@pytest.fixture(scope="module")
def linear():
    return make_model("linear_state_space", order=2).fit(one_output(0, noise=0.02), rng=0)


def test_a_linear_system_is_recovered_from_its_output_alone():
    """What the observer has not found of the initial state dies out, and nothing else is off."""
    model = make_model("linear_state_space", order=2).fit(one_output(0, centre=3.0))
    fresh = one_output(1, centre=3.0)
    run = fresh.episodes[0]
    off = np.abs(model.simulate(run) - run.states[model.n_lags + 1 :])
    assert off.max() < 0.02
    assert off[-50:].max() < 1e-5


def test_the_order_is_found():
    model = make_model("linear_state_space", iterations=10, folds=1).fit(one_output(0, noise=0.01))
    assert model.gain_.shape == (2, 1)


def test_a_measured_output_corrects_the_hidden_state_and_a_simulation_does_not(linear):
    """From a wrong hidden state, a model that is told the outputs finds the way back; its own output tells nothing."""
    run = one_output(2).episodes[0]
    wrong = np.concatenate([run.states[:1], np.full((1, 2), 2.0)], axis=1)
    told = free = wrong
    for k in range(30):
        told = linear.step(np.concatenate([run.states[k : k + 1], told[:, 1:]], axis=1), run.controls[k : k + 1])
        free = linear.step(free, run.controls[k : k + 1])
    assert abs(told[0, 0] - run.states[30, 0]) < 0.02
    off = free[:, :1] - free[:, 1:] @ linear.output_.T - linear.offset_
    np.testing.assert_allclose(off, 0.0, atol=1e-12)


def test_samples_repeated_before_the_first_are_no_history(linear):
    """What a short history is padded with would otherwise look like a long rest where there was none."""
    run, lags = one_output(2).episodes[0], linear.n_lags
    few = 3
    states = np.concatenate([np.repeat(run.states[:1], lags - few, axis=0), run.states[: few + 1]])
    controls = np.concatenate([np.zeros((lags - few, 1)), run.controls[:few]])
    carry = linear.start(states[None], controls[None])
    hidden = run.states[:1] @ linear.first_[:, :-1].T + linear.first_[:, -1]
    for k in range(few):
        hidden = linear.step(np.concatenate([run.states[k : k + 1], hidden], axis=1), run.controls[k : k + 1])[:, 1:]
    np.testing.assert_allclose(carry, np.concatenate([run.states[few : few + 1], hidden], axis=1))


def test_each_member_of_a_mean_starts_as_it_would_alone():
    """If all were corrected by the error of their mean, members with opposite errors would keep them."""
    data, model = one_output(0, noise=0.02), make_model("linear_state_space", order=2).fit(one_output(0), rng=0)
    problem = EstimationProblem.of(data, 100)
    trained = [problem.linear_trained(order, 3, 3, lambda: None) for order in (2, 3)]
    spaces, observers = [one.spaces for one in trained], [problem.observers(one)[0] for one in trained]
    observers = [replace(one, history=20) for one in observers]
    run, hidden = data.episodes[0], []
    for members, weights in (([0], [1.0]), ([1], [1.0]), ([0, 1], [0.3, 0.7])):
        model.set_learned(
            problem.scales, [spaces[i] for i in members], [observers[i] for i in members], np.array(weights)
        )
        hidden.append(model.start(run.states[None, 30:51], run.controls[None, 30:50])[0, 1:])
    np.testing.assert_allclose(hidden[2], np.concatenate(hidden[:2]), rtol=1e-10)


def test_members_of_similar_error_share_the_mean_and_those_that_diverge_are_left_out():
    """A tenth less error in one of them does not make it the only one."""
    found, none = np.log(np.array([1.0, 1.1, 1.2, 3.0]) ** 2), np.zeros(4, dtype=bool)
    weights = mean_weights(found, none, 4)
    assert weights[0] < 0.7
    assert weights[1] > 0.25
    assert weights[3] == 0.0
    assert weights.sum() == pytest.approx(1.0)
    assert mean_weights(found, none, 2)[2] == 0.0
    assert mean_weights(found, np.array([True, False, False, False]), 4)[0] == 0.0
    assert mean_weights(found, ~none, 4).tolist() == weights.tolist()


def test_an_order_of_which_half_the_members_diverge_is_left_out():
    orders = np.array([2, 2, 3, 3])
    assert with_whole_orders(np.array([False, False, True, False]), orders).tolist() == [False, False, True, True]
    assert with_whole_orders(np.array([True, False, False, False, False]), np.array([2, 2, 2, 3, 3])).sum() == 1
    assert with_whole_orders(np.array([True, False, True, False]), orders).tolist() == [True, False, True, False]


def test_a_space_that_diverges_only_after_thousands_of_steps_is_detected():
    """The simulations are as long as the longest episode."""
    late = StateSpaceBatch.linear(np.array([[[0.0015, 0.001, 0.0]]]), np.ones(1))
    observers = [StateObserver(np.zeros((1, 1)), np.zeros((1, 2)), 4)]
    outputs = np.sin(0.1 * np.arange(8001.0))[:, None]
    for steps, diverges in ((3000, False), (8000, True)):
        part = ScaledEpisode(outputs[: steps + 1], np.full((steps, 1), 0.02))
        problem = EstimationProblem(Scales.of(one_output(0)), [part], 1000)
        assert problem.escapes([late], observers).tolist() == [diverges]


def test_orders_of_similar_error_are_averaged():
    data = one_output(0, 600, bend=0.03, noise=0.01)
    few = {**FEW, "members": 4, "order": None, "screening_iterations": 4, "iterations": 6}
    model = make_model("nonlinear_state_space", gated=False, **few).fit(data, rng=0)
    orders = [len(outer) for outer in model.outer_]
    assert len(orders) <= 4
    assert len(set(orders)) == 2


FEW = {"order": 2, "members": 2, "mixtures": 3, "screening_iterations": 3, "iterations": 2, "horizon": 100}


def test_a_record_too_short_for_networks_gives_a_linear_space_and_a_note():
    model = make_model("nonlinear_state_space", gated=False, **FEW)
    short = model.fit(one_output(0, 120, bend=0.01, noise=0.05), rng=0)
    assert "this is a linear state space of order 2" in short.fit_note
    assert [len(units) for units in short.inner_] == [0]
    long = model.variant().fit(one_output(0, 600, bend=0.03, noise=0.01), rng=0)
    assert not long.fit_note
    assert all(len(units) for units in long.inner_)


def test_networks_have_as_many_states_as_a_longer_chain_needs():
    """Five, which is not among the first three orders."""
    few = {
        "gated": False,
        "members": 1,
        "mixtures": 1,
        "screening_iterations": 4,
        "hidden": 3,
        "iterations": 4,
        "horizon": 200,
    }
    model = make_model("nonlinear_state_space", **few).fit(chain(0), rng=0)
    assert [len(outer) for outer in model.outer_] == [5]


def test_networks_become_wider_only_where_that_pays():
    few = {
        "order": 2,
        "gated": False,
        "members": 1,
        "mixtures": 1,
        "screening_iterations": 5,
        "hidden": 2,
        "iterations": 10,
    }
    for bend, waves, wider in ((0.03, 0.0, False), (0.0, 2.0, True)):
        data = one_output(0, 600, noise=0.01, bend=bend, waves=waves)
        model = make_model("nonlinear_state_space", **few).fit(data, rng=0)
        assert any(len(inner) > 2 for inner in model.inner_) == wider


@pytest.mark.parametrize("family", ["nonlinear_state_space", pytest.param("latent_ode", marks=pytest.mark.nightly)])
def test_networks_of_a_short_record_are_accepted_only_if_they_predict_better(family, monkeypatch):
    """Asked for the impossible, it gives the linear state space, and networks again when refitted."""
    data = one_output(0, 300, bend=0.03)
    passed, stopped = (make_model(family, **FEW) for _ in range(2))
    assert not passed.fit(data, rng=0).fit_note
    monkeypatch.setattr("model_zoo.state_space.nonlinear_state_space.REQUIRED_RATIO", 0.0)
    assert "linear state space" in stopped.fit(data, rng=0).fit_note
    assert [len(units) for units in stopped.inner_] == [0]
    stopped.set_params(gated=False).fit(data, rng=0)
    assert stopped.flows == (family == "latent_ode")


OWN = {
    "nonlinear_state_space": {"members": 3, "screening_iterations": 5, "hidden": 6, "iterations": 15, "horizon": 300},
    "latent_ode": {"members": 2, "screening_iterations": 5, "hidden": 6, "iterations": 15, "horizon": 300},
}


@pytest.mark.parametrize("family", ["nonlinear_state_space", "latent_ode"])
def test_networks_follow_a_spring_that_stiffens_where_a_linear_model_cannot(family):
    training, fresh = one_output(0, 600, bend=0.03, noise=0.01), one_output(1, 600, bend=0.03)
    run = fresh.episodes[0]

    def error(model):
        model.fit(training, rng=0)
        return float(np.std(model.simulate(run) - run.states[model.n_lags + 1 :]))

    linear = make_model("linear_state_space", order=2, iterations=15)
    assert error(make_model(family, order=2, **OWN[family])) < 0.3 * error(linear)
