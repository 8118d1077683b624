"""Emulated robots in several conditions under random commands, without the loop: that takes a hundredth of the time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hardware.emulation.car_physics import CarParameters
from hardware.emulation.cars import REPEATS, ToyCarDynamics
from hardware.emulation.cart_pole import REPEATS as CART_POLE_REPEATS
from hardware.emulation.cart_pole import CartPoleParameters, CartPolePhysics
from hardware.emulation.held_control import HeldControl
from hardware.emulation.pendulum import REPEATS as PENDULUM_REPEATS
from hardware.emulation.pendulum import PendulumParameters, PendulumPhysics
from hardware.emulation.thermal import REPEATS as THERMAL_REPEATS
from hardware.emulation.thermal import ThermalParameters, ThermalPhysics
from sysid_evo.data import Dataset
from sysid_evo.models import Dynamics

EPISODE = 400  # samples
HELD = (4, 16)
"""Fewest and most samples for which a command is held."""


@dataclass(frozen=True)
class Condition:
    """The ``dynamics`` of a robot in one condition, and by how many samples its commands take effect ``late``."""

    dynamics: Dynamics
    late: int = 0


def cars() -> dict[str, Condition]:
    """Return the nominal car, then with another grip, battery, steering, weight or delay, and another of its kind."""
    nominal = CarParameters()
    heavier = 1.6
    conditions = {
        "nominal": nominal,
        "half the grip": replace(nominal, front_grip=0.5 * nominal.front_grip, rear_grip=0.5 * nominal.rear_grip),
        "low battery": replace(
            nominal,
            thrust_forward=0.75 * nominal.thrust_forward,
            thrust_backward=0.75 * nominal.thrust_backward,
        ),
        "another car": nominal.perturbed(1),
        "weak steering": replace(nominal, steer_left=0.6 * nominal.steer_left, steer_right=0.6 * nominal.steer_right),
        "heavy": replace(
            nominal,
            mass=heavier * nominal.mass,
            yaw_inertia=heavier * nominal.yaw_inertia,
            thrust_forward=nominal.thrust_forward / heavier,
            thrust_backward=nominal.thrust_backward / heavier,
        ),
    }
    return with_delay({name: Condition(HeldControl(ToyCarDynamics(one), REPEATS)) for name, one in conditions.items()})


def with_delay(conditions: dict[str, Condition]) -> dict[str, Condition]:
    """Return ``conditions`` and the nominal one with commands that take effect one sample later."""
    return conditions | {"late": replace(conditions["nominal"], late=1)}


def heaters() -> dict[str, Condition]:
    """Return the nominal heater, then with a weak power stage, draught or a larger block, and another of its kind."""
    nominal = ThermalParameters()
    conditions = {
        "nominal": nominal,
        "weak power stage": replace(nominal, power=0.7 * nominal.power),
        "draught": replace(nominal, loss=1.6 * nominal.loss),
        "larger block": replace(nominal, block=1.6 * nominal.block),
        "another heater": nominal.perturbed(1),
    }
    found = {name: Condition(HeldControl(ThermalPhysics(one), THERMAL_REPEATS)) for name, one in conditions.items()}
    return with_delay(found)


def pendulums() -> dict[str, Condition]:
    """Return the nominal pendulum, then with another weight, motor, friction, and another of its kind."""
    nominal = PendulumParameters()
    conditions = {
        "nominal": nominal,
        "heavy weight": replace(nominal, weight=1.4 * nominal.weight, inertia=1.4 * nominal.inertia),
        "dry bearings": replace(nominal, viscous=2.5 * nominal.viscous, dry=2.5 * nominal.dry),
        "slow motor": replace(nominal, motor_lag=4.0 * nominal.motor_lag),
        "another pendulum": nominal.perturbed(1),
    }
    found = {name: Condition(HeldControl(PendulumPhysics(one), PENDULUM_REPEATS)) for name, one in conditions.items()}
    return with_delay(found)


def cart_poles() -> dict[str, Condition]:
    """Return the nominal cart-pole, then with another cart, pole, rail, and another of its kind."""
    nominal = CartPoleParameters()
    conditions = {
        "nominal": nominal,
        "heavy cart": replace(nominal, cart=1.6 * nominal.cart),
        "long pole": replace(nominal, length=1.4 * nominal.length),
        "dirty rail": replace(nominal, rail_friction=2.0 * nominal.rail_friction),
        "another cart-pole": nominal.perturbed(1),
    }
    found = {name: Condition(HeldControl(CartPolePhysics(one), CART_POLE_REPEATS)) for name, one in conditions.items()}
    return with_delay(found)


def recorded(condition: Condition, *, episodes: int, seed: int) -> Dataset:
    """Return ``episodes`` of 400 samples under random commands, each from rest."""
    dynamics = condition.dynamics
    system, rng = dynamics.system, np.random.default_rng(seed)
    controls = np.empty((episodes, EPISODE, system.nu))
    for run in controls:
        begin = 0
        while begin < EPISODE:
            length = int(rng.integers(*HELD))
            run[begin : begin + length] = system.actuate(rng.uniform(-1.0, 1.0, (1, system.nu)))
            begin += length
    states = np.empty((episodes, EPISODE + 1, system.nx))
    carry = dynamics.start(
        np.tile(system.neutral_state, (episodes, dynamics.n_lags + 1, 1)),
        np.tile(system.neutral_control, (episodes, dynamics.n_lags, 1)),
        rng.standard_normal((episodes, dynamics.n_draws)),
    )
    acting = controls
    if condition.late:
        still = np.tile(system.neutral_control, (episodes, condition.late, 1))
        acting = np.concatenate([still, controls[:, : -condition.late]], axis=1)
    states[:, 0] = carry[:, : system.nx]
    for k in range(EPISODE):
        noise = rng.standard_normal((episodes, dynamics.n_noise)) if dynamics.n_noise else None
        carry = dynamics.step(carry, acting[:, k], noise)
        states[:, k + 1] = carry[:, : system.nx]
    return Dataset.from_arrays(system, list(states), list(controls), names=[f"run-{seed}-{i}" for i in range(episodes)])
