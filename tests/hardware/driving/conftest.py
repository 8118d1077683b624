"""A person who is a list of keys, in simulated time."""

from __future__ import annotations

import pytest

from hardware.connection import Command, Listener, Measurement
from hardware.driving.keyboard import Keyboard, key_life
from hardware.emulation.tracked_robots import EmulatedRobot
from sysid_evo.registry import make_robot


class Hands(Listener):
    """Holds keys by the time of the session: ``keys_at`` gives them, or None once the page is silent."""

    def __init__(self, keys_at):
        self.time = 0.0
        self.commands: list[Command] = []
        self.frames: list[Measurement] = []
        self.keyboard = Keyboard(life=key_life(make_robot("emulated_car").system), clock=lambda: self.time)
        self._keys_at = keys_at

    def measured(self, measurement):
        self.time = measurement.source_time
        self.frames.append(measurement)
        keys = self._keys_at(self.time)
        if keys is not None:
            self.keyboard.press(keys)

    def commanded(self, command):
        self.commands.append(command)


@pytest.fixture
def emulated():
    robot = make_robot("emulated_car")
    assert isinstance(robot, EmulatedRobot)
    return robot
