"""Rewards and endings of episodes: cut, stored, loaded, as a table; models and fingerprints do not see them."""

from dataclasses import replace

import numpy as np
import pytest

from sysid_evo.data import Dataset, Trajectory
from sysid_evo.data.trajectory import reward_digest
from sysid_evo.errors import InvalidData, ShapeError
from sysid_evo.system import Channel, System

SYSTEM = System((Channel("x"),), (Channel("u"),), 0.1)


def episode(name="one", steps=4, **others):
    states, controls = np.arange(steps + 1.0), np.ones(steps)
    return Trajectory(states, controls, 0.1, name=name, **{"rewards": np.arange(steps) + 0.5, **others})


def test_the_return_of_an_episode_is_the_sum_of_its_rewards():
    assert episode().total_reward == 0.5 + 1.5 + 2.5 + 3.5
    assert episode(rewards=None).total_reward is None


def test_a_part_of_an_episode_has_its_rewards_and_only_the_last_part_the_ending():
    whole = episode(ending="terminated")
    np.testing.assert_array_equal(whole[1:3].rewards, [1.5, 2.5])
    assert (whole[1:3].ending, whole[2:4].ending) == ("", "terminated")


def test_rewards_and_endings_are_stored_and_loaded(tmp_path):
    dataset = Dataset(SYSTEM, (episode(ending="truncated"), episode("two", 2, rewards=None), episode("three")))
    loaded = Dataset.load(dataset.save(tmp_path / "data"))
    np.testing.assert_array_equal(loaded.episodes[0].rewards, dataset.episodes[0].rewards)
    assert loaded.episodes[1].rewards is None
    assert [one.ending for one in loaded] == ["truncated", "", ""]
    assert reward_digest(loaded) == reward_digest(dataset) != ""


def test_a_table_has_a_column_for_rewards_and_two_for_endings_and_gives_them_back():
    dataset = Dataset(SYSTEM, (episode(ending="terminated"), episode("two", ending="truncated")))
    table = dataset.to_pandas()
    assert table["terminated"].tolist() == [False] * 3 + [True] + [False] * 6
    again = Dataset.from_pandas(SYSTEM, table, episode="episode")
    for one, other in zip(again, dataset, strict=True):
        np.testing.assert_array_equal(one.rewards, other.rewards)
        assert one.ending == other.ending
    assert "reward" not in Dataset(SYSTEM, (episode(rewards=None),)).to_pandas()


def test_rewards_do_not_change_the_fingerprint_of_a_data_set_but_have_a_digest():
    paid, unpaid = (Dataset(SYSTEM, (episode(rewards=rewards),)) for rewards in (np.ones(4), None))
    assert paid.fingerprint == unpaid.fingerprint
    assert reward_digest(unpaid) == ""
    assert reward_digest(paid) != reward_digest([replace(paid.episodes[0], rewards=2.0 * np.ones(4))])
    assert reward_digest(paid) != reward_digest([replace(paid.episodes[0], ending="terminated")])


@pytest.mark.parametrize(
    "others, error, words",
    [
        ({"rewards": np.ones(3)}, ShapeError, "rewards of"),
        ({"rewards": np.array([1.0, np.nan, 1.0, 1.0])}, InvalidData, "reward 0 at sample 1 is nan"),
        ({"ending": "over"}, InvalidData, "expected the ending 'terminated', 'truncated' or none, got 'over'"),
    ],
)
def test_wrong_rewards_are_refused(others, error, words):
    with pytest.raises(error, match=words):
        episode(**others)
