"""Trials that end, diverge, are clipped or meet a wall on the simulated device, where every number can be followed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from sysid_evo.arrays import Seeds
from sysid_evo.system import Channel, System
from tests.sysid_evo.made_up import LadderState

from ...compiled_ladder import CompiledClimber, CompiledConstant, CompiledLadder, seeds_from
from ...test_compiled_rollout import compare

CLIMB = System((Channel("height", "m"),), (Channel("climb", "m", -1.0, 1.0, neutral=0.25),), dt=0.1)
THREE = np.array([[0.5], [0.0], [1.0]])


class Over(CompiledLadder):
    """A ladder whose trials are over at the beginning from a height of five on."""

    def begin(self, seeds: Seeds) -> LadderState:
        began = super().begin(seeds)
        return dataclasses.replace(began, alive=began.state[:, 0] < 5)


def test_trials_that_their_task_ends_stand_still() -> None:
    task = CompiledLadder(horizon=12, top=3.2)
    found, _ = compare("cuda", CompiledClimber(CLIMB), CompiledConstant(), THREE, task, seeds_from(0, 2), record=True)
    assert len(np.unique(found.survived)) > 2


def test_a_trial_that_is_over_before_it_begins_takes_no_step() -> None:
    given = (CompiledClimber(CLIMB), CompiledConstant(), np.array([[0.1]]), Over(horizon=4), seeds_from(7, 1))
    np.testing.assert_array_equal(compare("cuda", *given)[0].survived, [[0, 4]])


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # the simulator divides by zero in NumPy
def test_a_diverged_trial_has_the_same_fitness_and_number_of_steps() -> None:
    given = (CompiledClimber(CLIMB, breaks_above=3.2), CompiledConstant(), THREE, CompiledLadder(), seeds_from(2, 0, 9))
    found, _ = compare("cuda", *given, record=True)
    assert (found.fitness < 0).any()
    assert (found.fitness == 10).any()
    assert found.survived.min() == 0


def test_clipped_steps_are_counted_and_clipped_states_go_on() -> None:
    dynamics = CompiledClimber(CLIMB, envelope=np.array([[-1.0], [1.2]]))
    parameters = np.array([[0.5], [0.1], [-1.0]])
    given = (dynamics, CompiledConstant(), parameters, CompiledLadder(horizon=8), seeds_from(0, 1))
    found, _ = compare("cuda", *given, record=True)
    assert found.clipped.min() < found.clipped.max()


def test_a_wall_alters_the_state_that_goes_on() -> None:
    task = CompiledLadder(horizon=8, ceiling=0.8, top=0.9)
    given = (CompiledClimber(CLIMB), CompiledConstant(), np.array([[0.5]]), task, seeds_from(0))
    found, _ = compare("cuda", *given, record=True)
    assert found.survived.min() == 8


@pytest.mark.parametrize("candidates, trials", [(1, 1), (13, 5), (3, 7)])
def test_every_number_of_rollouts_fills_its_blocks(candidates: int, trials: int) -> None:
    parameters, seeds = np.linspace(-1, 1, candidates)[:, None], np.arange(trials, dtype=np.uint64)
    task = CompiledLadder(horizon=9, top=9.3)
    compare("cuda", CompiledClimber(CLIMB), CompiledConstant(), parameters, task, seeds)
