"""What the champion of a comparison achieves in an environment, beside one evolved on the environment's own equations.

Run: python -m tests.benchmarks.environments --run RUN --id Pendulum-v1
RUN is the folder of: sysid-evo compare --robot 'gymnasium(id="Pendulum-v1")' --task 'environment(id="Pendulum-v1")'
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from evaluation.transfer import transfer_seeds
from hardware.environments.gymnasium_robot import GymnasiumRobot
from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import DynamicsKernel, DynamicsRunner, Lifted
from sysid_evo.evolution import Champion, ControllerEvolution, evolve_controller
from sysid_evo.registry import Spec, make_controller, make_task
from sysid_evo.store import load_champion
from sysid_evo.system import System


def pendulum(x, u, p):
    """A rod of 1 m and 1 kg: 0 is upright, at most 8 rad/s."""
    speed = x[1] + (15.0 * math.sin(x[0]) + 3.0 * u[0]) * 0.05
    speed = min(max(speed, -8.0), 8.0)
    return x[0] + 0.05 * speed, speed


def cart_pole(x, u, p):
    """A pole of 0.1 kg whose centre is 0.5 m over a cart of 1 kg, in steps of Euler."""
    sine, cosine = math.sin(x[2]), math.cos(x[2])
    push = (u[0] + 0.05 * x[3] * x[3] * sine) / 1.1
    turn = (9.8 * sine - cosine * push) / (0.5 * (4.0 / 3.0 - 0.1 * cosine * cosine / 1.1))
    along = push - 0.05 * turn * cosine / 1.1
    return x[0] + 0.02 * x[1], x[1] + 0.02 * along, x[2] + 0.02 * x[3], x[3] + 0.02 * turn


def hill(x, u, p):
    """A car too weak for the hill, between two ends."""
    speed = x[1] + 0.0015 * u[0] - 0.0025 * math.cos(3.0 * x[0])
    speed = min(max(speed, -0.07), 0.07)
    place = min(max(x[0] + speed, -1.2), 0.6)
    return place, 0.0 if (place <= -1.2) & (speed < 0.0) else speed


EQUATIONS: Mapping[str, Callable[..., tuple[float, ...]]] = {
    "Pendulum-v1": pendulum,
    "CartPole-v1": cart_pole,
    "MountainCarContinuous-v0": hill,
}


class Equations(Dynamics):
    """The equations of a classic environment, as they stand in Gymnasium."""

    def __init__(self, name: str, system: System) -> None:
        self.function, self.system, self.n_carry = EQUATIONS[name], system, system.nx

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return states[:, -1].copy()

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        return np.array([self.function(x, u, ()) for x, u in zip(carry.tolist(), control.tolist(), strict=True)])

    def kernel(self) -> DynamicsKernel:
        return DynamicsKernel(Lifted(self.function, n_carry=self.n_carry, nu=self.system.nu))


def achieved(champion: Champion, runner: Any, trials: int) -> float:
    """Return the mean fitness of a champion in fresh trials."""
    task, controller = make_task(champion.task), make_controller(champion.controller)
    return float(runner.run(controller, champion.parameters[None], task, transfer_seeds(0, trials)).fitness.mean())


def main(arguments: list[str] | None = None) -> None:
    """Print what is achieved, the yardstick, and both measured from a controller that does nothing."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--id", default="Pendulum-v1")
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--controller", default="recommended")
    parser.add_argument("--generations", type=int, default=300)
    parser.add_argument("--trials", type=int, default=100)
    given = parser.parse_args(arguments)
    robot = GymnasiumRobot(id=given.id)
    stored = sorted((given.run / "controllers").glob(f"*{given.controller}-*.json"))[0]
    champion = load_champion(stored.with_suffix(""))
    own = Equations(given.id, robot.system)
    settings = ControllerEvolution(
        generations=given.generations,
        trials=10,
        task=champion.task,
        controller=champion.controller,
        strategy=Spec.parse("niches"),
    )
    began = time.perf_counter()
    best = evolve_controller("own", {"own": DynamicsRunner(own)}, robot.system, settings, seed=0)
    seconds = time.perf_counter() - began
    idle = Champion("idle", np.zeros(len(best.parameters)), (), "min", 0, np.empty((0, 3)), best.controller, best.task)
    reached, yardstick, nothing = (achieved(one, robot.runner(), given.trials) for one in (champion, best, idle))
    table = Table("", "fitness", box=None)
    for label, value in (
        (f"{champion.name}, evolved on models only", reached),
        (f"evolved on the environment's own equations ({seconds:.0f} s)", yardstick),
        ("a controller that does nothing", nothing),
        ("share of the way from nothing to the yardstick", (reached - nothing) / (yardstick - nothing)),
    ):
        table.add_row(label, f"{value:.3g}")
    Console().print(table)


if __name__ == "__main__":
    main()
