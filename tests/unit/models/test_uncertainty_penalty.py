"""How far a model is doubted where a controller drives, and what that costs in fitness."""

from functools import cache

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.data.support import Support, recorded_pairs
from sysid_evo.engine import DynamicsRunner
from sysid_evo.engine.rollout import PenalisedRunner
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, InvalidData, UnknownName
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
    doubted = Penalised(Climber(LINE), UncertaintyPenalty(outside=2.0), support=support, every=4)
    heights = support.scale[0] * support.limit * np.array([0.5, 1.0, 1.25, 2.0, 5.0]) + 19.0
    carry = started(doubted, 5, np.random.default_rng(0))
    carry[:, 0] = heights
    for _ in range(8):
        carry = doubted.step(carry, np.zeros((5, 1)))
    np.testing.assert_allclose(carry[:, 1], [0.0, 0.0, 4.0, 16.0, 16.0], atol=1e-9)


def test_models_that_agree_have_no_penalty_and_those_that_disagree_have_one():
    class Twice(Climber):
        def step(self, carry, control, noise=None):
            return carry + 2.0 * control

    climbs = np.array([[0.0], [0.1], [0.15], [0.2], [1.0]])
    for other, expected in ((Climber(LINE), [0.0] * 5), (Twice(LINE), [0.0, 0.0, 1.5, 3.0, 3.0])):
        doubted = Penalised(Climber(LINE), UncertaintyPenalty(disagreement=3.0), [other], limit=np.array([0.1]))
        after = doubted.step(started(doubted, 5, np.random.default_rng(0)), climbs)
        np.testing.assert_allclose(after[:, doubted.penalty_at], expected, atol=1e-9)
        np.testing.assert_allclose(after[:, :1], climbs, err_msg="the state is that of the first model")


def test_by_default_models_may_disagree_as_much_as_they_do_in_the_training_data():
    one, other = models()
    doubted, pairs = Penalised(one, UncertaintyPenalty(disagreement=1.0), [other]), one.training_sample_
    carry = doubted.start(np.repeat(pairs[:, None, :3], 3, axis=1), np.repeat(pairs[:, None, 3:], 2, axis=1))
    assert 0.0 < (doubted.step(carry, pairs[:, 3:])[:, doubted.penalty_at] > 0).mean() < 0.03


def test_fitness_is_less_by_the_mean_penalty_and_a_diverged_trial_stays_the_worst():
    support = line(np.linspace(-1.0, 1.0, 50))
    runner = DynamicsRunner(
        Penalised(Climber(LINE, breaks_above=8.0), UncertaintyPenalty(outside=5.0), support=support, every=1)
    )
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
    robot, outside, apart = Climber(LINE), UncertaintyPenalty(outside=1.0), UncertaintyPenalty(disagreement=1.0)
    assert outside.around(robot) is robot
    assert apart.around(models()[0], [robot]) is models()[0], "a robot is no model to disagree with"
    forgetful = make_model("linear").fit(example_dataset(), rng=0)
    del forgetful.training_sample_
    for made, error, reason in (
        (lambda: UncertaintyPenalty(outside=1.0).around(forgetful), InvalidArgument, "fit it again"),
        (lambda: Penalised(robot, outside), InvalidArgument, "training data; give support="),
        (lambda: Penalised(robot, apart, [robot]), InvalidArgument, "training data; give support="),
        (lambda: Penalised(robot, apart), InvalidArgument, "other model"),
        (lambda: Penalised(robot, apart, [models()[0]]), IncompatibleSystem, "systems differ"),
        (lambda: Penalised(robot, apart, [Disturbed(robot, delay=0.1)]), InvalidArgument, "delayed"),
        (lambda: Penalised(robot, outside, every=0), InvalidArgument, "every"),
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
    inner = UncertaintyPenalty(outside=1.0, disagreement=1.0).around(models()[0], [models()[1], Climber(LINE)])
    assert isinstance(inner, Penalised)
    assert inner.penalty == UncertaintyPenalty(outside=1.0, disagreement=1.0)
    assert len(inner.members.models) == 2
    assert Disturbed(inner, delay=0.05).penalty_at == inner.penalty_at
