"""The remote's own program on a simulated ATmega328P, driven by the host's session."""

import shutil
import struct
import subprocess
from pathlib import Path

import pytest

from hardware.link.messages import Buttons, State
from hardware.link.session import HostSession
from sysid_evo.errors import InvalidArgument, LinkLost
from tests.system.rig.build import FOLDER, build_c

WATCHDOG_ENABLED = 0x08
STEP = 0.005  # s


class Board:
    """The simulated chip and the host on one clock; ``port`` and ``directions`` are its registers for D0 to D7."""

    def __init__(self, process):
        self.session = HostSession(nonce=11)
        self.now = 0.0
        self.port = self.directions = self.watchdog = 0
        self._process = process

    def run(self, duration, frames=b""):
        reading, writing = self._process.stdout, self._process.stdin
        assert reading is not None
        assert writing is not None
        writing.write(struct.pack("<IB", round(duration * 1e6), len(frames)) + frames)
        writing.flush()
        self.port, self.directions, self.watchdog, size = struct.unpack("<BBBH", reading.read(5))
        self.now += duration
        self.session.receive(reading.read(size), self.now)

    @property
    def pressed(self):
        return Buttons(self.port >> 4)

    def command(self, buttons):
        self.run(STEP, self.session.command(buttons, 0.15, self.now))


@pytest.fixture(scope="module")
def programs(tmp_path_factory):
    """The simulator and the program it runs."""
    for tool in ("avr-gcc", "make"):
        if shutil.which(tool) is None:
            pytest.skip(f"the remote's program needs {tool}, which is not installed")
    out = tmp_path_factory.mktemp("remote")
    subprocess.run(["make", "-s", "-C", str(FOLDER), f"OUT={out}"], check=True, capture_output=True)
    try:
        board = build_c("board", (Path(__file__).with_name("simulated_board.c"),), ("-O2", "-w"), ("-lsimavr",))
    except InvalidArgument as error:
        pytest.skip(f"the simulator of the chip cannot be built, is libsimavr-dev installed? {error}")
    return board, out / "remote.elf"


@pytest.fixture
def board(programs):
    command, pipe = list(map(str, programs)), subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL) as process:
        yield Board(process)
        assert process.stdin is not None
        process.stdin.close()


@pytest.fixture
def connected(board):
    board.run(0.05)
    board.run(STEP, board.session.hello())
    assert board.session.is_open
    return board


def test_pins_are_low_outputs_and_the_watchdog_runs_before_anything_else(board):
    board.run(20e-6)
    assert board.directions & 0xF0 == 0xF0
    assert board.port & 0xF0 == 0
    assert board.watchdog & WATCHDOG_ENABLED


def test_program_says_what_it_is(connected):
    acknowledgement = connected.session.acknowledgement
    assert (acknowledgement.major, acknowledgement.max_time_to_live, acknowledgement.boot_count) == (1, 15, 1)


@pytest.mark.parametrize("buttons", [Buttons.FORWARD | Buttons.LEFT, Buttons.BACKWARD | Buttons.RIGHT])
def test_pins_follow_commands_and_open_when_they_stop(connected, buttons):
    for _ in range(20):
        connected.command(buttons)
        connected.run(0.05 - STEP)
        assert connected.pressed == buttons
    assert connected.session.status.state == State.DRIVING
    connected.run(0.09)
    assert connected.pressed == buttons
    connected.run(0.02)
    assert connected.pressed == Buttons.NONE
    with pytest.raises(LinkLost, match="tripped"):
        connected.command(buttons)


def test_stop_opens_the_pins(connected):
    connected.command(Buttons.FORWARD)
    assert connected.pressed == Buttons.FORWARD
    connected.run(STEP, connected.session.stop())
    assert connected.pressed == Buttons.NONE


def test_clock_of_the_program_counts_milliseconds(connected):
    connected.run(0.2)
    before = connected.session.status.clock_ms
    connected.run(1.0)
    assert connected.session.status.clock_ms - before == pytest.approx(1000, abs=101)
    assert connected.session.counters["crc"] == connected.session.counters["length"] == 0


def test_chattering_line_does_not_keep_the_pins_closed(connected):
    connected.command(Buttons.FORWARD)
    for _ in range(20):
        connected.run(0.01, bytes(range(256))[:115])
    assert connected.pressed == Buttons.NONE
