"""Emulated cars in several conditions under random commands, without the loop: that takes a hundredth of the time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hardware.emulation.car_physics import CarParameters
from hardware.emulation.cars import REPEATS, ToyCarDynamics
from hardware.emulation.tracked_robots import TrackedRobot
from sysid_evo.data import Dataset
from sysid_evo.models import Dynamics

EPISODE = 20.0  # s
HELD = (4, 16)
"""Fewest and most samples for which a command is held."""


def cars() -> dict[str, TrackedRobot]:
    """Return the nominal car, with half the tyre grip, with three quarters of the battery, and another of its kind."""
    nominal = CarParameters()
    conditions = {
        "nominal": nominal,
        "half the grip": replace(nominal, front_grip=0.5 * nominal.front_grip, rear_grip=0.5 * nominal.rear_grip),
        "low battery": replace(
            nominal,
            thrust_forward=0.75 * nominal.thrust_forward,
            thrust_backward=0.75 * nominal.thrust_backward,
        ),
        "another car": nominal.perturbed(1),
    }
    return {name: TrackedRobot(name, ToyCarDynamics(one), repeats=REPEATS) for name, one in conditions.items()}


def recorded(dynamics: Dynamics, *, seconds: float, seed: int) -> Dataset:
    """Return episodes of 20 s of ``dynamics`` under random commands, each from rest."""
    system, rng = dynamics.system, np.random.default_rng(seed)
    steps, count = round(EPISODE / system.dt), max(1, round(seconds / EPISODE))
    controls = np.empty((count, steps, system.nu))
    for run in controls:
        begin = 0
        while begin < steps:
            length = int(rng.integers(*HELD))
            run[begin : begin + length] = system.actuate(rng.uniform(-1.0, 1.0, (1, system.nu)))
            begin += length
    states = np.empty((count, steps + 1, system.nx))
    carry = dynamics.start(
        np.tile(system.neutral_state, (count, dynamics.n_lags + 1, 1)),
        np.tile(system.neutral_control, (count, dynamics.n_lags, 1)),
        rng.standard_normal((count, dynamics.n_draws)),
    )
    states[:, 0] = carry[:, : system.nx]
    for k in range(steps):
        noise = rng.standard_normal((count, dynamics.n_noise)) if dynamics.n_noise else None
        carry = dynamics.step(carry, controls[:, k], noise)
        states[:, k + 1] = carry[:, : system.nx]
    return Dataset.from_arrays(system, list(states), list(controls), names=[f"run-{seed}-{i}" for i in range(count)])
