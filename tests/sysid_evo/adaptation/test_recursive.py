"""A correction that goes on learning: from the past alone, while it moves, believed only if it foresaw better."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo.adaptation import SelfCorrection
from sysid_evo.arrays import Array
from sysid_evo.data import Trajectory
from sysid_evo.data.support import recorded_pairs
from sysid_evo.dynamics import Dynamics
from sysid_evo.errors import InvalidArgument

from .cars import FloorCar, drive

OTHER = FloorCar(thrust=1.8)


class Recorded(FloorCar):
    """A car that knows what data it is for, as a fitted model does."""

    pairs_ = recorded_pairs(drive(FloorCar(), seconds=40.0, seed=1))


@pytest.fixture(scope="module")
def model() -> Dynamics:
    return Recorded()


def memories(learning: SelfCorrection, episode: Trajectory) -> Array:
    return np.concatenate(list(learning.along(episode)))


def thrust_lacking(learning: SelfCorrection, memory: Array) -> float:
    """Return what the coefficients add to the thrust, in m/s2."""
    now = memory[learning.places["now"]].reshape(learning.terms.shape)
    return float(now[4, 0] * learning.terms.unit[0] / learning.terms.scale[3])


def test_it_finds_what_a_model_lacks_and_opens_the_gate(model: Dynamics) -> None:
    learning = SelfCorrection.of(model, gains=False, ridge=0.01)
    seen = memories(learning, drive(OTHER, seconds=25.0, seed=2).episodes[0])
    assert thrust_lacking(learning, seen[-1]) == pytest.approx(-1.2, abs=0.2)
    opened = learning.open(seen)
    assert not opened[:100].any(), "it is not sure before five seconds"
    assert opened[-1]
    assert not np.any(learning.coefficients(seen[:100]))


def test_where_nothing_has_changed_the_gate_stays_closed(model: Dynamics) -> None:
    learning = SelfCorrection.of(model)
    assert not learning.open(memories(learning, drive(FloorCar(), seconds=20.0, seed=3).episodes[0])).any()


def test_of_coefficients_with_gains_and_without_those_are_used_that_foresaw_better(model: Dynamics) -> None:
    learning = SelfCorrection.of(model)
    memory = memories(learning, drive(OTHER, seconds=12.0, seed=2).episodes[0])[-1:]
    memory[:, learning.places["plain"]] = 1.0
    for simple, name in ((0.1, "simple_now"), (0.3, "now")):
        memory[:, learning.places["corrected"]], memory[:, learning.places["simple"]] = 0.2, simple
        expected = memory[0, learning.places[name]].reshape(learning.terms.shape)
        np.testing.assert_array_equal(learning.coefficients(memory)[0], expected)
    assert not np.any(memory[0, learning.places["simple_now"]].reshape(learning.terms.shape)[-3:])
    assert np.abs(memory[0, learning.places["now"]].reshape(learning.terms.shape)[-3:]).max() > 0.1


def test_what_it_knows_comes_from_the_past_alone(model: Dynamics) -> None:
    learning, whole = SelfCorrection.of(model), drive(OTHER, seconds=6.0, seed=2).episodes[0]
    np.testing.assert_array_equal(memories(learning, whole)[:81], memories(learning, whole[:80]))


def test_it_forgets_a_condition_that_is_over(model: Dynamics) -> None:
    learning = SelfCorrection.of(model, gains=False, forgetting=5.0, ridge=0.01)
    first, then = drive(OTHER, seconds=12.0, seed=2).episodes[0], drive(FloorCar(), seconds=20.0, seed=4).episodes[0]
    memory = memories(learning, first)[-1:]
    assert thrust_lacking(learning, memory[0]) < -0.8
    for state, control in zip(then.states[1:], then.controls, strict=True):
        memory = learning.observed(memory, state[None], control[None])
    assert abs(thrust_lacking(learning, memory[0])) < 0.3


def test_a_body_that_stands_teaches_nothing(model: Dynamics) -> None:
    learning = SelfCorrection.of(model)
    memory = memories(learning, drive(OTHER, seconds=8.0, seed=2).episodes[0])[-1:]
    for _ in range(learning.horizon + model.n_lags + 1):
        memory = learning.observed(memory, np.zeros((1, 3)), np.zeros((1, 2)))
    stood = learning.observed(memory, np.zeros((1, 3)), np.zeros((1, 2)))
    np.testing.assert_array_equal(stood[:, learning.places["normal"]], memory[:, learning.places["normal"]])


def test_trials_side_by_side_learn_each_for_itself(model: Dynamics) -> None:
    learning = SelfCorrection.of(model, horizon=5)
    one, other = (drive(car, seconds=2.0, seed=seed).episodes[0] for car, seed in ((OTHER, 2), (FloorCar(), 3)))
    memory = np.zeros((2, learning.n_memory))
    before = np.concatenate([np.zeros((1, 2, 2)), np.stack([one.controls, other.controls], axis=1)])
    for states, control in zip(np.stack([one.states, other.states], axis=1), before, strict=True):
        memory = learning.observed(memory, states, control)
    for row, alone in zip(memory, (one, other), strict=True):
        np.testing.assert_allclose(row, memories(learning, alone)[-1], rtol=1e-6, atol=1e-8)


def test_a_model_that_does_not_know_its_data_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="expected a fitted model"):
        SelfCorrection.of(FloorCar())
