"""The board's programs: an exported controller in the firmware, and the remote on a simulated chip."""

import ctypes
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest

from hardware.link.messages import Buttons, State
from hardware.link.serial_robot import buttons_of
from hardware.link.session import HostSession
from sysid_evo.errors import InvalidArgument, LinkLost
from sysid_evo.export import c_text, exported_controller
from tests.fixtures.exports import champion_of, decided, wandering
from tests.system.rig.build import FOLDER, WARNINGS, build_c, compiler

RIG = Path(__file__).with_name("rig")
STEP = 50  # ms, the controller's own
SPECS = ("recurrent", "pid(loops={steer: [waypoint_angle, yaw_rate], drive: waypoint_distance})", "pursuit")


class Board:
    """The firmware with a controller, compiled for this machine, and the host's session, on one clock in ms."""

    def __init__(self, library, number):
        self._library, self._number = library, number
        self._core = ctypes.create_string_buffer(library.rcb_size())
        library.rcb_init(self._core, 1, 1, 1)
        library.onboard_init()
        self.show(())
        self.now = 1000
        self.connect(nonce=5)

    def connect(self, nonce):
        self.session = HostSession(nonce=nonce)
        self.hear(self.session.hello())

    def hear(self, frames):
        for byte in frames:
            self._library.rcb_receive(self._core, byte, self.now)
        out = ctypes.create_string_buffer(256)
        taken = self._library.rcb_transmit(self._core, out, 256)
        self.session.receive(out.raw[:taken], self.now / 1000.0)

    def command(self):
        """Say that the controller may drive; the command itself is neutral."""
        self.hear(self.session.command(Buttons.NONE, 0.15, self.now / 1000.0))

    def show(self, observation):
        self._library.show((self._number * len(observation))(*observation), ctypes.c_size_t(len(observation)))

    @property
    def buttons(self):
        self._library.rcb_tick(self._core, self.now)
        return Buttons(self._library.onboard_buttons(self._core, self.now))

    def drive(self, seen):
        """Return what is pressed in each step."""
        pressed = []
        for row in seen:
            self.command()
            self.show(row)
            pressed.append(self.buttons)
            self.now += STEP
        return pressed


@pytest.fixture(scope="module")
def board_with(tmp_path_factory):
    """Makes a board with the controller of a specification; each is compiled once."""
    libraries = {}

    def make(spec="recurrent", real="double"):
        if (spec, real) not in libraries:
            folder = tmp_path_factory.mktemp("board")
            controller, library = folder / "controller.c", folder / "board.so"
            controller.write_text(c_text(exported_controller(champion_of(spec, name="controller")), real))
            try:
                command = [compiler(), *WARNINGS, "-Werror", "-O2", "-shared", "-fPIC", f"-DONBOARD_REAL={real}"]
            except InvalidArgument as error:
                pytest.skip(f"the firmware is not compiled: {error}")
            command += [f'-DCONTROLLER_FILE="{controller}"', f"-I{FOLDER}", FOLDER / "rcb.c", FOLDER / "onboard.c"]
            subprocess.run([*command, RIG / "observed.c", "-lm", "-o", library], check=True)
            libraries[spec, real] = ctypes.CDLL(str(library))
        return Board(libraries[spec, real], ctypes.c_double if real == "double" else ctypes.c_float)

    return make


def expected_of(spec, seen):
    return [buttons_of(control) for control in decided(champion_of(spec), seen)]


@pytest.mark.parametrize("spec", SPECS)
def test_the_buttons_are_the_product_s_commands(spec, board_with):
    seen = wandering(2000)
    expected = expected_of(spec, seen)
    assert len(set(expected)) > 2
    assert board_with(spec).drive(seen) == expected


def test_in_single_precision_the_buttons_are_the_same_but_beside_a_boundary(board_with):
    seen = wandering(2000)
    pressed = board_with(real="float").drive(seen)
    assert np.mean([a != b for a, b in zip(pressed, expected_of("recurrent", seen), strict=True)]) < 0.002


def test_it_decides_once_a_sample_however_often_it_is_asked(board_with):
    board, seen, pressed = board_with(), wandering(100), []
    for row in seen:
        board.command()
        board.show(row)
        pressed.append(board.buttons)
        for other in range(1, STEP):
            board.now += 1
            board.show(-row * other)
            assert board.buttons == pressed[-1]
        board.now += 1
    assert pressed == expected_of("recurrent", seen)


def test_without_the_host_all_buttons_open_and_the_next_run_begins_anew(board_with):
    board, seen = board_with(), wandering(60)
    assert board.buttons is Buttons.NONE
    first = board.drive(seen)
    assert any(first)
    board.now += 150
    assert board.buttons is Buttons.NONE
    board.command()
    assert board.buttons is Buttons.NONE, "a trip ends only with another session"
    board.connect(nonce=6)
    assert board.drive(seen) == first


def test_a_robot_that_is_not_seen_lets_go(board_with):
    board = board_with()
    assert any(board.drive(wandering(60))[-10:])
    board.show(())
    board.command()
    assert board.buttons is Buttons.NONE


def built(out, *arguments):
    """Build the board's own program into ``out``; return the sizes of its text, data and bss."""
    for tool in ("avr-gcc", "make"):
        if shutil.which(tool) is None:
            pytest.skip(f"the board's program needs {tool}, which is not installed")
    command = ["make", "-s", "-C", FOLDER, f"OUT={out}", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return [int(number) for number in done.stdout.splitlines()[-1].split()[:3]]


def test_the_board_s_own_program_is_built_with_the_controller(tmp_path):
    controller = tmp_path / "controller.c"
    controller.write_text(c_text(exported_controller(champion_of("recurrent", name="controller")), "float"))
    text, data, bss = built(tmp_path, f"CONTROLLER={controller}", f"OBSERVE={RIG / 'observed.c'}")
    assert text + data < 32_000
    assert data + bss < 2048 - 512, "the rest of the memory is the stack's"


WATCHDOG_ENABLED = 0x08
SAYING = 0.005  # s


class Remote:
    """The simulated chip and the host on one clock; ``port`` and ``directions`` are its registers for D0 to D7."""

    def __init__(self, process):
        self.session, self._process = HostSession(nonce=11), process
        self.now = 0.0
        self.port = self.directions = self.watchdog = 0

    def run(self, duration, frames=b""):
        reading, writing = self._process.stdout, self._process.stdin
        writing.write(struct.pack("<IB", round(duration * 1e6), len(frames)) + frames)
        writing.flush()
        self.port, self.directions, self.watchdog, size = struct.unpack("<BBBH", reading.read(5))
        self.now += duration
        self.session.receive(reading.read(size), self.now)

    @property
    def pressed(self):
        return Buttons(self.port >> 4)

    def command(self, buttons):
        self.run(SAYING, self.session.command(buttons, 0.15, self.now))


@pytest.fixture(scope="module")
def programs(tmp_path_factory):
    """The simulator and the program it runs."""
    out = tmp_path_factory.mktemp("remote")
    built(out)
    try:
        simulator = build_c("board", (RIG / "simulated_board.c",), ("-O2", "-w"), ("-lsimavr",))
    except InvalidArgument as error:
        pytest.skip(f"the simulator of the chip cannot be built, is libsimavr-dev installed? {error}")
    return [simulator, out / "remote.elf"]


@pytest.fixture
def remote(programs):
    pipe = subprocess.PIPE
    with subprocess.Popen(programs, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL) as process:
        yield Remote(process)
        process.stdin.close()


@pytest.fixture
def connected(remote):
    remote.run(0.05)
    remote.run(SAYING, remote.session.hello())
    assert remote.session.is_open
    return remote


def test_pins_are_low_outputs_and_the_watchdog_runs_before_anything_else(remote):
    remote.run(20e-6)
    assert (remote.directions & 0xF0, remote.port & 0xF0) == (0xF0, 0)
    assert remote.watchdog & WATCHDOG_ENABLED


@pytest.mark.parametrize("buttons", [Buttons.FORWARD | Buttons.LEFT, Buttons.BACKWARD | Buttons.RIGHT])
def test_pins_follow_commands_and_open_when_they_stop(connected, buttons):
    said = connected.session.acknowledgement
    assert (said.major, said.max_time_to_live, said.boot_count) == (1, 15, 1)
    for _ in range(20):
        connected.command(buttons)
        connected.run(0.05 - SAYING)
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
    connected.run(SAYING, connected.session.stop())
    assert connected.pressed == Buttons.NONE


def test_clock_of_the_program_counts_milliseconds(connected):
    connected.run(0.2)
    before = connected.session.status.clock_ms
    connected.run(1.0)
    assert connected.session.status.clock_ms - before == pytest.approx(1000, abs=101)


def test_chattering_line_does_not_keep_the_pins_closed(connected):
    connected.command(Buttons.FORWARD)
    for _ in range(20):
        connected.run(0.01, bytes(range(256))[:115])
    assert connected.pressed == Buttons.NONE
