"""An exported controller on the board: its commands are the product's, and the host holds the dead man's switch."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hardware.link.messages import Buttons
from hardware.link.serial_robot import buttons_of
from hardware.link.session import HostSession
from sysid_evo.errors import InvalidArgument
from sysid_evo.export import c_text, law_of
from tests.fixtures.exports import champion_of, decided, wandering
from tests.system.rig.build import FOLDER, SOURCES, WARNINGS, compiler

OBSERVED = Path(__file__).with_name("observed.c")
STEP = 50  # ms, the controller's own
SPECS = ("recurrent", "pid(loops={steer: [waypoint_angle, yaw_rate], drive: waypoint_distance})", "pursuit")


class Board:
    """The firmware with a controller, compiled for this machine, and the host's session, on one clock in ms."""

    def __init__(self, spec, real, folder):
        law = law_of(champion_of(spec, name="controller"))
        (folder / "controller.c").write_text(c_text(law, real))
        library = folder / "board.so"
        number: Any = ctypes.c_double if real == "double" else ctypes.c_float
        command = [
            _compiler(), *WARNINGS, "-Werror", "-O2", "-shared", "-fPIC", f"-DONBOARD_REAL={real}",
            f'-DCONTROLLER_FILE="{folder / "controller.c"}"', f"-I{FOLDER}",
            FOLDER / "rcb.c", FOLDER / "onboard.c", OBSERVED, "-lm", "-o", library,
        ]  # fmt: skip
        subprocess.run(command, check=True)
        self._library, self._number = ctypes.CDLL(str(library)), number
        self._core = ctypes.create_string_buffer(self._library.rcb_size())
        self._library.rcb_init(self._core, 1, 1, 1)
        self._library.onboard_init()
        self.now = 1000
        self.session = HostSession(nonce=5)
        self.hear(self.session.hello())

    def hear(self, frames):
        for byte in frames:
            self._library.rcb_receive(self._core, byte, self.now)
        out = ctypes.create_string_buffer(256)
        taken = self._library.rcb_transmit(self._core, out, 256)
        self.session.receive(out.raw[:taken], self.now / 1000.0)

    def command(self, life=0.15):
        """Say that the controller may drive; the command itself is neutral."""
        self.hear(self.session.command(Buttons.NONE, life, self.now / 1000.0))

    def show(self, observation):
        self._library.show((self._number * len(observation))(*observation), ctypes.c_size_t(len(observation)))

    @property
    def buttons(self):
        self._library.rcb_tick(self._core, self.now)
        return Buttons(self._library.onboard_buttons(self._core, self.now))


def _compiler():
    try:
        return compiler()
    except InvalidArgument as error:
        pytest.skip(f"the firmware is not compiled: {error}")


@pytest.mark.parametrize("spec", SPECS)
def test_the_buttons_are_the_product_s_commands_over_ten_thousand_steps(spec, tmp_path):
    board, seen = Board(spec, "double", tmp_path), wandering(10_000)
    expected = [buttons_of(control) for control in decided(champion_of(spec), seen)]
    pressed = []
    for row in seen:
        board.show(row)
        board.command()
        pressed.append(board.buttons)
        board.now += STEP
    assert len(set(expected)) > 2
    assert pressed == expected


def test_in_single_precision_the_buttons_are_the_same_but_beside_a_boundary(tmp_path):
    board, seen = Board("recurrent", "float", tmp_path), wandering(2000)
    expected = [buttons_of(control) for control in decided(champion_of("recurrent"), seen)]
    pressed = []
    for row in seen:
        board.show(row)
        board.command()
        pressed.append(board.buttons)
        board.now += STEP
    assert np.mean([a != b for a, b in zip(pressed, expected, strict=True)]) < 0.002


def test_it_decides_once_a_sample_however_often_it_is_asked(tmp_path):
    board, seen = Board("recurrent", "double", tmp_path), wandering(200)
    expected = [buttons_of(control) for control in decided(champion_of("recurrent"), seen)]
    pressed = []
    for row in seen:
        board.command()
        board.show(row)
        pressed.append(board.buttons)
        for other in range(1, STEP):
            board.now += 1
            board.show(-row * other)
            assert board.buttons == pressed[-1]
        board.now += 1
    assert pressed == expected


def driven(board, seen):
    pressed = []
    for row in seen:
        board.command()
        board.show(row)
        pressed.append(board.buttons)
        board.now += STEP
    return pressed


def test_without_the_host_all_buttons_open_and_the_next_run_begins_anew(tmp_path):
    board, seen = Board("recurrent", "double", tmp_path), wandering(60)
    assert board.buttons is Buttons.NONE
    first = driven(board, seen)
    assert any(first)
    board.now += 150
    assert board.buttons is Buttons.NONE
    board.command()
    assert board.buttons is Buttons.NONE, "a trip ends only with another session"
    board.session = HostSession(nonce=6)
    board.hear(board.session.hello())
    assert driven(board, seen) == first


def test_a_robot_that_is_not_seen_lets_go(tmp_path):
    board, seen = Board("recurrent", "double", tmp_path), wandering(60)
    (last,) = {len(row) for row in seen}
    assert any(driven(board, seen)[-10:])
    board.show(np.empty(0))
    board.command()
    assert board.buttons is Buttons.NONE
    assert last == 5


def test_the_board_s_own_program_is_built_with_the_controller(tmp_path):
    for tool in ("avr-gcc", "make"):
        if shutil.which(tool) is None:
            pytest.skip(f"the board's program needs {tool}, which is not installed")
    controller = tmp_path / "controller.c"
    controller.write_text(c_text(law_of(champion_of("recurrent", name="controller")), "float"))
    arguments = [f"OUT={tmp_path}", f"CONTROLLER={controller}", f"OBSERVE={OBSERVED}"]
    done = subprocess.run(["make", "-s", "-C", str(FOLDER), *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    text, data, bss = (int(number) for number in done.stdout.splitlines()[-1].split()[:3])
    assert text + data < 32_000
    assert data + bss < 2048 - 512, "the rest of the memory is the stack's"
    assert all(source.is_file() for source in SOURCES)
