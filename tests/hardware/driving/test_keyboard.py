"""What a person's keys mean, and for how long."""

import numpy as np
import pytest

from hardware.driving.keyboard import Keyboard, Punctuality, Seats, control_of, key_life
from hardware.driving.page_messages import BACKWARD, FORWARD, LEFT, RIGHT, InvalidWord
from sysid_evo.errors import InvalidArgument
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System


class Clock:
    time = 100.0

    def __call__(self):
        return self.time


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def keyboard(clock):
    return Keyboard(life=0.1, clock=clock)


def test_keys_hold_for_their_life_and_no_longer(keyboard, clock):
    keyboard.press(FORWARD | LEFT)
    clock.time += 0.099
    assert keyboard.keys == FORWARD | LEFT
    clock.time += 0.002
    assert keyboard.keys == 0


def test_released_keys_are_released_at_once(keyboard):
    keyboard.press(FORWARD)
    keyboard.release()
    assert keyboard.keys == 0


def test_a_word_that_is_overdue_does_not_let_go(keyboard, clock):
    assert keyboard.let_go
    keyboard.press(FORWARD)
    clock.time += 1.0
    assert not keyboard.keys
    assert not keyboard.let_go
    keyboard.release()
    assert keyboard.let_go


def test_a_loop_that_asks_once_a_sample_is_in_neutral_within_150_ms(car):
    assert key_life(car) + car.dt == pytest.approx(0.15)
    with pytest.raises(InvalidArgument, match=r"below 0\.15 s"):
        key_life(car.with_dt(0.2))


@pytest.mark.parametrize(
    ("keys", "control"),
    [
        (0, (0, 0)),
        (FORWARD, (1, 0)),
        (BACKWARD, (-1, 0)),
        (FORWARD | LEFT, (1, 1)),
        (BACKWARD | RIGHT, (-1, -1)),
        (FORWARD | BACKWARD | LEFT | RIGHT, (0, 0)),
    ],
)
def test_keys_drive_and_steer_the_car(car, keys, control):
    np.testing.assert_array_equal(control_of(keys, car), control)


def test_no_key_is_neutral_even_where_the_middle_of_a_control_is_not():
    throttle = Channel("throttle", low=0.0, high=1.0)
    gear = Channel("gear", levels=(1.0, 2.0), neutral=1.0)
    wheel = Channel("wheel", low=-0.5, high=0.5)
    speeds = tuple(Channel(name) for name in ("forward_speed", "lateral_speed", "yaw_rate"))
    system = System(speeds, (throttle, gear, wheel), 0.05, PlanarBody())
    np.testing.assert_array_equal(control_of(0, system), (0.0, 1.0, 0.0))
    np.testing.assert_array_equal(control_of(FORWARD | RIGHT, system), (1.0, 1.0, -0.5))
    unbounded = System(speeds, (Channel("throttle"),), 0.05, PlanarBody())
    with pytest.raises(InvalidArgument, match="throttle"):
        control_of(FORWARD, unbounded)


def test_words_that_were_held_up_on_the_way_are_told_from_punctual_ones():
    way = Punctuality()
    assert all(way.on_time(stamp, stamp + 50.0) for stamp in (1.0, 1.1, 1.2))
    assert not way.on_time(1.3, 53.0)
    assert way.on_time(3.0, 53.02)


def test_clocks_that_drift_apart_do_not_make_words_late():
    way = Punctuality()
    assert all(way.on_time(second, 7.0 + second * (1 + 2e-4)) for second in range(10_000))


def word(keys, clock, **more):
    return {"keys": keys, "clock": clock, **more}


def test_a_page_that_opens_with_a_key_down_must_release_it_first(keyboard):
    seat = Seats(keyboard).take()
    seat.hear(word(FORWARD, 1.0), 1.0)
    assert keyboard.keys == 0
    seat.hear(word(0, 1.1), 1.1)
    seat.hear(word(FORWARD, 1.2), 1.2)
    assert keyboard.keys == FORWARD


def test_what_was_held_up_on_its_way_presses_no_key_and_yet_ends_the_trial(keyboard):
    seat = Seats(keyboard).take()
    seat.hear(word(0, 1.0), 1.0)
    seat.hear(word(FORWARD, 1.1, new=True), 2.1)
    assert keyboard.keys == 0
    assert keyboard.new_trial_wanted


def test_one_drives_and_the_others_watch_until_it_leaves(keyboard):
    seats = Seats(keyboard)
    first, second = seats.take(), seats.take()
    assert (first.drives, second.drives, seats.watchers) == (True, False, 1)
    for seat, keys in ((first, FORWARD), (second, LEFT)):
        seat.hear(word(0, 1.0), 1.0)
        seat.hear(word(keys, 1.0, new=seat is second), 1.0)
    assert keyboard.keys == FORWARD
    assert not keyboard.new_trial_wanted
    second.leave()
    assert keyboard.keys == FORWARD
    second = seats.take()
    first.leave()
    first.leave()
    assert keyboard.keys == 0
    first.hear(word(FORWARD, 1.1), 1.1)
    assert keyboard.keys == 0
    second.hear(word(0, 1.2), 1.2)
    second.hear(word(RIGHT, 1.2, new=True), 1.2)
    assert keyboard.keys == RIGHT
    assert keyboard.take_new_trial()
    assert not keyboard.take_new_trial()


@pytest.mark.parametrize(
    "said",
    [None, [], {"keys": 1}, word(16, 0.0), word(-1, 0.0), word(True, 0.0), word(1, float("nan")), word(1, 1e300),
     word(1, 0.0, new=1), word(1, 0.0, drive=True), {"keys": "1", "clock": 0.0}],
)  # fmt: skip
def test_what_a_page_does_not_say_is_refused(keyboard, said):
    with pytest.raises(InvalidWord):
        Seats(keyboard).take().hear(said, 1.0)
    assert keyboard.keys == 0
