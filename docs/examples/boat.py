"""A model boat with a propeller and a rudder, in simulation."""

import numpy as np

from hardware.connection import GateLimits
from hardware.emulation.tracked_robots import TrackedRobot
from sysid_evo import Channel, Dynamics, PlanarBody, System, register_robot


class BoatPhysics(Dynamics):
    """The boat in steps of 5 ms: surge u, sway v, yaw rate r, and the propeller's own speed p.

    The hull glides forward and resists sideways; the rudder works in the water that flows past it::

        du/dt = 1.6 p - 0.9 u + v r        dp/dt = (command - p) / 0.3 s
        dv/dt = -4 v - u r + waves         dr/dt = rudder (2.5 u + 1.5 p) - 2 r
    """

    system = System(
        states=(Channel("surge", "m/s"), Channel("sway", "m/s"), Channel("yaw_rate", "rad/s")),
        controls=(Channel("propeller", low=-1.0, high=1.0), Channel("rudder", low=-1.0, high=1.0)),
        dt=0.005,
        motion=PlanarBody(forward="surge", lateral="sway", yaw_rate="yaw_rate"),
        name="boat",
    )
    n_carry = 4
    n_noise = 1

    def __init__(self, waves: float) -> None:
        self.waves = waves

    def start(self, states: np.ndarray, controls: np.ndarray, draws: np.ndarray | None = None) -> np.ndarray:
        return np.column_stack([states[:, -1], np.zeros(len(states))])

    def step(self, carry: np.ndarray, control: np.ndarray, noise: np.ndarray | None = None) -> np.ndarray:
        surge, sway, yaw_rate, propeller = carry.T
        command, rudder = control.T
        waves = 0.0 if noise is None else self.waves * np.abs(surge) * noise[:, 0]
        change = np.column_stack(
            [
                1.6 * propeller - 0.9 * surge + sway * yaw_rate,
                -4.0 * sway - surge * yaw_rate + waves,
                rudder * (2.5 * surge + 1.5 * propeller) - 2.0 * yaw_rate,
                (command - propeller) / 0.3,
            ]
        )
        return carry + change * self.system.dt


@register_robot("boat")
def boat(*, waves: float = 1.0) -> TrackedRobot:
    """A model boat; ``waves`` (m/s2) push it sideways while it moves."""
    return TrackedRobot("boat", BoatPhysics(waves), repeats=10, gate=GateLimits(speed=3.0))
