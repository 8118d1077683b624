"""The recurrent network against a loop over single numbers."""

import numpy as np
import pytest

from sysid_evo.controllers import RecurrentNetwork, View
from sysid_evo.errors import InvalidArgument, ShapeError
from sysid_evo.tasks import TaskState
from tests.fixtures.by_hand import network_by_hand

TRIALS = TaskState(np.empty((0, 3)), np.empty((0, 3)), np.empty(0, dtype=bool))


@pytest.mark.parametrize("hidden, inputs, outputs", [(6, 5, 2), (1, 3, 1), (4, 1, 3)])
def test_every_candidate_in_every_trial_equals_the_scalar_loop(hidden, inputs, outputs):
    rng = np.random.default_rng(4)
    network = RecurrentNetwork(hidden=hidden).bind(inputs, outputs)
    parameters = rng.standard_normal((3, network.n_parameters))
    observations = rng.standard_normal((8, 3, 2, inputs))
    memory = np.zeros((3, 2, network.n_memory))
    acted = []
    for observation in observations:
        raw, memory = network.act(parameters, memory, View(observation, observation, TRIALS))
        acted.append(raw)
    for p in range(3):
        for e in range(2):
            expected = network_by_hand(parameters[p], observations[:, p, e], hidden, outputs)
            np.testing.assert_allclose([raw[p, e] for raw in acted], expected, rtol=1e-12, atol=1e-14)


def test_the_network_of_the_paper_has_78_weights():
    assert RecurrentNetwork(hidden=6).bind(5, 2).n_parameters == 78


def test_a_candidate_acts_the_same_whoever_else_is_there():
    rng = np.random.default_rng(5)
    network = RecurrentNetwork().bind(5, 2)
    parameters = rng.standard_normal((7, 78))
    memory, observation = rng.standard_normal((7, 4, 6)), rng.standard_normal((7, 4, 5))
    raw, after = network.act(parameters, memory, View(observation, observation, TRIALS))
    for p in range(7):
        one = slice(p, p + 1)
        alone = network.act(parameters[one], memory[one], View(observation[one], observation[one], TRIALS))
        np.testing.assert_array_equal(alone[0], raw[one])
        np.testing.assert_array_equal(alone[1], after[one])


def test_binding_leaves_the_network_itself_unbound():
    network = RecurrentNetwork(hidden=3)
    assert network.bind(5, 2).n_parameters == 30
    assert network.bind(4, 1).n_parameters == 24
    assert not hasattr(network, "n_parameters")


def test_wrong_numbers_of_units_and_weights_are_refused():
    with pytest.raises(InvalidArgument, match="expected at least one hidden unit, got 0"):
        RecurrentNetwork(hidden=0)
    network = RecurrentNetwork().bind(5, 2)
    view = View(np.zeros((1, 1, 5)), np.zeros((1, 1, 3)), TRIALS)
    with pytest.raises(ShapeError, match=r"parameters: expected shape \(any, 78\), got \(1, 77\)"):
        network.act(np.zeros((1, 77)), np.zeros((1, 1, 6)), view)
