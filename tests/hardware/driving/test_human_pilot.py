"""A trial driven by hand, in simulated time, behind the real loop."""

import numpy as np
import pytest

from hardware.control_loop import ControlLoop
from hardware.driving.hand_driving import LEAD, HumanPilot, Phase, WhileDriving
from hardware.driving.page_messages import FORWARD, LEFT
from hardware.emulation.tracked_robots import ModelledRobot
from hardware.estimator import StateEstimate
from hardware.run_report import Reason
from sysid_evo.tasks import PointToPoint
from tests.hardware.driving.conftest import Hands

BEGIN = 1.5  # s at which the first key goes down
SEED = 7


def drive(robot, hands, task, *others, samples=None):
    pilot = HumanPilot(hands.keyboard, task.bind(robot.system), seed=SEED)
    with robot.connect(seed=1) as connection:
        listeners = (hands, *(make(pilot) for make in others))
        report = ControlLoop(connection, robot.system, listeners=listeners).run(pilot, samples=samples)
    return pilot, report


def forward(time):
    return FORWARD if time >= BEGIN else 0


def test_the_clock_starts_with_the_first_key_and_ends_after_the_horizon(emulated):
    hands = Hands(forward)
    pilot, report = drive(emulated, hands, PointToPoint(horizon=40))
    driven = [command for command in hands.commands if command.control.any()]
    assert report.reason is Reason.PILOT
    assert len(driven) == 40
    assert driven[0].time == pytest.approx(BEGIN, abs=emulated.system.dt)
    assert not hands.commands[-1].control.any()
    assert pilot.progress.phase is Phase.FINISHED
    assert pilot.progress.steps == 40


def test_the_score_is_the_fitness_of_the_task_along_the_poses_seen(emulated):
    task = PointToPoint(horizon=200, waypoint_radius=0.5, arena_radius=0.8)
    pilot, _ = drive(emulated, Hands(lambda time: FORWARD | LEFT if time >= BEGIN else 0), task)
    trajectory = pilot.trajectory("trial")
    bound = task.bind(emulated.system)
    state = bound.begin(np.array([SEED], dtype=np.uint64))
    steps = zip(trajectory.states, trajectory.states[1:], trajectory.controls, trajectory.pose[1:], strict=False)
    for before, after, control, pose in steps:
        state, _ = bound.advance(state, before[None], after[None], control=control[None], pose=pose[None])
    assert pilot.fitness == bound.fitness(state)[0] >= 2
    assert len(trajectory) == 200
    np.testing.assert_allclose(trajectory.pose[0], 0.0, atol=1e-12)


def test_a_silent_page_means_neutral_within_150_ms(emulated):
    for silent in BEGIN + 1.0 + 0.01 * np.arange(5):
        hands = Hands(lambda time, end=silent: None if time > end else forward(time))
        drive(emulated, hands, PointToPoint(horizon=60))
        last_driven = max(command.time for command in hands.commands if command.control.any())
        neutral = min(command.time for command in hands.commands if command.time > last_driven)
        assert last_driven > silent - emulated.system.dt
        assert neutral <= silent + 0.15 + 1e-9


def test_a_released_key_means_neutral_in_the_next_sample(emulated):
    hands = Hands(lambda time: forward(time) if time < BEGIN + 0.52 else 0)
    drive(emulated, hands, PointToPoint(horizon=30))
    last_driven = max(command.time for command in hands.commands if command.control.any())
    assert last_driven < BEGIN + 0.52 + emulated.system.dt


@pytest.mark.parametrize("overdue", [0.0, 1.0])
def test_a_key_that_is_down_from_the_start_drives_nothing(emulated, overdue):
    hands = Hands(lambda time: None if 2.0 < time < 2.0 + overdue else FORWARD)
    pilot, _ = drive(emulated, hands, PointToPoint(horizon=30), samples=100)
    assert not any(command.control.any() for command in hands.commands)
    assert pilot.progress.phase is Phase.SETTLING


def test_a_new_trial_ends_this_one_in_neutral_without_a_score(emulated):
    hands = Hands(forward)

    def keys(time):
        if time > BEGIN + 1.0:
            hands.keyboard.ask_for_new_trial()
        return forward(time)

    hands._keys_at = keys
    pilot, report = drive(emulated, hands, PointToPoint(horizon=300))
    assert report.reason is Reason.PILOT
    assert not hands.commands[-1].control.any()
    assert (pilot.progress.phase, pilot.fitness) == (Phase.ENDED, None)
    assert 15 <= len(pilot.trajectory("trial")) <= 25
    assert hands.keyboard.take_new_trial()


def test_waypoints_lie_where_the_robot_stood_at_the_first_key(emulated):
    hands = Hands(lambda _: 0)
    pilot = HumanPilot(hands.keyboard, PointToPoint(horizon=5).bind(emulated.system), seed=SEED)
    stood = np.array([2.0, 1.0, np.pi / 2])
    for tick in range(20):
        hands.time = 0.05 * tick
        hands.keyboard.press(FORWARD if tick == 19 else 0)
        pilot.decide(tick, StateEstimate(hands.time, stood, np.zeros(3), 0.004))
    assert pilot.progress.phase is Phase.DRIVING
    np.testing.assert_allclose(pilot.in_arena(np.array([2.0, 3.0, np.pi])), [2.0, 0.0, np.pi / 2], atol=1e-12)


def test_what_is_recorded_begins_a_second_before_the_first_key(emulated):
    begin, recorded = 5.0, Hands(lambda _: None)
    hands = Hands(lambda time: FORWARD if time >= begin else 0)
    drive(emulated, hands, PointToPoint(horizon=20), lambda pilot: WhileDriving(pilot, lambda: recorded))
    assert recorded.frames[0].source_time == pytest.approx(begin - LEAD, abs=0.1)
    assert recorded.frames == hands.frames[-len(recorded.frames) :]
    assert [c.time for c in recorded.commands] == [c.time for c in hands.commands[-len(recorded.commands) :]]


def test_without_a_key_nothing_is_recorded(emulated):
    def refuse():
        raise AssertionError("nothing was driven")

    task = PointToPoint(horizon=20)
    pilot, _ = drive(emulated, Hands(lambda _: 0), task, lambda pilot: WhileDriving(pilot, refuse), samples=60)
    assert pilot.progress.phase is Phase.READY


def test_a_model_is_driven_like_the_robot_that_it_models(emulated):
    task = PointToPoint(horizon=30)
    model = ModelledRobot("car without noise", emulated.dynamics)
    ends = [drive(robot, Hands(forward), task)[0].trajectory("trial").pose[-1] for robot in (emulated, model)]
    assert ends[0][0] > 0.8
    np.testing.assert_allclose(ends[1], ends[0], atol=0.15)
