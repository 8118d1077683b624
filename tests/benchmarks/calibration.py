"""The emulated car against the figures of the paper's: ``python -m tests.benchmarks.calibration``.

``--generations`` evolves controllers on the car itself (about a second each) and drives the best
on a hundred fresh trials; ``--robot emulated_car:3`` looks at another car.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from rich.console import Console
from rich.table import Table

from hardware.recording.excitation import excitation
from sysid_evo.arrays import Array
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import rollout
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_robot
from sysid_evo.tasks import PointToPoint

PARENTS, TRIALS, MUTATION = 50, 10, 0.1
SETTLED = 200  # steps: 10 s, ten times the slowest lag
RMS = {"forward_speed": 1.11, "lateral_speed": 0.078, "yaw_rate": 1.62}  # table 1, see paper/README.md
TOP_SPEEDS = {1.0: 2.0, -1.0: 1.4}  # m/s
RADII = {(1.0, 1.0): 0.60, (1.0, -1.0): 0.66, (-1.0, 1.0): 0.46, (-1.0, -1.0): 0.66}  # m


def hold(car: Dynamics, drive: float, steer: float) -> Array:
    """Return the state (3,) after 10 s of one command from rest, without noise."""
    carry = car.start(np.zeros((1, car.n_lags + 1, 3)), np.zeros((1, car.n_lags, 2)))
    for _ in range(SETTLED):
        carry = car.step(carry, np.array([[drive, steer]]))
    return carry[0, :3]


def excite(car: Dynamics, seed: int) -> Array:
    """Return the true states (manoeuvres, T, 3) of the excitation, with noise and draws."""
    rng = np.random.default_rng(seed)
    controls = np.stack([manoeuvre.controls for manoeuvre in excitation(car.system, rng=rng)])
    batch, steps = controls.shape[:2]
    carry = car.start(
        np.zeros((batch, car.n_lags + 1, 3)),
        np.zeros((batch, car.n_lags, 2)),
        rng.standard_normal((batch, car.n_draws)),
    )
    states = np.empty((batch, steps, 3))
    for k in range(steps):
        carry = car.step(carry, controls[:, k], rng.standard_normal((batch, car.n_noise)))
        states[:, k] = carry[:, :3]
    return states


def evolve(car: Dynamics, seed: int, generations: int) -> Iterator[tuple[int, Array]]:
    """Yield (generation, best parameters) of a 50+50 strategy; parents meet each generation's trials anew."""
    task, controller = PointToPoint(), RecurrentNetwork()
    n = controller.bind(len(task.observations), car.system.nu).n_parameters
    rng = np.random.default_rng(seed)
    parents = MUTATION * rng.standard_normal((PARENTS, n))
    for generation in range(generations):
        population = np.concatenate([parents, parents + MUTATION * rng.standard_normal(parents.shape)])
        seeds = trial_seeds(seed, TRIALS, generation=generation)
        fitness = rollout(car, controller, population, task, seeds).fitness.mean(axis=1)
        parents = population[np.argsort(-fitness, kind="stable")[:PARENTS]]
        yield generation, parents[0]


def score(car: Dynamics, parameters: Array, trials: int = 100) -> Array:
    """Return the waypoints (trials,) of one controller on fresh trials."""
    seeds = trial_seeds(1_000_003, trials)
    return rollout(car, RecurrentNetwork(), parameters[None], PointToPoint(), seeds).fitness.ravel()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="emulated_car")
    parser.add_argument("--generations", type=int, default=0)
    parser.add_argument("--runs", type=int, default=2)
    arguments = parser.parse_args()
    car = make_robot(arguments.robot).dynamics
    console = Console()

    table = Table("quantity", "car", "aim", "unit", title=arguments.robot)
    for drive, aim in TOP_SPEEDS.items():
        table.add_row(f"top speed, drive {drive:+.0f}", f"{abs(hold(car, drive, 0.0)[0]):.2f}", f"{aim:.2f}", "m/s")
    for (drive, steer), aim in RADII.items():
        u, v, r = hold(car, drive, steer)
        radius = np.hypot(u, v) / abs(r)
        table.add_row(f"radius, drive {drive:+.0f} steer {steer:+.0f}", f"{radius:.2f}", f"{aim:.2f}", "m")
    rms = np.mean([np.sqrt(np.mean(excite(car, seed) ** 2, axis=(0, 1))) for seed in range(4)], axis=0)
    for value, channel in zip(rms, car.system.states, strict=True):
        table.add_row(f"RMS {channel.name}", f"{value:.3f}", f"{RMS[channel.name]:.3f}", channel.unit)
    console.print(table)

    for run in range(arguments.runs if arguments.generations else 0):
        for generation, best in evolve(car, run, arguments.generations):
            if (generation + 1) % 50 == 0 or generation + 1 == arguments.generations:
                waypoints = score(car, best)
                console.print(f"run {run}, {generation + 1} generations: {waypoints.mean():.1f} waypoints")


if __name__ == "__main__":
    main()
