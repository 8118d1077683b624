"""A heated block with a slow power stage and a delay, of which only the temperature of the block is measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from hardware.emulation.parameters import RobotParameters, of_kind, parameter
from hardware.emulation.sensed_robot import ScalarPhysics, SensedRobot, Sensor
from sysid_evo.registry import register_robot
from sysid_evo.system import Channel, System
from sysid_evo.types import Array

FINE_DT = 0.05  # s
REPEATS = 4  # fine steps in one sample of 0.2 s
LATENCY = 8  # fine steps: 0.4 s from the command to the power stage
ROOM = 20.0  # degC


@dataclass(frozen=True, kw_only=True)
class ThermalParameters(RobotParameters):
    """A small block of metal with a heating element, in a draught."""

    power: float = parameter(45.0, "W", 0.1, "of the heater when full on; the block ends at 76 degC")
    block: float = parameter(9.0, "J/K", 0.15, "heat capacity of the block: with the loss a time constant of 11 s")
    element: float = parameter(2.0, "J/K", 0.15, "heat capacity of the element")
    contact: float = parameter(1.5, "W/K", 0.15, "from the element to the block")
    loss: float = parameter(0.8, "W/K", 0.15, "from the block to the room")
    power_lag: float = parameter(1.0, "s", 0.3, "the power stage follows slowly")
    draught: float = parameter(0.6, "1", 0.3, "change of the loss from one fine step to the next, standard deviation")


def thermal_step(x: Any, u: Any, w: Any, p: Any) -> Any:
    """The next carry of `ThermalPhysics`; ``p`` are the parameters in their order and the share of a lag."""
    power = x[2] + (x[3] - x[2]) * p[7]
    flow = p[3] * (x[1] - x[0])
    element = x[1] + FINE_DT / p[2] * (p[0] * power - flow)
    block = x[0] + FINE_DT / p[1] * (flow - p[4] * (1.0 + p[6] * w[0]) * (x[0] - ROOM))
    return block, element, power, x[4], x[5], x[6], x[7], x[8], x[9], x[10], u[0]


class ThermalPhysics(ScalarPhysics):
    """The block in steps of 50 ms; the room has 20 degC.

    The carry is the block's temperature T, the element's E (degC), the power h (share of full), and the eight delayed
    commands, the oldest first::

        block T' = contact (E - T) - loss (1 + draught noise) (T - room)
        element E' = power h - contact (E - T)
        h' = (command of 0.4 s ago - h) / power_lag

    At a start the element is in equilibrium with the block.
    """

    system = System(
        states=(Channel("temperature", "degC", 0.0, 100.0, neutral=ROOM),),
        controls=(Channel("heater", "", 0.0, 1.0),),
        dt=FINE_DT,
        name="thermal",
    )
    sensors: ClassVar[Mapping[str, Sensor]] = {"temperature": Sensor(0.05, 0.0625)}
    law = thermal_step
    nominal = ThermalParameters()
    lag = "power_lag"
    parameters: ThermalParameters
    n_carry = 3 + LATENCY
    n_lags = LATENCY

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        p, block, commands = self.parameters, states[:, -1], controls[:, -LATENCY:, 0]
        element = block + p.loss / p.contact * (block - ROOM)
        return np.concatenate([block, element, commands[:, :1], commands], axis=1)

    def release_state(self, rng: np.random.Generator) -> Array:
        """Return the block at room temperature, or still warm."""
        return np.array([rng.uniform(ROOM, 60.0)])


TASK = "set_point(channels=temperature, low=30, high=60, tolerance=1)"


@register_robot("thermal")
def thermal(*, seed: int | None = None) -> SensedRobot:
    """A heated block with a slow power stage and a delay, in simulation; with a ``seed`` a variant of it."""
    kind, parameters = of_kind("thermal", ThermalParameters(), seed)
    return SensedRobot(kind, ThermalPhysics(parameters), repeats=REPEATS, default_task=TASK)
