"""The test rig as a robot that commands find by its name: ``--plugin tests/benchmarks/robot/registered.py``."""

from sysid_evo.registry import register_robot
from tests.system.rig.terminal_car import TerminalCar

register_robot("terminal_car")(TerminalCar)
