"""A part of a very long recording: blocks of time at random places."""

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.data.dataset import thinned
from sysid_evo.system import Channel, System


@pytest.fixture
def counted():
    """Three episodes whose state is the number of the sample; 25,000 steps in all."""
    system = System(("sample",), (Channel("u", low=0.0, high=1.0),), 0.1)
    samples = [np.arange(n + 1.0) + 100_000 * i for i, n in enumerate((20_000, 400, 4_600))]
    return Dataset.from_arrays(system, samples, [np.zeros(len(x) - 1) for x in samples], names=["a", "b", "c"])


def test_short_data_stay_as_they_are_and_no_random_number_is_used(counted):
    rng = np.random.default_rng(0)
    assert thinned(counted, 25_000, rng) is counted
    assert rng.random() == np.random.default_rng(0).random()


@pytest.mark.parametrize("most", [100, 1500, 12_000, 24_999])
def test_a_part_has_at_most_so_many_steps_and_nearly_as_many(counted, most):
    few = thinned(counted, most, np.random.default_rng(0))
    block = min(1000, max(100, most // 20))
    assert most - block <= few.n_steps <= most


def test_blocks_are_runs_of_the_recording_and_no_step_comes_twice(counted):
    few = thinned(counted, 12_000, np.random.default_rng(1))
    for episode in few:
        np.testing.assert_array_equal(np.diff(episode.states[:, 0]), 1.0)
        assert len(episode) >= 400
        assert episode.name.startswith(("a[", "b[", "c["))
    first = np.concatenate([episode.states[:-1, 0] for episode in few])
    assert len(np.unique(first)) == len(first)
    assert (np.diff(first) > 0).all()


def test_another_seed_takes_other_blocks_and_the_same_seed_the_same(counted):
    one, again, other = (thinned(counted, 5_000, np.random.default_rng(seed)) for seed in (0, 0, 1))
    assert one.fingerprint == again.fingerprint != other.fingerprint
