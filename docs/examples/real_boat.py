"""A model boat on the network: commands as JSON datagrams, poses from a tracker."""

import json
import socket
import time
from typing import Any

import numpy as np

from hardware.connection import Connection, GateLimits, Measurement
from hardware.robot import Robot
from hardware.trackers.tracker import TrackerStream
from sysid_evo import Channel, PlanarBody, System, register_robot
from sysid_evo.errors import InvalidArgument, LinkLost
from sysid_evo.registry import trackers

SYSTEM = System(
    states=(Channel("surge", "m/s"), Channel("sway", "m/s"), Channel("yaw_rate", "rad/s")),
    controls=(Channel("propeller", low=-1.0, high=1.0), Channel("rudder", low=-1.0, high=1.0)),
    dt=0.05,
    motion=PlanarBody(forward="surge", lateral="sway", yaw_rate="yaw_rate"),
    name="boat",
)


@register_robot("real_boat")
class RealBoat(Robot):
    """The boat that listens at ``host``:``port``, seen by ``tracker``, a table with a registered ``driver``.

    ``gate`` is a table of what the boat can do, see `GateLimits`.
    """

    dynamics = None

    def __init__(self, *, host: str, port: int, tracker: dict[str, Any], gate: dict[str, Any] | None = None) -> None:
        if not isinstance(port, int) or not 1 <= port <= 65535:
            raise InvalidArgument(f"real_boat: expected a port from 1 to 65535, got {port!r}")
        self.name, self.system = "real_boat", SYSTEM
        self.address = (host, port)
        arguments = dict(tracker)
        self.tracker = trackers.make(arguments.pop("driver"), **arguments)
        self.gate = GateLimits.read(gate)

    def check(self) -> None:
        self.tracker.check()

    def connect(self, *, seed: int | None = None) -> Connection:
        return BoatConnection(self)


class BoatConnection(Connection):
    """A session with the boat; the boat stops when ``valid_for`` is over, whatever happens here."""

    def __init__(self, robot: RealBoat) -> None:
        self._robot = robot
        self.gate_limits = robot.gate
        self._frames: TrackerStream = robot.tracker.open()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    @property
    def time(self) -> float:
        return time.monotonic()

    def send(self, control: np.ndarray, *, valid_for: float) -> None:
        control = self._robot.system.check_control(control)
        word = {"control": control.tolist(), "valid_for": valid_for}
        try:
            self._socket.sendto(json.dumps(word).encode(), self._robot.address)
        except OSError as error:
            raise LinkLost(f"real_boat: {error.strerror}") from error

    def measure(self, timeout: float) -> Measurement | None:
        return self._frames.read(timeout)

    def close(self) -> None:
        if self._socket.fileno() >= 0:
            self.send(self._robot.system.neutral_control, valid_for=0.01)
            self._socket.close()
            self._frames.close()
