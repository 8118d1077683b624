"""Comparisons on Gymnasium environments: ``python -m tests.benchmarks.environments --out FOLDER``.

The default comparison is made for each of ``--ids``, each in its own folder in ``FOLDER`` (finished comparisons are not
repeated): the environment is recorded, models are fitted, controllers are evolved in them and run in the environment.
The recommended controller is compared with *one search* on the environment's own equations, with the same number of
generations and trials, and with *rest*, controls at rest. All run in the same ``--trials`` fresh trials of the
environment. Prints the achieved fitness, the processor seconds of this process and the wall time of the comparison.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from evaluation.experiment import BUDGETS
from evaluation.running import compare
from evaluation.transfer import transfer_seeds
from hardware.simulators.gymnasium_robot import GymnasiumRobot
from sysid_evo.controllers.controller import make_controller
from sysid_evo.engine import DynamicsRunner
from sysid_evo.evolution import Champion, ControllerEvolution, evolve_controller
from sysid_evo.evolution.champion import load_champion
from sysid_evo.kernels import DynamicsKernel, ScalarStep
from sysid_evo.models import Dynamics
from sysid_evo.registry import Spec
from sysid_evo.system import System
from sysid_evo.tasks.task import make_task
from sysid_evo.types import Array
from tests.benchmarks.markdown import add_markdown, print_tables


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
    """The equations of a classic environment, as in Gymnasium."""

    def __init__(self, name: str, system: System) -> None:
        self.function, self.system, self.n_carry = EQUATIONS[name], system, system.nx

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return states[:, -1].copy()

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        return np.array([self.function(x, u, ()) for x, u in zip(carry.tolist(), control.tolist(), strict=True)])

    def kernel(self) -> DynamicsKernel:
        return DynamicsKernel(ScalarStep(self.function, n_carry=self.n_carry, nu=self.system.nu))


@dataclass(frozen=True)
class Compared:
    """A comparison of one environment: its recommended controller, and the seconds that it took."""

    champion: Champion
    processor: float
    clock: float


def compared(name: str, folder: Path, seed: int) -> Compared:
    """Make the default comparison for the environment ``name`` in ``folder``."""
    processor, clock = time.process_time(), time.perf_counter()
    report = compare(out=folder, robot=f'gymnasium(id="{name}")', task=f'environment(id="{name}")', seed=seed)
    spent = time.process_time() - processor, time.perf_counter() - clock
    assert report.transfer is not None
    assert report.transfer.pick is not None
    return Compared(load_champion((folder / report.controllers[report.transfer.pick]).with_suffix("")), *spent)


def one_search(champion: Champion, name: str, system: System, seed: int) -> Champion:
    """Evolve a controller of the same kind on the environment's own equations, on the budget of one model."""
    budget = BUDGETS["quick"]
    settings = ControllerEvolution(
        generations=budget.generations,
        trials=budget.trials,
        task=champion.task,
        controller=champion.controller,
        strategy=Spec.parse(budget.strategy),
    )
    own = {"own": DynamicsRunner(Equations(name, system))}
    return evolve_controller("one search", own, system, settings, seed=seed)


def achieved(champion: Champion, robot: GymnasiumRobot, trials: int) -> float:
    """Return the mean fitness of a champion in fresh trials."""
    task, controller = make_task(champion.task), make_controller(champion.controller)
    run = robot.runner().bind(controller, task)(champion.parameters[None], transfer_seeds(0, trials))
    return float(run.fitness.mean())


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--ids", default=",".join(EQUATIONS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--trials", type=int, default=100)
    add_markdown(parser)
    given = parser.parse_args(arguments)
    heads = ("environment", "achieved", "one search", "rest", "proc. s", "clock s")
    table = Table(*heads, title=f"default comparison, seed {given.seed}, {given.trials} trials", box=None)
    table.columns[0].no_wrap = True
    for name in given.ids.split(","):
        robot = GymnasiumRobot(id=name)
        made = compared(name, given.out / f"{name}-{given.seed}", given.seed)
        rest = Champion.baseline("constant", made.champion.task, robot.system)
        other = one_search(made.champion, name, robot.system, given.seed)
        figures = (f"{achieved(one, robot, given.trials):.1f}" for one in (made.champion, other, rest))
        table.add_row(name, *figures, f"{made.processor:.0f}", f"{made.clock:.0f}")
    print_tables([table], given.markdown)
    return 0


if __name__ == "__main__":
    sys.exit(main())
