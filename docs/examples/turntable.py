# turntable.py
from typing import ClassVar

import numpy as np

from hardware.emulation.sensed_robot import Equations, SensedRobot, Sensor
from sysid_evo import Channel, System, register_robot


class Turntable(Equations):
    """Motor and brake against friction; the table is not balanced."""

    system = System(
        states=(Channel("angle", "rad", period=2 * np.pi), Channel("spin", "rad/s")),
        controls=(Channel("motor", levels=(-1.0, 0.0, 1.0)), Channel("brake", low=0.0, high=1.0)),
        dt=0.1,
        name="turntable",
    )
    sensors: ClassVar = {"angle": Sensor(noise=0.002, resolution=2 * np.pi / 1024), "spin": Sensor(noise=0.02)}

    def rates_of_change(self, states: np.ndarray, controls: np.ndarray) -> dict[str, np.ndarray]:
        angle, spin = states.T
        motor, brake = controls.T
        return {"angle": spin, "spin": 3.0 * motor - (0.5 + 4.0 * brake) * spin - 0.8 * np.sin(angle)}


@register_robot("turntable")
def turntable() -> SensedRobot:
    """A turntable with a motor of three gears and a brake."""
    return SensedRobot("turntable", Turntable())
