"""A learned reward recovers what made it: the reward of a step, where episodes end, and the reward there."""

from dataclasses import replace

import numpy as np
import pytest

from sysid_evo.data import Dataset, Trajectory
from sysid_evo.errors import InvalidArgument, InvalidData
from sysid_evo.system import Channel, System
from sysid_evo.tasks.learned_reward import LearnedReward, distance_values, terms_of
from sysid_evo.tasks.reward_fit import fit_reward

SYSTEM = System((Channel("x"), Channel("v")), (Channel("u", low=-1.0, high=1.0),), 0.1)
PERIODIC = Channel("v", period=2.0 * np.pi)


def made(reward, ends=None, last=None, episodes=40, steps=60, seed=0, system=SYSTEM, late=None):
    """Return episodes of a block that is pushed, with ``reward(x, u, x')``, ended where ``ends(x')``.

    Those that do not end have ``late(x')`` in their last step.
    """
    rng, found = np.random.default_rng(seed), []
    for number in range(episodes):
        states, controls, rewards, ending = [rng.uniform(-1.0, 1.0, 2)], [], [], "truncated"
        for _ in range(steps):
            x, u = states[-1], rng.uniform(-1.0, 1.0, 1)
            after = np.array([x[0] + 0.1 * x[1], 0.95 * x[1] + u[0]])
            over = ends is not None and bool(ends(after))
            states.append(after)
            controls.append(u)
            rewards.append(last(after) if over and last else reward(x, u, after))
            if over:
                ending = "terminated"
                break
        if late and ending == "truncated":
            rewards[-1] = late(states[-1])
        found.append(
            Trajectory(np.array(states), np.array(controls), 0.1, name=f"{number}", rewards=rewards, ending=ending)
        )
    return Dataset(system, tuple(found))


def quadratic(x, u, after):
    return 1.0 - x[0] ** 2 + 0.5 * (after[0] - x[0]) / 0.1 - 0.1 * u[0] ** 2 + 0.2 * x[0] * u[0]


def judged(learned, x, u, after):
    rewards, over = learned.judge(SYSTEM, *(np.array([part], dtype=float) for part in (x, u, after)))
    return rewards[0], bool(over[0])


def test_a_reward_of_degree_two_in_state_control_and_next_state_is_recovered():
    learned, quality = fit_reward(made(quadratic))
    rng = np.random.default_rng(5)
    for _ in range(20):
        x, u = rng.uniform(-0.8, 0.8, 2), rng.uniform(-1.0, 1.0, 1)
        after = np.array([x[0] + 0.1 * x[1], 0.95 * x[1] + u[0]])
        reward, over = judged(learned, x, u, after)
        assert reward == pytest.approx(quadratic(x, u, after), abs=5e-3)
        assert not over
    assert quality.error < 2e-3
    assert not quality.warning
    assert quality.sentences[-1] == "Learned end: none; no recorded episode was terminated."


def test_a_reward_that_is_noise_has_a_held_out_error_of_one():
    rng = np.random.default_rng(1)
    _, quality = fit_reward(made(lambda *_: rng.standard_normal()))
    assert quality.error == pytest.approx(1.0, abs=0.03)
    assert quality.warning.startswith("The learned reward is badly known: held-out error 1e+02 %")


def test_episodes_end_where_recorded_ones_were_terminated_and_pay_what_the_last_step_paid():
    data = made(lambda *_: 1.0, ends=lambda after: abs(after[0]) > 1.2, last=lambda after: -10.0)
    learned, quality = fit_reward(data)
    assert judged(learned, [1.1, 2.0], [0.0], [1.3, 1.9]) == (-10.0, True)
    assert judged(learned, [-1.1, -2.0], [0.0], [-1.3, -1.9]) == (-10.0, True)
    assert judged(learned, [1.1, 0.0], [0.0], [1.1, 0.0]) == (1.0, False)
    ends = sum(episode.ending == "terminated" for episode in data)
    assert quality.found > 0.95
    assert f"Learned end: limits of states, from {ends} recorded ends" in quality.sentences[1]


def test_an_end_that_is_no_limit_of_one_state_is_learned_too():
    _, quality = fit_reward(made(lambda *_: 1.0, ends=lambda after: after[0] ** 2 + 0.2 * after[1] ** 2 > 2.0))
    assert quality.forms[1] == "quadratic limit"
    assert quality.found > 0.9
    assert quality.wrong < 10.0


def test_where_the_data_stop_or_the_time_is_up_nothing_ends():
    learned, quality = fit_reward(made(lambda *_: 1.0))
    assert quality.ends == 0
    assert judged(learned, [100.0, 0.0], [0.0], [100.0, 0.0]) == (1.0, False)


def nearness(after):
    return 3.0 - 2.0 * after[0] + 0.5 * after[1]


def test_a_reward_at_the_time_limit_alone_is_learned_apart():
    data = made(quadratic, late=nearness)
    learned, quality = fit_reward(data, 60)
    assert quality.error < 2e-3
    assert quality.late_error < 2e-3
    assert not quality.warning
    assert "Reward at the time limit, which differs: linear of the state reached" in quality.sentences[1]
    x, u, after = np.array([0.4, -0.5]), np.array([0.3]), np.array([0.35, -0.2])
    assert judged(learned, x, u, after)[0] == pytest.approx(quadratic(x, u, after), abs=5e-3)
    assert judged(learned.late, x, u, after)[0] == pytest.approx(nearness(after), abs=1e-2)


def test_a_reward_at_the_time_limit_is_learned_where_other_episodes_end_before():
    walls = {"ends": lambda after: abs(after[0]) > 1.5, "last": lambda after: -10.0}
    learned, quality = fit_reward(made(lambda *_: 0.0, **walls, late=nearness, steps=15, episodes=80), 15)
    assert quality.late_error < 2e-3
    assert quality.found > 0.95
    assert judged(learned, [1.4, 2.0], [0.0], [1.6, 1.9]) == (-10.0, True)
    assert judged(learned.late, [1.4, 2.0], [0.0], [1.6, 1.9]) == (-10.0, True)
    assert judged(learned.late, [0.4, 0.0], [0.0], [0.4, 0.0])[0] == pytest.approx(2.2, abs=1e-2)


@pytest.mark.parametrize("limit", [50, 0])
def test_the_last_step_of_episodes_that_end_before_the_time_limit_is_as_any_other(limit):
    learned, quality = fit_reward(made(quadratic), limit)
    assert learned.late is None
    assert not quality.forms[3]


def test_the_last_step_is_as_any_other_where_it_is_paid_so():
    learned, quality = fit_reward(made(quadratic), 60)
    assert learned.late is None
    assert quality.error < 2e-3


def test_parts_of_an_episode_are_as_long_as_the_whole():
    data = made(quadratic, late=nearness, episodes=20)
    parts = [part for episode in data for part in (episode[:40], episode[40:])]
    learned, _ = fit_reward(data.with_episodes(parts), 60)
    assert judged(learned.late, [0.4, 0.0], [0.0], [0.4, 0.0])[0] == pytest.approx(2.2, abs=1e-2)


def test_few_last_steps_that_are_paid_otherwise_are_a_reward_that_is_badly_known():
    learned, quality = fit_reward(made(quadratic, late=nearness, episodes=6), 60)
    assert learned.late is None
    assert quality.error < 2e-3
    assert "in the step at the time limit" in quality.warning


def test_a_crash_and_a_goal_are_told_apart_by_where_they_are():
    data = made(
        lambda *_: -0.1, ends=lambda after: abs(after[0]) > 1.2, last=lambda after: 100.0 if after[0] > 0 else -50.0
    )
    learned, quality = fit_reward(data)
    assert judged(learned, [1.1, 2.0], [0.0], [1.3, 1.9])[0] == pytest.approx(100.0, abs=1e-3)
    assert judged(learned, [-1.1, -2.0], [0.0], [-1.3, -1.9])[0] == pytest.approx(-50.0, abs=1e-3)
    assert quality.last_error < 0.05


def test_a_reward_is_badly_known_if_few_of_its_ends_are_found():
    rng = np.random.default_rng(1)
    _, quality = fit_reward(made(lambda *_: 1.0, ends=lambda _: rng.random() < 0.02))
    assert "of the ends of episodes are found, 60 % are needed" in quality.warning
    assert "standard deviation" not in quality.warning


def test_a_reward_with_a_kink_is_learned_by_a_network():
    learned, quality = fit_reward(made(lambda x, u, after: -abs(after[0] - 0.6), episodes=100, steps=20))
    assert quality.forms[0] == "linear terms and a network of 24 units"
    assert quality.error < 0.15  # a polynomial's and that with distances are three times as large
    for place in (-0.5, 0.6, 0.8):
        assert judged(learned, [place, 0.0], [0.0], [place, 0.0])[0] == pytest.approx(-abs(place - 0.6), abs=0.15)


def test_a_change_of_distances_is_learned_and_its_sum_depends_on_both_ends_alone():
    def approach(x, u, after):
        return 10.0 * (np.hypot(*x) - np.hypot(*after)) - 0.3 * abs(u[0])

    learned, quality = fit_reward(made(approach))
    assert quality.error < 5e-3
    assert quality.forms[0] in {f"linear terms and {count} distances" for count in (2, 4)}
    far, near, still = np.array([3.0, 4.0]), np.array([0.3, 0.4]), [0.0]
    assert judged(learned, far, still, 0.98 * far)[0] == pytest.approx(1.0, abs=0.05)
    there, back = judged(learned, near, still, -near)[0], judged(learned, -near, still, near)[0]
    assert there + back == pytest.approx(0.0, abs=0.05)


def test_a_distance_of_an_angle_goes_the_shorter_way():
    system = System((Channel("x", "rad", period=2.0 * np.pi, neutral=np.pi), Channel("v")), SYSTEM.controls, 0.1)
    table = np.array([[1.0, 0, 0, 0.0], [1.0, 0, 1, 0.0], [1.0, 0, 0, 1.0], [1.0, 2, 2, 0.0]])
    before, control, after = np.array([[-3.0, 0.0]]), np.array([[-0.5]]), np.array([[3.0, 1.0]])
    off = np.pi - 3.0
    wanted = [off, np.hypot(off, 1.0), 0.0, 0.5]
    np.testing.assert_allclose(distance_values(table, system, before, control, after)[0], wanted, atol=1e-12)


def test_an_end_inside_of_a_region_is_learned_by_trees():
    def in_a_corner(after):
        return (0.2 < after[0] < 0.8 and after[1] > 0.9) or (after[0] < -0.5 and -0.6 < after[1] < -0.1)

    learned, quality = fit_reward(made(lambda *_: 1.0, ends=in_a_corner, episodes=150, steps=30))
    assert quality.forms[1] == "boosted trees"
    assert quality.found > 0.8  # simple forms find 66 % with three times as many wrong ones
    assert quality.wrong < 25.0
    for place, over in (([0.5, 1.5], True), ([-0.9, -0.35], True), ([0.5, 0.4], False), ([-0.9, 0.4], False)):
        assert judged(learned, place, [0.0], place)[1] == over


def test_an_angle_is_learned_by_its_sine_and_cosine_and_its_change_by_the_shorter_way():
    system = System((Channel("x", "rad", period=2.0 * np.pi), Channel("v")), SYSTEM.controls, 0.1)
    learned, quality = fit_reward(made(lambda x, u, after: np.cos(after[0]), system=system))
    assert learned.fits(system)
    assert not learned.fits(SYSTEM)
    assert quality.error < 1e-3
    before, after = np.array([[3.1, 0.4]]), np.array([[-3.14, 0.4]])
    reward, _ = learned.judge(system, before, np.zeros((1, 1)), after)
    assert reward[0] == pytest.approx(-1.0, abs=5e-3)


def test_rewards_stay_near_the_recorded_ones_far_outside_of_the_data():
    learned, _ = fit_reward(made(quadratic))
    paid = np.concatenate([episode.rewards for episode in made(quadratic)])
    reward, _ = judged(learned, [1e3, 0.0], [0.0], [1e3, 0.0])
    assert reward == pytest.approx(paid.min() - np.ptp(paid), abs=1e-3)


def test_the_error_of_the_last_reward_is_small_where_it_hardly_varies_among_all_rewards():
    def goal(after):
        return 100.0 + np.sin(1e3 * after[1])

    _, quality = fit_reward(made(lambda *_: 0.0, ends=lambda after: abs(after[0]) > 1.2, last=goal))
    assert 0.02 < quality.last_error < 0.2


def test_the_text_of_a_learned_reward_holds_all_of_it():
    learned, _ = fit_reward(made(lambda *_: 1.0, ends=lambda after: abs(after[0]) > 1.2))
    again = LearnedReward.from_text(learned.to_text())
    for name, value in vars(learned).items():
        np.testing.assert_array_equal(getattr(again, name), value)
    for text in ("nothing", learned.to_text()[:-8], replace(learned, step=np.zeros(3)).to_text()):
        with pytest.raises(InvalidArgument, match="learned reward"):
            LearnedReward.from_text(text)


def test_the_text_of_a_reward_at_the_time_limit_is_part_of_it():
    learned, _ = fit_reward(made(quadratic, late=nearness), 60)
    again = LearnedReward.from_text(learned.to_text())
    for name, value in vars(learned.late).items():
        np.testing.assert_array_equal(getattr(again.late, name), value)
    other, _ = fit_reward(made(quadratic, system=replace(SYSTEM, states=(*SYSTEM.states[:1], PERIODIC))))
    with pytest.raises(InvalidArgument, match="the one at the time limit has other features"):
        LearnedReward.from_text(replace(learned, late=other).to_text())


def test_without_rewards_nothing_is_learned_and_the_message_says_what_to_record():
    data = made(quadratic)
    bare = data.with_episodes([replace(episode, rewards=None) for episode in data])
    with pytest.raises(InvalidData, match="the recording has no rewards"):
        fit_reward(bare)


def test_the_terms_of_a_polynomial_are_one_the_features_and_their_products():
    np.testing.assert_array_equal(terms_of(np.array([[2.0, 3.0]])), [[1.0, 2.0, 3.0, 4.0, 6.0, 9.0]])
