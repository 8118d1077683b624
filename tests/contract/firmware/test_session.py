"""The host's session against the compiled firmware, in made-up time."""

import pytest

from hardware.link.messages import Buttons, CommandMessage, FrameDecoder, HelloAcknowledgement, State, encode, unpack
from hardware.link.session import SILENCE, HostSession
from sysid_evo.errors import IncompatibleRobot, InvalidArgument, LinkLost
from tests.system.rig.core import FirmwareCore

GO = Buttons.FORWARD
LIFE = 0.15


class Wire:
    """A session and a robot whose clock is 10 s behind, joined without delay; ``cut`` swallows what the robot says."""

    def __init__(self):
        self.robot = FirmwareCore()
        self.session = HostSession(nonce=7)
        self.now = 100.0
        self.cut = False
        self.say(self.session.hello())

    def say(self, frames):
        self.robot.receive(frames, self._robot_ms)
        self.hear()

    def hear(self):
        spoken = self.robot.transmit()
        if not self.cut:
            self.session.receive(spoken, self.now)

    def command(self, buttons=GO):
        self.say(self.session.command(buttons, LIFE, self.now))

    def wait(self, duration):
        for _ in range(round(duration * 1000)):
            self.now += 0.001
            self.robot.tick(self._robot_ms)
            self.hear()

    @property
    def _robot_ms(self):
        return round((self.now - 90.0) * 1000)


@pytest.fixture
def wire():
    return Wire()


def commands_in(frames):
    messages = [unpack(body) for body in FrameDecoder().feed(frames)]
    assert all(isinstance(message, CommandMessage) for message in messages)
    return messages


def test_hello_opens_a_session(wire):
    assert wire.session.is_open
    assert wire.session.acknowledgement.nonce == 7
    wire.session.check(wire.now)


def test_neutral_goes_along_until_the_robot_says_that_it_has_one(wire):
    first, second = (wire.session.command(GO, LIFE, wire.now) for _ in range(2))
    for frames in (first, second):
        assert [message.buttons for message in commands_in(frames)] == [Buttons.NONE, GO]
    wire.say(first)
    assert wire.robot.buttons == GO
    assert [message.buttons for message in commands_in(wire.session.command(GO, LIFE, wire.now))] == [GO]


def test_robot_drives_on_at_twenty_hertz(wire):
    for _ in range(400):
        wire.command()
        assert wire.robot.buttons == GO
        wire.wait(0.05)
    assert wire.session.status.state == State.DRIVING
    assert set(wire.session.status.counters.values()) == {0}


def test_sequence_numbers_run_over_their_end(wire):
    for _ in range(6553 + 2):
        wire.command()
        wire.session._sequence += 9  # as if nine that follow were lost on the way
    for _ in range(3):  # until the robot has told what it made of them
        wire.wait(0.05)
        wire.command()
    assert wire.robot.buttons == GO
    assert wire.session.status.last_sequence < 20
    assert wire.session.status.duplicate == 0


def test_silence_of_a_quarter_of_a_second_is_a_lost_link(wire):
    wire.command()
    wire.cut = True
    wire.wait(SILENCE)
    wire.session.check(wire.now - 0.001)
    with pytest.raises(LinkLost, match="silent"):
        wire.session.check(wire.now + 0.001)


def test_nothing_revives_a_lost_session(wire):
    wire.command()
    wire.cut = True
    wire.wait(0.3)
    with pytest.raises(LinkLost):
        wire.session.check(wire.now)
    wire.cut = False
    wire.wait(0.2)
    for _ in range(2):
        with pytest.raises(LinkLost, match="connect again"):
            wire.command()


def test_pause_of_the_host_is_named_when_the_robot_has_tripped(wire):
    wire.command()
    wire.wait(0.05)
    wire.command()
    wire.wait(1.0)
    with pytest.raises(LinkLost, match=r"tripped.*longest pause between two was 1\.000 s"):
        wire.command()
    assert wire.robot.buttons == 0


@pytest.mark.parametrize("by", ["a restart", "another host"])
def test_a_restart_of_the_robot_and_another_host_end_the_session(wire, by):
    wire.command()
    if by == "a restart":
        wire.robot = FirmwareCore(boot_count=2)
    else:
        wire.robot.receive(HostSession(nonce=8).hello(), 10_000)
    wire.wait(0.11)
    with pytest.raises(LinkLost, match="left the session"):
        wire.command()


def test_stop_opens_the_buttons_and_ends_the_session(wire):
    wire.command()
    wire.say(wire.session.stop())
    assert wire.robot.buttons == 0
    with pytest.raises(LinkLost, match="closed"):
        wire.command()


def test_other_major_version_is_refused_naming_both_and_the_answer_to_another_hello_opens_nothing():
    other, foreign = HostSession(nonce=7), HostSession(nonce=7)
    other.receive(encode(HelloAcknowledgement(2, 1, 1, 15, 1, 1, 7, 0).pack()), 0.0)
    foreign.receive(encode(HelloAcknowledgement(1, 0, 1, 15, 1, 1, 8, 99).pack()), 0.0)
    assert not other.is_open
    assert not foreign.is_open
    with pytest.raises(IncompatibleRobot, match=r"RCB/2\.1.*RCB/1\.0"):
        other.check(0.0)
    with pytest.raises(LinkLost, match="not answered"):
        foreign.command(GO, LIFE, 0.0)


@pytest.mark.parametrize("valid_for, units", [(0.01, 1), (0.0999, 9), (0.15, 15), (0.2, 15), (1e9, 15)])
def test_life_of_a_command_is_rounded_down_and_at_most_what_the_robot_allows(wire, valid_for, units):
    assert {message.time_to_live for message in commands_in(wire.session.command(GO, valid_for, wire.now))} == {units}


@pytest.mark.parametrize("valid_for", [0.0, 0.009, -1.0, float("nan")])
def test_life_shorter_than_the_protocol_can_say_is_refused(wire, valid_for):
    with pytest.raises(InvalidArgument, match="valid_for"):
        wire.session.command(GO, valid_for, wire.now)


def test_round_trip_is_the_time_to_the_status_of_a_command(wire):
    frames = wire.session.command(GO, LIFE, wire.now)
    wire.wait(0.023)
    wire.say(frames)
    assert wire.session.round_trip == pytest.approx(0.023)
