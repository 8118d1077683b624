"""A trial driven by hand, in simulated time, behind the real loop."""

import json
import re

import numpy as np
import pytest

from hardware.control_loop import ControlLoop
from hardware.driving.hand_driving import LEAD, HandPanel, HumanPilot, PreTriggerBuffer
from hardware.driving.keyboard import Keyboard, LateMessageFilter, PageClients, control_of_keys, key_validity
from hardware.driving.page_messages import BACKWARD, FORWARD, LEFT, RIGHT, InvalidPageMessage, Phase, as_text
from hardware.emulation.tracked_robots import ModelRobot
from hardware.estimator import StateEstimate
from hardware.run_report import StopReason
from sysid_evo.errors import InvalidArgument
from sysid_evo.motion import PlanarBody
from sysid_evo.registry import make_robot
from sysid_evo.system import Channel, System
from sysid_evo.tasks import PointToPoint
from tests.fixtures.loop import Diary
from tests.fixtures.robots import ManualClock

BEGIN = 1.5  # s at which the first key goes down
SEED = 7


class Hands(Diary):
    """Holds keys by the time of the session: ``keys_at`` gives them, or None once the page is silent."""

    def __init__(self, keys_at):
        super().__init__()
        self.time, self._keys_at = 0.0, keys_at
        self.keyboard = Keyboard(life=key_validity(make_robot("emulated_car").system), clock=lambda: self.time)

    def on_measurement(self, measurement):
        super().on_measurement(measurement)
        self.time = measurement.source_time
        if (keys := self._keys_at(self.time)) is not None:
            self.keyboard.press(keys)


def drive(robot, hands, task, *others, samples=None):
    pilot = HumanPilot(hands.keyboard, task.bind(robot.system), seed=SEED)
    with robot.connect(seed=1) as connection:
        listeners = (hands, *(make(pilot) for make in others))
        report = ControlLoop(connection, robot.system, listeners=listeners).run(pilot, samples=samples)
    return pilot, report


def forward(time):
    return FORWARD if time >= BEGIN else 0


def moving(hands):
    return [command for command in hands.commands if command.control.any()]


def test_the_clock_starts_with_the_first_key_and_ends_after_the_horizon(emulated):
    hands = Hands(forward)
    pilot, report = drive(emulated, hands, PointToPoint(horizon=40))
    driven = moving(hands)
    assert report.reason is StopReason.PILOT
    assert (len(driven), driven[0].time) == (40, pytest.approx(BEGIN, abs=emulated.system.dt))
    assert not hands.commands[-1].control.any()
    assert pilot.progress.phase is Phase.FINISHED
    assert pilot.progress.step == 40


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
        last_driven = moving(hands)[-1].time
        neutral = min(command.time for command in hands.commands if command.time > last_driven)
        assert last_driven > silent - emulated.system.dt
        assert neutral <= silent + 0.15 + 1e-9


def test_a_released_key_means_neutral_in_the_next_sample(emulated):
    hands = Hands(lambda time: forward(time) if time < BEGIN + 0.52 else 0)
    drive(emulated, hands, PointToPoint(horizon=30))
    assert moving(hands)[-1].time < BEGIN + 0.52 + emulated.system.dt


@pytest.mark.parametrize("overdue", [0.0, 1.0])
def test_a_key_that_is_down_from_the_start_drives_nothing(emulated, overdue):
    hands = Hands(lambda time: None if 2.0 < time < 2.0 + overdue else FORWARD)
    pilot, _ = drive(emulated, hands, PointToPoint(horizon=30), samples=100)
    assert not moving(hands)
    assert pilot.progress.phase is Phase.SETTLING


def test_a_new_trial_ends_this_one_in_neutral_without_a_score(emulated):
    hands = Hands(forward)

    def keys(time):
        if time > BEGIN + 1.0:
            hands.keyboard.request_new_trial()
        return forward(time)

    hands._keys_at = keys
    pilot, report = drive(emulated, hands, PointToPoint(horizon=300))
    assert report.reason is StopReason.PILOT
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
    begin, recorded = 3.0, Hands(lambda _: None)
    hands = Hands(lambda time: FORWARD if time >= begin else 0)
    drive(emulated, hands, PointToPoint(horizon=20), lambda pilot: PreTriggerBuffer(pilot, lambda: recorded))
    assert recorded.measurements[0].source_time == pytest.approx(begin - LEAD, abs=0.1)
    assert recorded.measurements == hands.measurements[-len(recorded.measurements) :]
    assert [c.time for c in recorded.commands] == [c.time for c in hands.commands[-len(recorded.commands) :]]


def test_without_a_key_nothing_is_recorded(emulated):
    def watch(pilot):
        return PreTriggerBuffer(pilot, lambda: pytest.fail("nothing was driven"))

    pilot, _ = drive(emulated, Hands(lambda _: 0), PointToPoint(horizon=20), watch, samples=60)
    assert pilot.progress.phase is Phase.READY


def test_a_model_is_driven_like_the_robot_that_it_models(emulated):
    task = PointToPoint(horizon=30)
    model = ModelRobot("car without noise", emulated.dynamics)
    ends = [drive(robot, Hands(forward), task)[0].trajectory("trial").pose[-1] for robot in (emulated, model)]
    assert ends[0][0] > 0.8
    np.testing.assert_allclose(ends[1], ends[0], atol=0.15)


def test_a_reading_has_pose_speed_score_and_the_health_of_the_tracker(emulated):
    hands = Hands(lambda time: FORWARD if time > 1.5 else 0)
    task = PointToPoint(horizon=100).bind(emulated.system)
    instruments = HandPanel(emulated, task, hands.keyboard, clock=lambda: hands.time)
    assert json.loads(as_text(instruments.reading()))["phase"] == "ended"
    pilot = HumanPilot(hands.keyboard, task, seed=1)
    with emulated.connect(seed=1) as connection:
        instruments.begin(pilot, 3)
        loop = ControlLoop(connection, emulated.system, listeners=(hands, instruments))
        loop.run(pilot, samples=60)
        true = connection.state, connection.pose
    reading = json.loads(as_text(instruments.reading()))
    assert (reading["trial"], reading["phase"], reading["keys"]) == (3, "driving", FORWARD)
    assert reading["state"][instruments.setting().forward] == pytest.approx(true[0][0], abs=0.1)
    np.testing.assert_allclose(reading["pose"], true[1], atol=0.05)
    assert reading["tracker_rate"] == 200
    assert 0.05 * reading["step"] == pytest.approx(hands.time - 1.5, abs=0.15)
    assert reading["link"] is None
    instruments.finish(4.0, "the tracker lost the robot")
    reading = instruments.reading()
    assert (reading.scores, reading.message, reading.control) == ((4.0,), "the tracker lost the robot", None)


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def keyboard(clock):
    return Keyboard(life=0.1, clock=clock)


def test_keys_hold_for_their_life_and_are_released_at_once(keyboard, clock):
    keyboard.press(FORWARD | LEFT)
    clock.sleep(0.099)
    assert keyboard.keys == FORWARD | LEFT
    clock.sleep(0.002)
    assert keyboard.keys == 0
    keyboard.press(FORWARD)
    keyboard.release()
    assert keyboard.keys == 0


def test_a_word_that_is_overdue_does_not_let_go(keyboard, clock):
    assert keyboard.all_released
    keyboard.press(FORWARD)
    clock.sleep(1.0)
    assert not keyboard.keys
    assert not keyboard.all_released
    keyboard.release()
    assert keyboard.all_released


def test_a_loop_that_asks_once_a_sample_is_in_neutral_within_150_ms(car):
    assert key_validity(car) + car.dt == pytest.approx(0.15)
    with pytest.raises(InvalidArgument, match=r"below 0\.15 s"):
        key_validity(car.with_dt(0.2))


@pytest.mark.parametrize(
    ("keys", "control"),
    [(0, (0, 0)), (FORWARD, (1, 0)), (BACKWARD, (-1, 0)), (FORWARD | LEFT, (1, 1)), (BACKWARD | RIGHT, (-1, -1)),
     (FORWARD | BACKWARD | LEFT | RIGHT, (0, 0))],
)  # fmt: skip
def test_keys_drive_and_steer_the_car(car, keys, control):
    np.testing.assert_array_equal(control_of_keys(keys, car), control)


def test_no_key_is_neutral_even_where_the_middle_of_a_control_is_not():
    throttle = Channel("throttle", low=0.0, high=1.0)
    gear = Channel("gear", levels=(1.0, 2.0), neutral=1.0)
    wheel = Channel("wheel", low=-0.5, high=0.5)
    speeds = tuple(Channel(name) for name in ("forward_speed", "lateral_speed", "yaw_rate"))
    system = System(speeds, (throttle, gear, wheel), 0.05, PlanarBody())
    np.testing.assert_array_equal(control_of_keys(0, system), (0.0, 1.0, 0.0))
    np.testing.assert_array_equal(control_of_keys(FORWARD | RIGHT, system), (1.0, 1.0, -0.5))
    unbounded = System(speeds, (Channel("throttle"),), 0.05, PlanarBody())
    with pytest.raises(InvalidArgument, match="throttle"):
        control_of_keys(FORWARD, unbounded)


def test_delayed_messages_are_distinguished_from_punctual_ones_with_a_drifting_clock():
    way, drifting = LateMessageFilter(), LateMessageFilter()
    assert all(way.on_time(stamp, stamp + 50.0) for stamp in (1.0, 1.1, 1.2))
    assert not way.on_time(1.3, 53.0)
    assert way.on_time(3.0, 53.02)
    assert all(drifting.on_time(second, 7.0 + second * (1 + 2e-4)) for second in range(10_000))


def word(keys, clock, **more):
    return {"type": "keys", "keys": keys, "clock": clock, "new_trial": False, **more}


def test_a_page_that_opens_with_a_key_down_must_release_it_first(keyboard):
    seat = PageClients(keyboard).join()
    seat.receive(word(FORWARD, 1.0), 1.0)
    assert keyboard.keys == 0
    seat.receive(word(0, 1.1), 1.1)
    seat.receive(word(FORWARD, 1.2), 1.2)
    assert keyboard.keys == FORWARD


def test_what_was_held_up_on_its_way_presses_no_key_and_yet_ends_the_trial(keyboard):
    seat = PageClients(keyboard).join()
    seat.receive(word(0, 1.0), 1.0)
    seat.receive(word(FORWARD, 1.1, new_trial=True), 2.1)
    assert keyboard.keys == 0
    assert keyboard.new_trial_wanted


def test_one_drives_and_the_others_watch_until_it_leaves(keyboard):
    seats = PageClients(keyboard)
    first, second = seats.join(), seats.join()
    assert (first.is_driver, second.is_driver, seats.watchers) == (True, False, 1)
    for seat, keys in ((first, FORWARD), (second, LEFT)):
        seat.receive(word(0, 1.0), 1.0)
        seat.receive(word(keys, 1.0, new_trial=seat is second), 1.0)
    assert keyboard.keys == FORWARD
    assert not keyboard.new_trial_wanted
    seats.remove(second)
    assert keyboard.keys == FORWARD
    second = seats.join()
    seats.remove(first)
    seats.remove(first)
    assert keyboard.keys == 0
    first.receive(word(FORWARD, 1.1), 1.1)
    assert keyboard.keys == 0
    second.receive(word(0, 1.2), 1.2)
    second.receive(word(RIGHT, 1.2, new_trial=True), 1.2)
    assert keyboard.keys == RIGHT
    assert keyboard.take_new_trial()
    assert not keyboard.take_new_trial()


@pytest.mark.parametrize(
    ("said", "sentence"),
    [
        *((said, "expected a message of the type keys with keys, clock, new_trial, got")
          for said in (None, [], {"keys": 1}, word(1, 0.0, type="steer"), word(1, 0.0, drive=True))),
        *((word(keys, 0.0), f"keys: expected 0 to 15, got {keys!r}") for keys in (16, -1, True, "1", 1.0)),
        *((word(1, clock), "clock: expected seconds, got") for clock in (float("nan"), 1e300, "0")),
        (word(1, 0.0, new_trial=1), "new_trial: expected true or false, got 1"),
    ],
)  # fmt: skip
def test_an_invalid_message_of_the_page_is_refused_with_a_sentence(keyboard, said, sentence):
    with pytest.raises(InvalidPageMessage, match=re.escape(sentence)):
        PageClients(keyboard).join().receive(said, 1.0)
    assert keyboard.keys == 0
