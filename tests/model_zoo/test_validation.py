"""Blocks of time, choices among settings, and the spread of a Gaussian process."""

from __future__ import annotations

import numpy as np

from model_zoo.gaussian_process import GaussianProcess
from model_zoo.neighbours import KNeighbours
from model_zoo.polynomial.narx import forward_selection
from model_zoo.polynomial.sindy import SindyDiscrete
from sysid_evo.data import Dataset
from sysid_evo.system import Channel, System
from sysid_evo.testing import example_dataset
from sysid_evo.validation.folds import time_blocks
from sysid_evo.validation.held_out import lag_candidates
from tests.benchmarks.coverage import coverage


def test_held_out_blocks_are_disjoint_and_together_everything() -> None:
    dataset = example_dataset()
    steps = 0
    for fold in range(3):
        learned, held = time_blocks(dataset, fold, 3)
        assert learned.n_steps + held.n_steps == dataset.n_steps
        rows = {tuple(state) for episode in learned for state in episode.states[1:-1]}
        assert not rows & {tuple(state) for episode in held for state in episode.states[1:-1]}
        steps += held.n_steps
    assert steps == dataset.n_steps


def test_a_short_recording_is_its_own_validation() -> None:
    dataset = example_dataset(episodes=1, steps=20)
    learned, held = time_blocks(dataset)
    assert learned is dataset
    assert held is dataset


def test_given_lags_are_kept() -> None:
    assert lag_candidates(2, 3) == [(2, 3)]
    assert lag_candidates(None, 0, ((0, 0), (1, 3))) == [(0, 0), (1, 0)]


def test_a_delayed_control_is_found_by_simulation() -> None:
    system = System((Channel("speed", "m/s"),), (Channel("drive", low=-1.0, high=1.0),), 0.05)
    rng = np.random.default_rng(2)
    control = np.repeat(rng.uniform(-1, 1, (100, 1)), 4, axis=0)
    state = np.zeros((401, 1))
    for k in range(2, 400):
        state[k + 1] = 0.8 * state[k] + 0.3 * control[k - 2]
    dataset = Dataset.from_arrays(system, [state], [control])
    model = SindyDiscrete(degree=1).fit(dataset, rng=np.random.default_rng(0))
    assert model.lags[1] >= 2
    assert any("drive[-2]" in line for line in model.equations())


def test_forward_selection_takes_the_largest_share_first() -> None:
    library = np.random.default_rng(0).standard_normal((300, 6))
    target = 3.0 * library[:, 4] + library[:, 1]
    assert forward_selection(library, target, 4).tolist()[:2] == [4, 1]
    assert len(forward_selection(library, target, 4)) == 2


def test_neighbours_never_leave_what_they_did() -> None:
    dataset = example_dataset()
    model = KNeighbours(neighbours=8, state_lags=0, control_lags=0).fit(dataset, rng=np.random.default_rng(0))
    edge = np.tile(model.high_, (4, 1))
    after = model.next_state(edge, np.ones((4, 2)))
    rounding = 1e-12  # of the difference of two states
    assert (after - edge <= model.changes_.max(axis=0) + rounding).all()
    assert (after - edge >= model.changes_.min(axis=0) - rounding).all()
    beyond = model.next_state(edge + 5.0, np.ones((4, 2)))
    assert (beyond < edge + 2.0).all()


def test_a_gaussian_process_knows_less_far_from_its_data() -> None:
    dataset = example_dataset()
    model = GaussianProcess(inducing=60, state_lags=0, control_lags=0).fit(dataset, rng=np.random.default_rng(0))
    known = model.predicted(dataset.episodes[0].states[:50], dataset.episodes[0].controls[:50])[1].mean(axis=0)
    unknown = model.predicted(np.full((1, 3), 30.0), np.ones((1, 2)))[1][0]
    assert (unknown > 1.5 * known).any()
    assert (unknown >= known).all()


def test_coverage_of_a_normal_is_ninety_per_cent() -> None:
    rng = np.random.default_rng(0)
    share = coverage(rng.standard_normal((400, 2000, 1)), rng.standard_normal((2000, 1)))
    assert abs(share[0] - 0.9) < 0.03
