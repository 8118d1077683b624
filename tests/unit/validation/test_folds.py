"""What is held out: blocks of time, whole recordings, and groups of them."""

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.system import Channel, System
from sysid_evo.testing import example_dataset
from sysid_evo.validation.folds import balanced, make_folds, recording_folds, time_fold
from sysid_evo.validation.simulation_error import horizons_of

LINE = System((Channel("x"),), (Channel("u", low=-1.0, high=1.0),), dt=0.1)


def test_held_out_blocks_are_disjoint_and_together_everything(car_data):
    dataset = car_data
    steps = 0
    for fold in range(3):
        learned, held = time_fold(dataset, fold, 3)
        assert learned.n_steps + held.n_steps == dataset.n_steps
        rows = {tuple(state) for episode in learned for state in episode.states[1:-1]}
        assert not rows & {tuple(state) for episode in held for state in episode.states[1:-1]}
        steps += held.n_steps
    assert steps == dataset.n_steps


def test_a_short_recording_is_its_own_validation():
    dataset = example_dataset(episodes=1, steps=20)
    learned, held = time_fold(dataset)
    assert learned is dataset
    assert held is dataset


def test_whole_recordings_are_held_out_and_blocks_of_time_of_a_single_one():
    data = example_dataset(episodes=4)
    pairs = make_folds(data, 3)
    assert [set(seen.names) & set(held.names) for seen, held in pairs] == [set()] * 3
    assert sorted(name for _, held in pairs for name in held.names) == sorted(data.names)
    pieces = data.with_episodes([data.episodes[0][:100], data.episodes[0][100:], data.episodes[1]])
    assert [len(held) for _, held in make_folds(pieces, 3)] == [2, 1], "pieces of one recording stay together"
    assert balanced(["a", "b", "c", "d"], [100, 30, 30, 60], 3) == [["a"], ["b", "c"], ["d"]]
    assert balanced(["a1", "a2", "b1", "b2"], [50] * 4, 2) == [["a1", "b1"], ["a2", "b2"]], "neighbours are parted"
    single = make_folds(data[0], 3)
    assert [seen.n_steps + held.n_steps for seen, held in single] == [200] * 3
    assert horizons_of(single, [10, 20, 60]) == [10, 20]


@pytest.mark.parametrize("count", [2, 4, 11])
def test_every_recording_is_held_out_once_in_at_most_four_groups(count):
    names = [f"log-{i}" for i in range(count)]
    dataset = Dataset.from_arrays(LINE, [np.zeros((9, 1))] * count, [np.zeros((8, 1))] * count, names=names)
    parts = recording_folds(dataset)
    assert len(parts) == min(4, count)
    assert sorted(name for _, held in parts for name in held.names) == sorted(names)
    assert all(not set(seen.names) & set(held.names) for seen, held in parts)
