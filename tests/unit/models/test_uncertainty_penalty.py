"""How far a model is doubted where a controller drives, and what that costs in fitness."""

from functools import cache

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.data.support import Support, recorded_pairs
from sysid_evo.engine import DynamicsRunner
from sysid_evo.engine.rollout import PenalisedRunner
from sysid_evo.errors import InvalidArgument, InvalidData, UnknownName
from sysid_evo.models import Disturbed, Penalised, UncertaintyPenalty
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry.registry import penalties
from sysid_evo.system import Channel, System
from sysid_evo.testing import example_dataset
from tests.fixtures.by_hand import Climber, Constant, Ladder, started

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


def test_the_penalty_grows_from_the_limit_to_twice_the_limit_and_one_check_counts_for_the_steps_between():
    support = line(np.arange(20.0))
    doubted = Penalised(Climber(LINE), 2.0, support=support, every=4)
    heights = support.scale[0] * support.limit * np.array([0.5, 1.0, 1.25, 2.0, 5.0]) + 19.0
    carry = started(doubted, 5, np.random.default_rng(0))
    carry[:, 0] = heights
    for _ in range(8):
        carry = doubted.step(carry, np.zeros((5, 1)))
    np.testing.assert_allclose(carry[:, 1], [0.0, 0.0, 4.0, 16.0, 16.0], atol=1e-9)


def test_fitness_is_less_by_the_mean_penalty_and_a_diverged_trial_stays_the_worst():
    support = line(np.linspace(-1.0, 1.0, 50))
    runner = DynamicsRunner(Penalised(Climber(LINE, breaks_above=8.0), 5.0, support=support, every=1))
    controls, seeds = np.array([[0.0], [-0.5], [-1.0], [1.0]]), trial_seeds(0, 2)
    plain = runner.bind(Constant(), Ladder())(controls, seeds)
    less = PenalisedRunner(runner, max_penalty=5.0).bind(Constant(), Ladder())(controls, seeds)
    diverged = plain.fitness < Ladder().worst
    assert diverged.any()
    assert plain.penalty[~diverged].max() > 0.0
    np.testing.assert_allclose(
        less.fitness, np.where(diverged, plain.fitness - 5.0, plain.fitness - plain.penalty / Ladder().horizon)
    )


def test_dynamics_without_a_penalty_are_unchanged_and_a_model_without_its_data_is_refused():
    robot = Climber(LINE)
    assert UncertaintyPenalty(outside=1.0).around(robot) is robot
    assert UncertaintyPenalty().around(models()[0]) is models()[0]
    forgetful = make_model("linear").fit(example_dataset(), rng=0)
    del forgetful.training_sample_
    for made, error, reason in (
        (lambda: UncertaintyPenalty(outside=1.0).around(forgetful), InvalidArgument, "fit it again"),
        (lambda: Penalised(robot, 1.0), InvalidArgument, "training data; give support="),
        (lambda: Penalised(Disturbed(robot, delay=0.1), 1.0), InvalidArgument, "delayed"),
        (lambda: Penalised(robot, 1.0, every=0), InvalidArgument, "every"),
        (lambda: line(np.zeros(1)), InvalidData, "two or more"),
    ):
        with pytest.raises(error, match=reason):
            made()


def test_a_penalty_is_made_from_its_text_and_a_wrong_one_is_refused():
    assert penalties.make("uncertainty(outside=3)") == UncertaintyPenalty(outside=3)
    with pytest.raises(InvalidArgument, match="outside"):
        penalties.make("uncertainty(outside=-1)")
    with pytest.raises(UnknownName, match="uncertainty"):
        penalties.make("dread")
    inner = UncertaintyPenalty(outside=1.5).around(models()[0])
    assert isinstance(inner, Penalised)
    assert inner.outside == 1.5
    assert Disturbed(inner, delay=0.05).penalty_at == inner.penalty_at
