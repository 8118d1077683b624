"""Recordings of environments: what is in them, and that they excite."""

import numpy as np
import pytest

from hardware.preflight import check_recording
from hardware.run_report import Reason, Stops
from hardware.simulators.gymnasium_robot import GymnasiumRobot
from sysid_evo.errors import InvalidArgument, LinkLost
from sysid_evo.models.base import make_model
from tests.fixtures.environments import BREAKS, NAME, register

register()


def recorded(name, duration, seed=0):
    return GymnasiumRobot(id=name).record(seed=seed, duration=duration).dataset


def test_a_recording_replays_in_the_environment_itself():
    robot = GymnasiumRobot(id="Pendulum-v1")
    dataset = robot.record(seed=1, duration=50.0).dataset
    with robot.simulator.open() as session:
        for episode in dataset.episodes[::4]:
            for state, control, after in list(zip(episode.states, episode.controls, episode.states[1:], strict=False))[
                ::20
            ]:
                session.reset(0, state)
                np.testing.assert_allclose(dataset.system.difference(session.step(control)[0], after), 0.0, atol=2e-5)


def test_the_same_seed_gives_the_same_recording_and_another_seed_another():
    one, same, other = (recorded("CartPole-v1", 20.0, seed).fingerprint for seed in (1, 1, 2))
    assert one == same != other


def test_every_episode_ends_where_the_environment_ends_it():
    dataset = recorded(NAME, 100.0)
    speeds = [episode.states[:, 0] for episode in dataset]
    assert all((np.abs(speed[:-1]) <= BREAKS + 1e-6).all() for speed in speeds)
    assert any(abs(speed[-1]) > BREAKS for speed in speeds)
    assert max(len(episode) for episode in dataset) == 50
    assert dataset.n_steps == pytest.approx(1000, abs=20)


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


def test_a_stop_ends_the_recording_and_keeps_what_there_is():
    robot = GymnasiumRobot(id="Pendulum-v1")
    with Stops() as stops:
        made = robot.record(
            seed=0, duration=60.0, stops=stops, progress=lambda done, total: stops.request(Reason.SIGINT)
        )
    assert made.report.reason is Reason.SIGINT
    assert len(made.dataset) == 1
    with pytest.raises(LinkLost, match="Pendulum-v1: interrupted; nothing was recorded"):
        robot.record(seed=0, duration=60.0, stops=stops)


def test_a_recording_needs_no_loop_and_no_tracker():
    robot = GymnasiumRobot(id="Acrobot-v1")
    check_recording(robot, None, duration=180.0)
    with pytest.raises(InvalidArgument, match=r"at least 2\.7 min for 8 scripts of 100 samples, got 1 min"):
        check_recording(robot, None, duration=60.0)
