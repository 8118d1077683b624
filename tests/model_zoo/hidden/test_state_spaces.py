"""Families with hidden states: exact on what they contain, and an observer in the carry."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sysid_evo.engine.compiled.open_loop import kernel_step
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from tests.fixtures.systems import chain, one_output


@pytest.fixture(scope="module")
def linear() -> DynamicsModel:
    return make_model("linear_state_space", order=2).fit(one_output(0, noise=0.02), rng=0)


def test_a_linear_system_is_recovered_from_its_output_alone() -> None:
    """What the observer has not found of the initial state dies out, and nothing else is off."""
    model = make_model("linear_state_space", order=2).fit(one_output(0, centre=3.0))
    fresh = one_output(1, centre=3.0)
    run = fresh.episodes[0]
    off = np.abs(model.simulate(run) - run.states[model.n_lags + 1 :])
    assert off.max() < 0.02
    assert off[-50:].max() < 1e-5


def test_the_order_is_found() -> None:
    model = make_model("linear_state_space", iterations=10, folds=1).fit(one_output(0, noise=0.01))
    assert model.gain_.shape == (2, 1)


def test_a_measured_output_corrects_the_hidden_state_and_a_free_run_does_not(linear: DynamicsModel) -> None:
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


def test_samples_repeated_before_the_first_are_no_history(linear: DynamicsModel) -> None:
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


def test_rest_is_left_by_a_control_and_kept_without_in_both_forms(linear: DynamicsModel) -> None:
    held = linear.variant(rest_hold=True)
    rest = held.start(np.zeros((1, held.n_lags + 1, 1)), np.zeros((1, held.n_lags, 1)))
    for control, moves in ((0.0, False), (1.0, True)):
        given = np.array([[control]])
        stepped = held.step(rest, given)
        assert np.array_equal(stepped, rest) != moves
        compiled = kernel_step(held.kernel(), rest, given, precision="float64")
        np.testing.assert_allclose(compiled, stepped, atol=1e-9)


FEW: dict[str, Any] = {"order": 2, "members": 2, "mixtures": 3, "trial": 3, "iterations": 2, "horizon": 100}


def test_networks_of_which_a_record_tells_too_little_are_not_taken_and_the_note_says_so() -> None:
    model = make_model("nonlinear_state_space", gated=False, **FEW)
    short = model.fit(one_output(0, 120, bend=0.01, noise=0.05), rng=0)
    assert "this is a linear state space of order 2" in short.fit_note
    assert [len(units) for units in short.inner_] == [0]
    long = model.variant().fit(one_output(0, 600, bend=0.03, noise=0.01), rng=0)
    assert not long.fit_note
    assert all(len(units) for units in long.inner_)


def test_networks_have_as_many_states_as_a_longer_chain_needs() -> None:
    """Five, which is not among the first three orders."""
    few = {"gated": False, "members": 1, "mixtures": 1, "trial": 4, "hidden": 3, "iterations": 4, "horizon": 200}
    model = make_model("nonlinear_state_space", **few).fit(chain(0), rng=0)
    assert [len(outer) for outer in model.outer_] == [5]


def test_networks_become_wider_only_where_that_pays() -> None:
    few = {"order": 2, "gated": False, "members": 1, "mixtures": 1, "trial": 5, "hidden": 2, "iterations": 10}
    for bend, waves, wider in ((0.03, 0.0, False), (0.0, 2.0, True)):
        data = one_output(0, 600, noise=0.01, bend=bend, waves=waves)
        model = make_model("nonlinear_state_space", **few).fit(data, rng=0)
        assert any(len(inner) > 2 for inner in model.inner_) == wider


@pytest.mark.parametrize("family", ["nonlinear_state_space", "latent_ode"])
def test_a_gate_lets_networks_of_a_short_record_pass_only_if_they_predict_it_better(
    family: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Asked for the impossible, it gives the linear state space in both forms, and networks again when refitted."""
    data = one_output(0, 300, bend=0.03)
    passed, stopped = (make_model(family, **FEW) for _ in range(2))
    assert not passed.fit(data, rng=0).fit_note
    monkeypatch.setattr("model_zoo.state_space.nonlinear_state_space.BETTER", 0.0)
    assert "linear state space" in stopped.fit(data, rng=0).fit_note
    assert [len(units) for units in stopped.inner_] == [0]
    windows = one_output(1).windows(1, stride=20, history=stopped.n_lags)
    carry, control = stopped.start(windows.past_states, windows.past_controls), windows.controls[:, 0]
    compiled = kernel_step(stopped.kernel(), carry, control, precision="float64")
    np.testing.assert_allclose(compiled, stopped.step(carry, control), rtol=1e-9, atol=1e-9)
    stopped.set_params(gated=False).fit(data, rng=0)
    assert stopped.flows == (family == "latent_ode")


OWN: dict[str, dict[str, Any]] = {
    "nonlinear_state_space": {"members": 3, "trial": 5, "hidden": 6, "iterations": 15, "horizon": 300},
    "latent_ode": {"members": 2, "trial": 5, "hidden": 6, "iterations": 15, "horizon": 300},
}


@pytest.mark.parametrize("family", ["nonlinear_state_space", "latent_ode"])
def test_networks_follow_a_spring_that_stiffens_where_a_linear_model_cannot(family: str) -> None:
    training, fresh = one_output(0, 600, bend=0.03, noise=0.01), one_output(1, 600, bend=0.03)
    run = fresh.episodes[0]

    def error(model: DynamicsModel) -> float:
        model.fit(training, rng=0)
        return float(np.std(model.simulate(run) - run.states[model.n_lags + 1 :]))

    linear = make_model("linear_state_space", order=2, iterations=15)
    assert error(make_model(family, order=2, **OWN[family])) < 0.3 * error(linear)
