"""What the compiled core accepts, rule by rule and against the same rules in Python."""

from itertools import pairwise

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from hardware.link.messages import (
    EXCLUSIVE,
    Buttons,
    CommandMessage,
    FrameDecoder,
    Hello,
    HelloAcknowledgement,
    State,
    StatusMessage,
    Stop,
    encode,
    unpack,
)
from tests.fixtures.acceptance_in_python import Acceptance
from tests.system.rig.core import FirmwareCore

GO = Buttons.FORWARD | Buttons.LEFT
BUTTONS = [Buttons(value) for value in range(16) if not any(value & pair == pair for pair in EXCLUSIVE)]


class Robot:
    """The core, its answers, and a host clock that is 500 ms behind its own; ``began`` is where its clock starts."""

    def __init__(self, began=1000):
        self.core = FirmwareCore()
        self.now, self.session = began, 0
        self.status = self.last = None
        self._decoder = FrameDecoder()

    def say(self, message):
        self.core.receive(encode(message.pack()), self.now % 2**32)
        return self.hear()

    def hear(self):
        heard = [unpack(body) for body in self._decoder.feed(self.core.transmit())]
        for message in heard:
            self.last = message
            if isinstance(message, StatusMessage):
                self.status = message
            if isinstance(message, HelloAcknowledgement):
                self.session = message.session
        assert self._decoder.crc_errors == self._decoder.length_errors == 0
        return heard

    def hello(self, nonce=1):
        self.say(Hello(1, 0, nonce))

    def command(self, sequence, buttons=GO, *, delay=0, life=15, session=0):
        """Say a CMD that left the host ``delay`` ms ago; return whether it counts."""
        host_ms = (self.now - 500 - delay) % 65536
        before = self.core.accepted
        heard = self.say(CommandMessage(session or self.session, sequence % 65536, host_ms, buttons, life))
        counts = self.core.accepted > before
        assert not counts or isinstance(heard[-1], StatusMessage)
        return counts

    def tick(self, duration):
        self.now += duration
        self.core.tick(self.now % 2**32)
        self.hear()


@pytest.fixture
def robot():
    return Robot()


@pytest.fixture
def driven(robot):
    """A robot that has taken a neutral command and one to go, with sequence 2."""
    robot.hello()
    assert robot.command(1, Buttons.NONE)
    assert robot.command(2)
    assert robot.core.buttons == GO
    return robot


def opens_after(robot, duration):
    """Whether the buttons stay closed until ``duration`` ms from now and are open then."""
    robot.tick(duration - 1)
    closed = robot.core.buttons == GO
    robot.tick(1)
    return closed and robot.core.buttons == 0


def test_nothing_drives_before_a_hello_and_a_neutral_command(robot):
    assert not robot.command(1)
    robot.hello()
    assert not robot.command(1)
    assert robot.core.buttons == 0
    assert robot.command(2, Buttons.NONE)
    assert robot.command(3)
    assert robot.core.buttons == GO


def test_buttons_open_when_the_life_of_the_last_command_is_over(driven):
    assert opens_after(driven, 150)
    assert (driven.status.state, driven.status.trips) == (State.TRIPPED, 1)


@pytest.mark.parametrize(("how", "left"), [({"life": 4}, 40), ({"delay": 100}, 50)])
def test_a_shorter_life_is_kept_and_a_delayed_command_lives_from_when_it_was_sent(driven, how, left):
    assert driven.command(3, **how)
    assert opens_after(driven, left)


def test_command_that_comes_after_its_predecessors_life_does_not_rescue(driven):
    driven.now += 150
    assert not driven.command(3)
    assert driven.core.buttons == 0


def test_trip_latches_until_a_new_hello_and_a_neutral_command(driven):
    driven.tick(150)
    assert not driven.command(3, Buttons.NONE)
    driven.hello(nonce=1)
    assert not driven.command(4, Buttons.NONE)
    driven.hello(nonce=2)
    assert not driven.command(5)
    assert driven.core.buttons == 0
    assert driven.command(6, Buttons.NONE)
    assert driven.command(7)
    assert driven.core.buttons == GO


@pytest.mark.parametrize(
    ("how", "counter"),
    [
        *(({"sequence": sequence}, "duplicate") for sequence in (2, 1, 0, 2 + 17, 2 + 32768, 2 - 1000)),
        ({"session": 1}, "duplicate"),
        *(({"delay": delay}, "late") for delay in (150, 5000, -151)),
        *(({"life": life}, "length") for life in (0, 16, 255)),
    ],
)
def test_what_is_repeated_foreign_late_or_not_granted_does_not_count_nor_prolong_the_life(driven, how, counter):
    given = {"sequence": 3, **how, "session": driven.session ^ how.get("session", 0)}
    assert not driven.command(**given)
    assert opens_after(driven, 150)
    assert getattr(driven.status, counter) == 1


def test_sequence_is_newer_modulo_65536(robot):
    robot.hello()
    assert robot.command(32000, Buttons.NONE)
    assert all(robot.command(sequence) for sequence in range(32015, 65536 + 50, 15))


@pytest.mark.parametrize("delay", [149, -150])
def test_command_that_is_nearly_late_or_from_the_near_future_counts(driven, delay):
    assert driven.command(3, delay=delay)


def test_backlog_of_a_stopped_host_is_not_acted_on(driven):
    sent = [driven.now + 50 * number for number in range(20)]
    driven.now += 1000
    assert not any(driven.command(3 + number, delay=driven.now - left) for number, left in enumerate(sent))
    assert driven.core.buttons == 0


@pytest.mark.parametrize("percent", [-0.7, 0.7])
def test_clocks_that_drift_apart_do_not_make_commands_late(driven, percent):
    start = driven.now
    for number in range(1200):  # a minute, in which they drift by nearly three lives of a command
        driven.now += 50
        assert driven.command(3 + number, delay=round((driven.now - start) * percent / 100))
    assert driven.core.buttons == GO


@pytest.mark.parametrize("session", [0, 1, 0xFFFF])
def test_stop_counts_in_any_session_and_ends_it(driven, session):
    driven.say(Stop(session, 0))
    assert driven.core.buttons == 0
    assert not driven.command(3, Buttons.NONE)
    assert driven.status.state == State.WAITING


def test_hello_opens_the_buttons_and_changes_the_session_and_the_same_one_twice_does_not(driven):
    before = driven.session
    driven.hello(nonce=1)
    assert (driven.session, driven.core.buttons) == (before, GO)
    driven.hello(nonce=2)
    assert driven.core.buttons == 0
    assert driven.session not in (0, before)
    assert not driven.command(3, session=before)


def test_other_major_version_gets_an_answer_and_no_session(driven):
    (answer,) = driven.say(Hello(2, 0, 9))
    assert (answer.major, answer.minor, answer.nonce, answer.session) == (1, 0, 9, 0)
    assert driven.core.buttons == 0
    assert not driven.command(3, Buttons.NONE)


def test_only_legal_buttons_with_their_complement_count(driven):
    sequence, closed = 3, GO
    for byte in range(256):
        body = bytearray(CommandMessage(driven.session, sequence, (driven.now - 500) % 65536, GO, 15).pack())
        body[7] = byte
        driven.core.receive(encode(bytes(body)), driven.now)
        if byte & 0x0F in BUTTONS and byte >> 4 == ~byte & 0x0F:
            sequence, closed = sequence + 1, byte & 0x0F
            assert driven.hear(), byte
        else:
            assert not driven.hear(), byte
        assert driven.core.buttons == closed, byte
    assert sequence == 3 + len(BUTTONS)


def test_status_comes_ten_times_a_second_without_commands(robot):
    robot.hello()
    times = []
    for _ in range(1000):
        robot.now += 1
        robot.core.tick(robot.now)
        times += [message.clock_ms for message in robot.hear() if isinstance(message, StatusMessage)]
    assert len(times) == 10
    assert {after - before for before, after in pairwise(times)} == {100}


def test_robot_drives_while_its_clock_runs_over():
    robot = Robot(began=2**32 - 500)
    robot.hello()
    robot.command(1, Buttons.NONE)
    for number in range(40):
        robot.now += 50
        assert robot.command(2 + number)
    robot.tick(150)
    assert robot.core.buttons == 0


class Agreement(RuleBasedStateMachine):
    """Random conversations: the core and the rules in Python must never differ."""

    @initialize(began=st.sampled_from([0, 1000, 65_000, 2**32 - 300]))
    def begin(self, began):
        self.robot, self.rules = Robot(began), Acceptance()

    def _pass(self):
        self.rules.pass_time(self.robot.now)

    @rule(duration=st.one_of(st.integers(0, 60), st.integers(0, 400)))
    def wait(self, duration):
        self.robot.tick(duration)
        self._pass()

    @rule(major=st.sampled_from([1, 1, 1, 2]), nonce=st.integers(0, 3))
    def hello(self, major, nonce):
        self._pass()
        message = Hello(major, 0, nonce)
        answer = self.robot.say(message)[-1]
        assert isinstance(answer, HelloAcknowledgement)
        self.rules.hello(message, answer.session)
        self.robot.session = self.rules.session

    @rule(
        ahead=st.one_of(st.just(1), st.integers(-3, 20), st.integers(-40_000, 40_000)),
        delay=st.one_of(st.integers(-5, 30), st.integers(-200, 200), st.integers(0, 65535)),
        buttons=st.sampled_from([Buttons.NONE, *BUTTONS]),
        life=st.integers(1, 15),
        other=st.sampled_from([0, 0, 0, 0, 1]),
    )
    def command(self, ahead, delay, buttons, life, other):
        sequence = (self.rules.sequence + ahead) % 65536
        host_ms = (self.robot.now - 500 - delay) % 65536
        message = CommandMessage(self.rules.session ^ other, sequence, host_ms, buttons, life)
        self._pass()
        counts = self.rules.command(message, self.robot.now)
        before = self.robot.core.accepted
        self.robot.say(message)
        assert self.robot.core.accepted - before == counts

    @rule(session=st.integers(0, 65535))
    def stop(self, session):
        self._pass()
        self.robot.say(Stop(session, 0))
        self.rules.stop()

    @invariant()
    def sides_agree(self):
        assert self.robot.core.buttons == self.rules.buttons
        heard, self.robot.last = self.robot.last, None
        if isinstance(heard, StatusMessage):
            rules = self.rules
            assert (heard.session, heard.state, heard.buttons) == (rules.session, rules.state, rules.buttons)
            assert heard.last_sequence == rules.sequence
            assert heard.counters == {"crc": 0, "length": 0, **rules.counters}

    def teardown(self):
        self.wait(400)
        assert isinstance(self.robot.last, StatusMessage)
        self.sides_agree()


class TestAgreement(Agreement.TestCase):
    settings = settings(max_examples=30, stateful_step_count=40)
