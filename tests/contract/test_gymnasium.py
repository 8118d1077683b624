"""Environments of Gymnasium as robots: channels, actions, recordings, controllers in them, their reward as a task."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from hardware.preflight import check_recording
from hardware.robot import find_robot
from hardware.run_report import StopReason, StopRequest
from hardware.simulators.gymnasium_robot import GymnasiumRobot
from hardware.simulators.gymnasium_spaces import parse_angles
from hardware.simulators.gymnasium_task import RULES, EnvironmentTask
from hardware.testing import check_robot
from sysid_evo.angles import TURN
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import DynamicsRunner
from sysid_evo.errors import IncompatibleSystem, IncompatibleTask, InvalidArgument, LinkLost
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.system import Channel
from sysid_evo.tasks import Task, TaskState
from sysid_evo.testing import check_task
from sysid_evo.testing.examples import pendulum
from sysid_evo.types import Array

CLASSIC = ("Pendulum-v1", "CartPole-v1", "MountainCar-v0", "MountainCarContinuous-v0", "Acrobot-v1")
ROTOR, SLIDER, STRAY = "Rotor-v0", "Slider-v0", "Stray-v0"
SEEDS = trial_seeds(5, 4)
FULL = np.zeros((1, 24))
FULL[0, 9:12], FULL[0, 21:24] = 5.0, 5.0  # the bias drives the outputs of a network to the limit


@pytest.fixture(scope="module", autouse=True)
def small():
    from tests.fixtures import environments

    environments.register()
    return environments


def rotor(**parameters):
    return GymnasiumRobot(id=ROTOR, **parameters)


def network(task, system, candidates=2):
    controller = RecurrentNetwork(hidden=3)
    size = controller.bind(len(task.bind(system).observations), system.nu).n_parameters
    return controller, np.random.default_rng(0).standard_normal((candidates, size))


@pytest.mark.parametrize("name", CLASSIC)
def test_the_states_of_a_classic_environment_are_its_own_in_its_own_order(name):
    robot = GymnasiumRobot(id=name)
    with robot.simulator.open() as session:
        inner = session._env.unwrapped
        state = session.reset(3)
        for k in range(5):
            np.testing.assert_allclose(np.sin(state), np.sin(np.asarray(inner.state, dtype=float)), atol=1e-5)
            state, *_ = session.step(robot.system.actuate(np.array([0.9, -0.9][k % 2 : k % 2 + 1])))


@pytest.mark.parametrize("name", CLASSIC)
def test_a_classic_environment_can_begin_in_any_state(name):
    environment = GymnasiumRobot(id=name).simulator
    start = np.array([0.1, 0.02, -0.05, 0.03][: environment.system.nx])
    control = environment.system.actuate(np.array([0.5]))
    with environment.open() as session:
        first, second = (session.reset(seed, start) for seed in (1, 2))
        np.testing.assert_array_equal(first, start)
        once = session.step(control)[0]
        session.reset(7, second)
        np.testing.assert_array_equal(session.step(control)[0], once)


def test_the_robot_keeps_the_contract_of_robots_and_is_not_a_physical_one():
    check_robot("gymnasium", id="CartPole-v1")
    assert not find_robot('gymnasium(id="CartPole-v1")').physical
    assert find_robot("serial").physical


def test_channels_and_controls_get_other_names_and_keep_all_else():
    plain = GymnasiumRobot(id="Pendulum-v1").system
    named = GymnasiumRobot(id="Pendulum-v1", channels="tilt [rad], rate", controls="motor [mN m]").system
    assert (named.state_names, named.controls[0].name, named.controls[0].unit) == (("tilt", "rate"), "motor", "mN m")
    kept = [
        [(c.low, c.high, c.levels, c.neutral, c.period, c.description) for c in (*system.states, *system.controls)]
        for system in (plain, named)
    ]
    assert kept[0] == kept[1]
    assert GymnasiumRobot(id="CartPole-v1", controls="push").system.controls[0].levels == (-10.0, 10.0)
    with pytest.raises(InvalidArgument, match=r"controls: expected 1 names.*force"):
        GymnasiumRobot(id="CartPole-v1", controls="left, right")


def test_a_cosine_and_its_sine_become_one_periodic_state_in_the_place_of_the_first():
    plain, round_ = rotor(angle=""), rotor(angle="1,2")
    assert rotor().system == round_.system
    assert plain.system.state_names == ("observation_0", "observation_1", "observation_2")
    assert round_.system.state_names == ("observation_0", "angle_1")
    assert round_.system.periods == {1: TURN}
    np.testing.assert_allclose(round_.simulator.observations.state([0.5, np.cos(2.5), np.sin(2.5)]), [0.5, 2.5])
    named = rotor(angle="1,2", channels="speed [rad/s], angle").system
    assert [(c.name, c.unit) for c in named.states] == [("speed", "rad/s"), ("angle", "rad")]
    assert named.periods == {1: TURN}
    assert (plain.system.states[1].high, plain.system.states[0].high) == (1.0, np.inf)


def test_angles_are_read_from_their_text():
    assert parse_angles("x", "0,1; 4", 5) == ((0, 1), (4,))
    assert parse_angles("x", "", 5) == ()


def test_the_time_of_a_step_is_what_the_environment_says_unless_it_is_given():
    robots = (rotor(), rotor(dt=0.02), GymnasiumRobot(id="CartPole-v1"), GymnasiumRobot(id="Pendulum-v1"))
    assert [robot.system.dt for robot in robots] == [0.1, 0.02, 0.02, 0.05]
    assert GymnasiumRobot(id="Timeless-v0").system.dt == 0.05


@pytest.mark.parametrize(
    ("actions", "levels", "control", "action"),
    [
        ("discrete", [(-1.0, 0.0, 1.0)], [1.0], 1),
        ("several", [(0.0, 1.0, 2.0), (0.0, 1.0)], [2.0, 0.0], [2, 0]),
        ("binary", [(0.0, 1.0), (0.0, 1.0)], [0.0, 1.0], [0, 1]),
        ("box", [None], [0.25], [0.25]),
    ],
)
def test_actions_become_controls_and_controls_actions(actions, levels, control, action):
    robot = rotor(settings={"actions": actions})
    assert [channel.levels for channel in robot.system.controls] == levels
    with robot.simulator.open() as session:
        session.reset(0)
        session.step(np.array(control))
        np.testing.assert_array_equal(session._env.unwrapped.given, action)


def test_the_force_of_the_cart_has_the_sign_of_its_push():
    with GymnasiumRobot(id="CartPole-v1").simulator.open() as session:
        for force in (10.0, -10.0):
            session.reset(0, np.zeros(4))
            assert session.step(np.array([force]))[0][1] * force > 1.0


@pytest.mark.parametrize(
    ("parameters", "error", "words"),
    [
        ({"id": "Pendulum-v99"}, InvalidArgument, "cannot make the environment 'Pendulum-v99'"),
        ({"id": ROTOR, "angle": "1,7"}, InvalidArgument, "from 0 to 2; got '1,7'"),
        ({"id": ROTOR, "angle": "x"}, InvalidArgument, "expected the numbers of a cosine and of its sine"),
        ({"id": ROTOR, "angle": "1,2; 2"}, InvalidArgument, "occurs in two angles"),
        ({"id": ROTOR, "channels": "speed"}, InvalidArgument, "expected 2 names"),
        ({"id": ROTOR, "dt": 0.0}, InvalidArgument, "dt: expected a number above 0"),
        ({"id": ROTOR, "settings": {"limit": np.inf}}, IncompatibleSystem, "with finite limits.*TransformAction"),
        ({"id": STRAY}, InvalidArgument, r"argument: 'case'.*are given by settings=\{name: value\}"),
        ({"id": STRAY, "settings": {"case": "raises"}}, IncompatibleSystem, r"lost its block \(environments.py, line"),
        ({"id": "Scaled-v0"}, IncompatibleSystem, "NormalizeObservation changes its scale from step to step"),
        ({"id": "FrozenLake-v1"}, IncompatibleSystem, "expected a Box of at most 64 observations in a row"),
    ],
)
def test_what_cannot_be_a_robot_is_refused_in_a_sentence(parameters, error, words):
    with pytest.raises(error, match=words):
        GymnasiumRobot(**parameters)


def test_the_control_loop_is_not_for_environments():
    with pytest.raises(IncompatibleSystem, match="it has no clock and no tracker"):
        rotor().connect()


def recorded(name, duration, seed=0):
    return GymnasiumRobot(id=name).record(seed=seed, duration=duration).dataset


def test_a_recording_replays_in_the_environment_itself():
    robot = GymnasiumRobot(id="Pendulum-v1")
    dataset = robot.record(seed=1, duration=50.0).dataset
    with robot.simulator.open() as session:
        for episode in dataset.episodes[::4]:
            steps = list(zip(episode.states, episode.controls, episode.states[1:], strict=False))
            for state, control, after in steps[::20]:
                session.reset(0, state)
                np.testing.assert_allclose(dataset.system.difference(session.step(control)[0], after), 0.0, atol=2e-5)


def test_the_same_seed_gives_the_same_recording_and_another_seed_another():
    one, same, other = (recorded("CartPole-v1", 20.0, seed).fingerprint for seed in (1, 1, 2))
    assert one == same != other


def test_a_step_without_a_number_ends_the_episode_and_is_left_out():
    found = GymnasiumRobot(id=STRAY, settings={"case": "nan"}).record(seed=0, duration=90.0)
    assert all(np.isfinite(episode.rewards).all() for episode in found.dataset)
    assert "steps were left out, since their numbers are not finite" in found.report.sentence
    runner = GymnasiumRobot(id=STRAY, settings={"case": "nan"}).runner()
    run = runner.bind(RecurrentNetwork(hidden=3), Counting(horizon=100))(FULL[:, :21], SEEDS, record=True)
    assert all(np.isfinite(episode.rewards).all() for episode in run.trajectories)


def test_an_environment_may_have_limits_that_it_exceeds_and_rewards_that_are_arrays():
    assert GymnasiumRobot(id=STRAY, settings={"case": "narrow"}).system.states[0].high == np.inf
    data = GymnasiumRobot(id=STRAY, settings={"case": "array"}).record(seed=0, duration=90.0).dataset
    assert data.episodes[0].rewards is not None


def test_a_trial_lasts_as_long_as_an_environment_that_limits_the_time_by_itself():
    assert EnvironmentTask(id="Short-v0").horizon == 30


def test_every_episode_ends_where_the_environment_ends_it(small):
    dataset = recorded(ROTOR, 100.0)
    speeds = [episode.states[:, 0] for episode in dataset]
    assert all((np.abs(speed[:-1]) <= small.BREAKS + 1e-6).all() for speed in speeds)
    assert any(abs(speed[-1]) > small.BREAKS for speed in speeds)
    assert max(len(episode) for episode in dataset) == 50
    assert dataset.n_steps == pytest.approx(1000, abs=20)


def test_a_recording_and_a_run_keep_the_rewards_and_how_each_episode_ended(small):
    data = rotor(angle="1,2").record(seed=3, duration=90.0).dataset
    for episode in data:
        np.testing.assert_allclose(episode.rewards, -(episode.states[1:, 0] ** 2), atol=1e-5)
        over = abs(episode.states[-1, 0]) > small.BREAKS
        assert episode.ending == ("terminated" if over else "truncated" if len(episode) == 50 else "")
    assert {episode.ending for episode in data} == {"terminated", "truncated", ""}
    run = rotor().runner().bind(RecurrentNetwork(hidden=3), Counting(horizon=100))(FULL, SEEDS, record=True)
    for episode in run.trajectories:
        np.testing.assert_allclose(episode.rewards, -(episode.states[1:, 0] ** 2), atol=1e-5)
        assert episode.ending == "terminated"


def test_every_script_is_in_the_recording_and_uses_both_halves_of_the_control():
    dataset = recorded("MountainCarContinuous-v0", 40.0)
    names = {episode.name.rpartition("-")[0] for episode in dataset}
    assert names == {"steps-1", "steps-4", "steps-12", "sweep", *(f"feedback-{i}" for i in range(1, 5))}
    for name in names:
        controls = np.concatenate([e.controls for e in dataset if e.name.rpartition("-")[0] == name])
        assert controls.min() < -0.2 < 0.2 < controls.max(), name


def test_random_feedback_keeps_a_cart_with_a_pole_going_where_fixed_sequences_do_not():
    dataset = recorded("CartPole-v1", 160.0)
    feedback = max(len(episode) for episode in dataset if episode.name.startswith("feedback"))
    fixed = max(len(episode) for episode in dataset if not episode.name.startswith("feedback"))
    assert feedback > 300 > 2 * fixed


def test_a_linear_model_of_the_cart_predicts_it_from_a_minute():
    training, test = recorded("CartPole-v1", 60.0), recorded("CartPole-v1", 20.0, seed=9)
    assert make_model("linear").fit(training).score(test) > -0.2


def test_a_recording_that_is_too_short_is_refused_and_says_how_long_it_must_be():
    with pytest.raises(InvalidArgument, match=r"expected at least 0\.67 min for 8 scripts"):
        recorded("Pendulum-v1", 20.0)
    robot = GymnasiumRobot(id="Acrobot-v1")
    check_recording(robot, None, duration=180.0)  # needs no loop and no tracker
    with pytest.raises(InvalidArgument, match=r"at least 2\.7 min for 8 scripts of 100 samples, got 1 min"):
        check_recording(robot, None, duration=60.0)


def test_a_stop_ends_the_recording_and_keeps_what_there_is():
    robot = GymnasiumRobot(id="Pendulum-v1")
    with StopRequest() as stops:
        made = robot.record(seed=0, duration=60.0, stop=stops, progress=lambda *_: stops.request(StopReason.SIGINT))
    assert made.report.reason is StopReason.SIGINT
    assert len(made.dataset) == 1
    with pytest.raises(LinkLost, match="Pendulum-v1: interrupted; nothing was recorded"):
        robot.record(seed=0, duration=60.0, stop=stops)


@dataclass(frozen=True)
class Counted(TaskState):
    count: Array


class Counting(Task):
    """Counts what the control is, and ends where the first state passes ``end``."""

    worst = -1e6

    def __init__(self, horizon=30, end=np.inf, start=0.0):
        self.horizon, self.end, self.start = horizon, end, start

    def check_system(self, system):
        self.observations = tuple(Channel(name) for name in (*system.regressor_names, "bias"))

    def begin(self, seeds):
        state = np.tile(self.system.neutral_state, (len(seeds), 1))
        state[:, 0] += self.start + 1e-3 * np.arange(len(seeds))
        return Counted(state, np.zeros((len(seeds), 0)), np.ones(len(seeds), dtype=bool), np.zeros(len(seeds)))

    def observe(self, task_state, state):
        return np.column_stack([self.system.regressors(state), np.ones(len(state))])

    def advance(self, task_state, before, after, *, control, pose=None):
        return replace(task_state, count=task_state.count + control[:, 0], alive=after[:, 0] <= self.end), after

    def fitness(self, task_state):
        return task_state.count.copy()


def by_hand(robot, task, parameters, seed, at):
    """Return fitness and states of one trial, with the environment as its maker gave it."""
    import gymnasium

    env = gymnasium.make(robot.name)
    observation, _ = env.reset(seed=int(seed) % 2**31)
    if at is not None:
        env.unwrapped.state = np.array(at)
    task, total = task.bind(robot.system), 0.0
    states = [robot.simulator.observations.state(observation) if at is None else at]
    i, h, memory = len(task.observations), 3, np.zeros(3)
    w_in, w_h = parameters[: i * h].reshape(i, h), parameters[i * h : (i + h) * h].reshape(h, h)
    w_out = parameters[(i + h) * h :].reshape(h, robot.system.nu)
    for _ in range(task.horizon):
        seen = np.append(robot.system.regressors(states[-1]), 1.0)
        memory = np.tanh(seen @ w_in + memory @ w_h)
        control = robot.system.actuate(np.tanh(memory @ w_out))
        total += control[0]
        observation, _, ended, late, _ = env.step(robot.simulator.actions.action(control))
        states.append(robot.system.unwrap_towards(robot.simulator.observations.state(observation), states[-1]))
        if ended or late or states[-1][0] > task.end:
            break
    return total, np.array(states)


@pytest.mark.parametrize("name", ["Pendulum-v1", "CartPole-v1", "MountainCar-v0", ROTOR])
def test_every_trial_is_what_a_loop_written_by_hand_gives(name):
    robot, task = GymnasiumRobot(id=name), Counting(start=0.05)
    controller, parameters = network(task, robot.system)
    found = robot.runner().bind(controller, task)(parameters, SEEDS, record=True)
    starts = task.bind(robot.system).begin(SEEDS).state
    trajectories = iter(found.trajectories)
    for candidate in range(2):
        for trial, seed in enumerate(SEEDS):
            at = starts[trial] if robot.simulator.settable else None
            fitness, states = by_hand(robot, task, parameters[candidate], seed, at)
            assert found.fitness[candidate, trial] == pytest.approx(fitness, abs=1e-5)
            assert found.survived[candidate, trial] == len(states) - 1
            np.testing.assert_allclose(next(trajectories).states, states, atol=1e-5)


def test_the_same_trials_give_the_same_fitness_however_many_candidates_run_beside():
    robot, task = GymnasiumRobot(id="CartPole-v1"), Counting()
    controller, parameters = network(task, robot.system, candidates=70)
    together = robot.runner().bind(controller, task)(parameters, SEEDS)
    alone = robot.runner().bind(controller, task)(parameters[65:66], SEEDS)
    np.testing.assert_array_equal(together.fitness[65], alone.fitness[0])
    np.testing.assert_array_equal(together.behaviour[65], alone.behaviour[0])
    assert (together.behaviour >= 0.0).all()
    assert together.behaviour.max() > 0.0
    assert together.fitness.shape == (70, 4)


@pytest.mark.parametrize(("end", "steps"), [(np.inf, 30), (0.55, 6)], ids=["environment", "task"])
def test_a_trial_is_over_when_the_environment_or_the_task_ends_it(end, steps, small):
    controller, task = RecurrentNetwork(hidden=3), Counting(horizon=100, end=end)
    found = rotor().runner().bind(controller, task)(FULL, SEEDS, record=True)
    assert (found.survived == steps).all()
    if end == np.inf:
        assert all(abs(t.states[-1, 0]) > small.BREAKS >= abs(t.states[-2, 0]) - 1e-5 for t in found.trajectories)


def test_an_environment_that_returns_no_number_is_a_trial_that_diverged():
    task = Counting(horizon=40)
    found = rotor(settings={"bad": True}).runner().bind(RecurrentNetwork(hidden=3), task)(FULL, SEEDS)
    assert (found.survived == 5).all()
    np.testing.assert_allclose(found.fitness, task.worst - 1.0 + 5 / 40)


def test_a_run_without_a_trial_is_refused():
    with pytest.raises(InvalidArgument, match="at least one candidate and one seed"):
        rotor().runner().bind(RecurrentNetwork(hidden=3), Counting())(FULL, SEEDS[:0])


@pytest.mark.parametrize("name", [*CLASSIC, SLIDER])
def test_the_task_of_an_environment_keeps_the_contract_on_the_robots_system(name):
    check_task("environment", GymnasiumRobot(id=name).system, id=name, horizon=12 if name == SLIDER else 30)


@pytest.mark.parametrize("name", CLASSIC)
def test_reward_and_end_of_every_step_are_those_of_the_environment(name):
    robot = GymnasiumRobot(id=name)
    task = EnvironmentTask(id=name).bind(robot.system)
    rng = np.random.default_rng(0)
    low = np.array([max(c.low, -6.0) for c in robot.system.states])
    high = np.array([min(c.high, 6.0) for c in robot.system.states])
    ends = set()
    with robot.simulator.open() as session:
        for _ in range(300):
            state = session.reset(0, rng.uniform(low, high))
            control = robot.system.actuate(rng.uniform(-1.0, 1.0, robot.system.nu))
            after, reward, over, _ = session.step(control)
            trial, _ = task.advance(task.begin(trial_seeds(0, 1)), state[None], after[None], control=control[None])
            assert task.fitness(trial)[0] == pytest.approx(reward, abs=1e-4)
            assert trial.alive[0] == (not over)
            ends.add(over)
    assert ends == ({False} if name == "Pendulum-v1" else {True, False})


@pytest.mark.parametrize("name", CLASSIC)
def test_a_trial_begins_where_the_environment_does_with_its_seed_and_lasts_as_long(name):
    robot, seeds = GymnasiumRobot(id=name), trial_seeds(4, 3)
    task = EnvironmentTask(id=name).bind(robot.system)
    with robot.simulator.open() as session:
        for start, seed in zip(task.begin(seeds).state, seeds, strict=True):
            np.testing.assert_allclose(np.cos(start), np.cos(session.reset(int(seed))), atol=1e-6)
        assert session._env.spec.max_episode_steps == task.horizon


def test_the_sum_of_an_episodes_rewards_is_the_fitness_on_the_robot():
    robot, task = GymnasiumRobot(id="Pendulum-v1"), EnvironmentTask(id="Pendulum-v1")
    controller, parameters = network(task, robot.system)
    found = robot.runner().bind(controller, task)(parameters, trial_seeds(8, 2), record=True)
    with robot.simulator.open() as session:
        for trajectory, fitness in zip(found.trajectories, found.fitness.ravel(), strict=True):
            session.reset(0, trajectory.states[0])
            total = sum(session.step(control)[1] for control in trajectory.controls)
            assert fitness == pytest.approx(total, abs=1e-2)


def test_a_good_model_gives_the_fitness_of_the_environment():
    robot, task = GymnasiumRobot(id="CartPole-v1"), EnvironmentTask(id="CartPole-v1", horizon=60)
    model = make_model("linear").fit(recorded("CartPole-v1", 60.0))
    controller, parameters = network(task, robot.system, candidates=8)
    runners = DynamicsRunner(model), robot.runner()
    own, on_robot = (one.bind(controller, task)(parameters, trial_seeds(3, 5)) for one in runners)
    np.testing.assert_allclose(own.fitness.mean(axis=1), on_robot.fitness.mean(axis=1), atol=1.5)


def test_rewards_of_an_unknown_environment_are_asked_of_it_where_it_begins_and_ends():
    robot, task = GymnasiumRobot(id=SLIDER), EnvironmentTask(id=SLIDER)
    controller, parameters = network(task, robot.system, candidates=3)
    seeds = trial_seeds(2, 3)
    found = robot.runner().bind(controller, task)(parameters, seeds, record=True)
    with robot.simulator.open() as session:
        for trajectory, fitness, seed in zip(found.trajectories, found.fitness.ravel(), np.tile(seeds, 3), strict=True):
            np.testing.assert_allclose(trajectory.states[0], session.reset(int(seed)), atol=1e-6)
            total = sum(max(session.step(control)[1], task.worst / 40) for control in trajectory.controls)
            assert fitness == pytest.approx(total, abs=1e-3)
            assert len(trajectory.controls) <= task.horizon == 40


def test_what_is_below_the_least_counts_as_the_least():
    task = EnvironmentTask(id=SLIDER, lowest=-2.0, horizon=5).bind(GymnasiumRobot(id=SLIDER).system)
    before, control = np.array([[50.0, 0.0], [0.0, 0.0]]), np.zeros((2, 1))
    trial, _ = task.advance(task.begin(trial_seeds(1, 2)), before, before, control=control)
    np.testing.assert_allclose(task.fitness(trial), [-2.0, 1.0])
    assert trial.alive.tolist() == [False, True]
    assert task.worst == -10.0
    assert EnvironmentTask(id="Pendulum-v1", horizon=10).worst == pytest.approx(-162.7, abs=0.1)
    assert all(rules.least <= 0.0 for rules in RULES.values())


@pytest.mark.parametrize(
    ("parameters", "error", "words"),
    [
        ({"horizon": 0}, InvalidArgument, "a horizon of at least one step, got 0"),
        ({"id": "CartPole-v1"}, IncompatibleTask, "needs the states position, speed, angle, angular_speed"),
        ({"id": ROTOR, "exact": True}, IncompatibleTask, r"has no attribute state.*cannot be computed exactly"),
        ({"id": "Forgetful-v0", "exact": True}, IncompatibleTask, "continued differently: it depends on more"),
        ({"id": "Nothing-v9"}, InvalidArgument, "cannot make the environment 'Nothing-v9'"),
        ({"id": "CartPole-v1", "lowest": -1.0}, InvalidArgument, "the lowest reward of CartPole-v1 is known, 0"),
        ({"id": "CartPole-v1", "exact": True}, InvalidArgument, "the reward of CartPole-v1 is known"),
        ({"id": SLIDER, "learned": "nothing"}, InvalidArgument, "expected the text that was stored with it"),
        ({"id": SLIDER}, IncompatibleTask, "needs 2 states, those of the environment itself"),
    ],
)
def test_a_task_that_does_not_fit_or_cannot_be_asked_is_refused_with_what_to_do(parameters, error, words):
    with pytest.raises(error, match=words):
        EnvironmentTask(**parameters).bind(pendulum())
