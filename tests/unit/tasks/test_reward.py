"""A task of one function, of arrays or of one sample by the names of states and controls: computed, named, refused."""

import math

import numpy as np
import pytest

from sysid_evo import register_reward
from sysid_evo.errors import IncompatibleTask, InvalidArgument, ShapeError
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import tasks
from sysid_evo.tasks.reward import Reward
from sysid_evo.tasks.task import make_task
from sysid_evo.testing import check_task
from sysid_evo.testing.examples import pendulum, switched_car
from tests.fixtures.rewards import WHERE, braked, upright, worth, worth_of_a_car, worth_of_one

SEEDS = trial_seeds(1, 3)


def fast(angular_speed):
    return abs(angular_speed) > 2.5


def rooted(angle):
    return math.sqrt(angle) + 1.0 / angle


@pytest.fixture(autouse=True)
def registered():
    register_reward("swung", min_reward=-2.0, horizon=60, terminated=fast, start=WHERE)(upright)
    register_reward("swung_in_python", min_reward=-2.0, horizon=60, terminated=fast, start=WHERE, compiled=False)(
        upright
    )
    register_reward("braked", min_reward=-2.0, horizon=40)(braked)
    register_reward("rooted", min_reward=-3.0, horizon=1)(rooted)
    register_reward("odd", min_reward=0.0, start={"torque": (0.0, 1.0)})(rooted)
    yield
    for name in ("swung", "swung_in_python", "braked", "rooted", "odd", "faster", "row", "named", "wrong"):
        if name in tasks.names():
            tasks.forget(name)


def test_fitness_is_the_mean_reward_of_the_states_in_which_controls_are_given():
    task = Reward(worth, lowest=-9.0, horizon=2).bind(pendulum())
    trial = task.begin(SEEDS[:1])
    states = np.array([[[0.0, 1.0]], [[math.pi, 0.0]], [[0.0, 0.0]]])
    for k, control in enumerate((1.0, 2.0)):
        trial, _ = task.advance(trial, states[k], states[k + 1], control=np.array([[control]]))
    assert task.fitness(trial)[0] == pytest.approx((1.0 - 0.5 + 0.1 - 1.0 - 2.0) / 2.0)


def test_a_reward_below_the_lowest_or_not_a_number_counts_as_the_lowest():
    task = Reward(lambda states, controls: states[:, 0], lowest=-2.0, horizon=1).bind(pendulum())
    before = np.array([[-5.0, 0.0], [np.nan, 0.0], [1.0, 0.0]])
    trial, _ = task.advance(task.begin(SEEDS), before, before, control=np.zeros((3, 1)))
    np.testing.assert_array_equal(task.fitness(trial), [-2.0, -2.0, 1.0])
    assert task.worst == -2.0


def test_a_trial_begins_at_start_and_ends_when_terminated_is_true():
    task = Reward(
        worth, start=lambda rng: rng.uniform(1.0, 2.0, 2), terminated=lambda states: states[:, 1] > 1.5, lowest=-9.0
    ).bind(pendulum())
    trials = task.begin(SEEDS)
    assert 1.0 <= trials.state.min() < trials.state.max() <= 2.0
    after, _ = task.advance(trials, trials.state, trials.state, control=np.zeros((3, 1)))
    np.testing.assert_array_equal(after.alive, trials.state[:, 1] <= 1.5)
    assert (
        Reward(worth, scalar=worth_of_one, terminated=lambda states: states[:, 1] > 1.5).bind(pendulum()).kernel()
        is None
    )


def test_arguments_are_taken_by_name_and_those_with_a_default_are_parameters():
    states, controls = np.array([[0.3, 9.0], [2.0, -9.0]]), np.array([[1.0], [-2.0]])
    for weight in (0.5, 0.1):
        task = make_task(f"swung(weight={weight})" if weight != 0.5 else "swung").bind(pendulum())
        np.testing.assert_allclose(task.reward(states, controls), -np.cos(states[:, 0]) - weight * controls[:, 0] ** 2)
    with pytest.raises(InvalidArgument, match=r"no parameter 'wight'. Did you mean 'weight'\?"):
        make_task("swung(wight=1)")
    with pytest.raises(InvalidArgument, match="weight: expected a finite number, got 'much'"):
        make_task("swung(weight=much)")


@pytest.mark.parametrize(
    ("name", "system", "compiled"),
    [
        ("swung", pendulum(), True), ("swung_in_python", pendulum(), False), ("braked", switched_car(), True),
        (Reward(worth, scalar=worth_of_one, lowest=-2.0, horizon=40), pendulum(), True),
        (Reward(worth, scalar=worth_of_a_car, lowest=-2.0, horizon=40), switched_car(), True),
    ],
)  # fmt: skip
def test_the_contract_is_kept_and_there_is_a_compiled_form_unless_it_is_not_wanted(name, system, compiled, register):
    if isinstance(name, Reward):
        register(tasks, "made_up_reward", lambda task=name: task)
        name = "made_up_reward"
    check_task(name, system)
    assert (make_task(name).bind(system).kernel() is not None) == compiled


def test_a_trial_begins_between_the_two_values_and_ends_when_terminated_is_true():
    task = make_task("swung").bind(pendulum())
    trials = task.begin(trial_seeds(1, 50))
    assert np.all(np.abs(trials.state[:, 0]) <= 1.0)
    assert trials.state[:, 1].min() < 0.4 < 1.6 < trials.state[:, 1].max() <= 2.0
    after = np.array([[0.0, 2.4], [0.0, -2.6]])
    state = task.begin(trial_seeds(1, 2))
    moved, _ = task.advance(state, state.state, after, control=np.zeros((2, 1)))
    assert moved.alive.tolist() == [True, False]


def faster(angular_speed, next_angular_speed, torque, weight=0.5):
    return next_angular_speed - angular_speed - weight * torque


def test_a_reward_may_depend_on_the_states_before_and_after_the_step():
    register_reward("faster", min_reward=-9.0, horizon=1)(faster)
    task = make_task("faster(weight=2.0)").bind(pendulum())
    before, after = np.array([[0.0, 1.0]]), np.array([[0.1, 4.0]])
    trial, _ = task.advance(task.begin(SEEDS[:1]), before, after, control=np.array([[0.25]]))
    assert task.fitness(trial)[0] == pytest.approx(4.0 - 1.0 - 2.0 * 0.25)
    check_task("faster", pendulum(), horizon=20)
    assert task.kernel() is not None
    arrays = Reward(lambda before, control, after: after[:, 1] - before[:, 1], horizon=1).bind(pendulum())
    trial, _ = arrays.advance(arrays.begin(SEEDS[:1]), before, after, control=np.array([[0.25]]))
    assert arrays.fitness(trial)[0] == pytest.approx(3.0)
    with pytest.raises(InvalidArgument, match="expected no scalar for a reward of three arguments"):
        Reward(lambda before, control, after: after[:, 0], scalar=lambda x, u: x[0])


def test_start_may_be_a_function_that_draws_a_state_or_values_by_name():
    def row(rng):
        return rng.uniform(0.2, 0.3, 2)

    def named(rng):
        return {"angular_speed": rng.uniform(1.0, 2.0)}

    for name, start in (("row", row), ("named", named), ("wrong", lambda rng: {"speed": 1.0})):
        register_reward(name, min_reward=-9.0, horizon=1, start=start)(faster)
    at_row, at_named = (make_task(name).bind(pendulum()).begin(SEEDS).state for name in ("row", "named"))
    assert ((at_row >= 0.2) & (at_row <= 0.3)).all()
    assert len(np.unique(at_row)) == 6
    assert ((at_named[:, 1] >= 1.0) & (at_named[:, 1] <= 2.0)).all()
    np.testing.assert_array_equal(at_named[:, 0], pendulum().neutral_state[0])
    with pytest.raises(IncompatibleTask, match="start gives 'speed'; the states are angle, angular_speed"):
        make_task("wrong").bind(pendulum()).begin(SEEDS)


def test_what_cannot_be_computed_counts_as_the_lowest():
    task = make_task("rooted").bind(pendulum())
    np.testing.assert_array_equal(
        np.isnan(task.reward(np.array([[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0]]), np.zeros((3, 1)))), [True, True, False]
    )
    before = np.array([[-1.0, 0.0]])
    trial, _ = task.advance(task.begin(trial_seeds(1, 1)), before, before, control=np.zeros((1, 1)))
    assert task.fitness(trial)[0] == -3.0


def test_what_fits_no_system_or_no_function_is_refused():
    for made, system, reason in (
        (make_task("swung"), switched_car(), r"swung needs 'torque' as a state, a control or .*forward_speed"),
        (make_task("odd"), pendulum(), "odd needs 'torque' as a state; states: angle, angular_speed"),
        (
            Reward(worth, states=("height",)),
            pendulum(),
            "needs the state 'height'; the states are angle, angular_speed",
        ),
    ):
        with pytest.raises(IncompatibleTask, match=reason):
            made.bind(system)
    with pytest.raises(InvalidArgument, match="named after states and controls, and none named horizon; got states"):
        register_reward("wrong", min_reward=0.0)(lambda *states: 0.0)
    with pytest.raises(InvalidArgument, match="got horizon"):
        register_reward("wrong", min_reward=0.0)(lambda horizon: 0.0)
    with pytest.raises(InvalidArgument, match="finite lowest"):
        Reward(worth, lowest=-np.inf)
    task = Reward(lambda states, controls: states).bind(pendulum())
    with pytest.raises(ShapeError, match="rewards: expected shape"):
        task.advance(task.begin(SEEDS), np.zeros((3, 2)), np.zeros((3, 2)), control=np.zeros((3, 1)))
