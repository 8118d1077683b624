"""Descriptors of behaviour: how much of its time each state and control is above, and below, neutral."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo.controllers.controller import make_controller
from sysid_evo.engine import behaviour_names, rollout
from sysid_evo.engine.compiled import loops
from sysid_evo.evolution import Champion
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_robot
from sysid_evo.system import System
from sysid_evo.tasks.task import make_task
from sysid_evo.types import Array
from tests.fixtures.by_hand import Climber, Constant, Ladder


def test_names_stand_in_the_order_of_states_and_controls() -> None:
    system = make_robot("emulated_car").system
    names = behaviour_names(system)
    assert names[:2] == ("forward_speed above", "forward_speed below")
    assert names[-4:] == ("drive above", "drive below", "steer above", "steer below")
    assert len(names) == 2 * (system.nx + system.nu)


def test_samples_are_counted_by_hand(ladder: System) -> None:
    """Heights begin at 0, which is neutral, and at 3; samples are those of steps 0 and 5; 0.25 is no command."""
    candidates = np.array([[1.0], [0.25], [-1.0]])
    found = rollout(Climber(ladder), Constant(), candidates, Ladder(), np.array([0, 3], dtype=np.uint64))
    assert loops.EVERY == 5
    climbs, stays, descends = found.behaviour
    np.testing.assert_array_equal(climbs, [[0.5, 0.0, 1.0, 0.0], [1.0, 0.0, 1.0, 0.0]])
    np.testing.assert_array_equal(stays[:, 2:], 0.0)
    np.testing.assert_array_equal(descends, [[0.0, 0.5, 0.0, 1.0], [0.5, 0.5, 0.0, 1.0]])


def test_only_the_time_of_the_trial_counts(ladder: System) -> None:
    """From 0 up by one a step, a trial that ends above 6 has seven steps and two samples, at 0 and at 5."""
    found = rollout(Climber(ladder), Constant(), np.array([[1.0]]), Ladder(top=6.5), np.array([0], dtype=np.uint64))
    assert found.survived[0, 0] == 7
    np.testing.assert_array_equal(found.behaviour[0, 0], [0.5, 0.0, 1.0, 0.0])


def test_a_trial_that_diverges_has_none(ladder: System) -> None:
    found = rollout(Climber(ladder, breaks_above=10.2), Constant(), np.array([[1.0]]), Ladder(), trial_seeds(1, 6))
    broken = found.fitness[0] < 0.0
    assert broken.any()
    np.testing.assert_array_equal(found.behaviour[0, broken], 0.0)


@pytest.mark.parametrize("engine", ["float64", "float32"])
def test_every_form_counts_the_same(engine: str) -> None:
    """A controller whose commands flip at every other step is seen on both sides, in every form."""
    car = make_robot("emulated_car").dynamics
    assert car is not None
    task, controller = make_task("point_to_point(horizon=101)"), make_controller("recurrent")
    candidates: Array = np.random.default_rng(0).normal(size=(5, 78))
    reference = rollout(car, controller, candidates, task, trial_seeds(0, 3), engine="reference")
    found = rollout(car, controller, candidates, task, trial_seeds(0, 3), engine=engine)  # type: ignore[arg-type]
    assert reference.behaviour.shape == (5, 3, 10)
    assert np.abs(found.behaviour - reference.behaviour).mean() < 0.02  # single samples near neutral may differ
    both = found.behaviour[..., 0::2] + found.behaviour[..., 1::2]
    assert both.max() <= 1.0 + 1e-6
    assert reference.behaviour.max() > 0.5


def test_a_champion_of_somebody_who_drives_by_hand_has_no_tensors_of_candidates() -> None:
    person = Champion("anna", np.empty(0), (), "min", 0, np.empty((0, 3)))
    assert person.tensors["finalists"].shape == (0, 0)
    assert person.tensors["population"].shape == (0, 0)
