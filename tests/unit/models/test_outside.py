"""Steps outside the data of a model are counted."""

from functools import cache

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.data.support import Support, recorded_pairs
from sysid_evo.errors import InvalidArgument, InvalidData
from sysid_evo.models import Disturbed, OutsideCounter
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System
from sysid_evo.testing import example_dataset
from tests.fixtures.by_hand import Climber, started

LINE = System((Channel("height", "m"),), (Channel("climb", "m", -1.0, 1.0),), 0.1)


@cache
def models():
    return tuple(
        make_model("linear", **kind).fit(example_dataset(), rng=0) for kind in ({"state_lags": 2}, {"ridge": 200.0})
    )


def line(points):
    """Data at these heights, all of them with no climb."""
    return Support.of(LINE, points[:, None], np.zeros((len(points), 1)))


def test_little_of_another_recording_lies_outside_the_data_and_all_that_is_elsewhere():
    data = example_dataset(episodes=6)
    pairs = recorded_pairs(data)
    support = Support.of(data.system, pairs[:, :3], pairs[:, 3:])
    other = recorded_pairs(example_dataset(seed=1))
    assert (support.distances(other[:, :3], other[:, 3:]) > support.limit).mean() < 0.08
    assert (support.distances(other[:, :3] + [6.0, 0.0, 0.0], other[:, 3:]) > support.limit).all()


def test_standing_still_for_half_of_a_recording_does_not_make_its_limit_tighter():
    moving = np.linspace(0.0, 10.0, 101)
    standing = np.concatenate([moving, np.zeros(5000)])
    between = line(standing).limit * line(standing).scale[0]
    np.testing.assert_allclose(between, line(moving).limit * line(moving).scale[0])
    np.testing.assert_allclose(between, 0.1)


def test_a_model_keeps_as_many_pairs_as_are_needed_from_the_whole_recording():
    data = Dataset.from_arrays(LINE, [np.arange(10_001.0)[:, None]], [np.zeros((10_000, 1))])
    pairs = recorded_pairs(data, most=100)
    assert pairs.shape == (100, 2)
    assert pairs[0, 0] == 0.0
    assert pairs[-1, 0] == 9999.0
    assert len(recorded_pairs(data, most=20_000)) == 10_000
    np.testing.assert_array_equal(models()[0].training_sample_, recorded_pairs(example_dataset()))


def test_the_count_grows_from_the_limit_to_twice_the_limit_and_one_check_counts_for_the_steps_between():
    support = line(np.arange(20.0))
    counter = OutsideCounter(Climber(LINE), support=support, every=4)
    heights = support.scale[0] * support.limit * np.array([0.5, 1.0, 1.25, 2.0, 5.0]) + 19.0
    carry = started(counter, 5, np.random.default_rng(0))
    carry[:, 0] = heights
    for _ in range(8):
        carry = counter.step(carry, np.zeros((5, 1)))
    np.testing.assert_allclose(carry[:, 1], [0.0, 0.0, 2.0, 8.0, 8.0], atol=1e-9)


def test_a_model_without_its_data_and_a_delayed_one_are_refused():
    robot = Climber(LINE)
    forgetful = make_model("linear").fit(example_dataset(), rng=0)
    del forgetful.training_sample_
    for made, error, reason in (
        (lambda: OutsideCounter(forgetful), InvalidArgument, "give support="),
        (lambda: OutsideCounter(robot), InvalidArgument, "training data; give support="),
        (lambda: OutsideCounter(Disturbed(robot, delay=0.1)), InvalidArgument, "delayed"),
        (lambda: OutsideCounter(robot, every=0), InvalidArgument, "every"),
        (lambda: line(np.zeros(1)), InvalidData, "two or more"),
    ):
        with pytest.raises(error, match=reason):
            made()
    inner = OutsideCounter(models()[0])
    assert Disturbed(inner, delay=0.05).outside_at == inner.outside_at
