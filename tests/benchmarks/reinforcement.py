"""Evolution, PPO and SAC on the same models of one robot: claimed and achieved fitness, processor seconds, samples.

Run: python -m tests.benchmarks.reinforcement --robot 'gymnasium(id="Pendulum-v1")' --steps 50000
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gymnasium import spaces
from rich.table import Table
from stable_baselines3 import PPO, SAC

from evaluation.transfer.matrix import TransferMatrix, transfer
from evaluation.transfer.summary import MatrixEstimates
from hardware.robot import Robot, find_robot
from sysid_evo.engine import DynamicsRunner
from sysid_evo.environments import champion_from_policy, make_vector_env
from sysid_evo.environments.stable_baselines import StableBaselinesEnv
from sysid_evo.evolution import Champion, ControllerEvolution, evolve_controller
from sysid_evo.models import Dynamics
from sysid_evo.models.base import make_model
from sysid_evo.registry import Spec
from sysid_evo.tasks.task import make_task
from tests.benchmarks.markdown import add_markdown, print_tables

COPIES = 16
ALGORITHMS: Mapping[str, Any] = {"ppo": PPO, "sac": SAC}
SETTINGS: Mapping[str, dict[str, Any]] = {
    "ppo": {"n_steps": 256, "batch_size": 256, "gae_lambda": 0.95, "gamma": 0.98, "ent_coef": 0.0},
    "sac": {"learning_starts": 2000, "train_freq": 4, "gradient_steps": 8, "batch_size": 256},
}


@dataclass(frozen=True)
class Entry:
    """A champion, the processor time of its training in s, and the number of model steps used."""

    champion: Champion
    seconds: float
    samples: int


def learned(name: str, members: Mapping[str, Dynamics], task: str, *, steps: int, seed: int) -> Entry:
    """Train an algorithm in the ensemble of ``members`` for ``steps`` steps of it."""
    env = make_vector_env(members, task, num_envs=COPIES, actions="continuous", seed=seed)
    assert isinstance(env.single_action_space, spaces.Box)
    began = time.process_time()
    algorithm = ALGORITHMS[name]("MlpPolicy", StableBaselinesEnv(env), seed=seed, device="cpu", **SETTINGS[name])
    algorithm.learn(steps)
    seconds = time.process_time() - began
    return Entry(
        champion_from_policy(algorithm, env.trials, name=name, task=task, seed=seed), seconds, algorithm.num_timesteps
    )


def evolved(members: Mapping[str, Dynamics], task: str, *, generations: int, trials: int, seed: int) -> Entry:
    """Evolve a controller against all ``members`` at once, by their mean, as the others learn."""
    settings = ControllerEvolution(
        generations=generations,
        trials=trials,
        aggregate="mean",
        task=Spec.parse(task),
        controller=Spec.parse("recurrent(hidden=10)"),
        strategy=Spec.parse("niches"),
    )
    system = next(iter(members.values())).system
    runners = {label: DynamicsRunner(member) for label, member in members.items()}
    began = time.process_time()
    champion = evolve_controller("evolution", runners, system, settings, seed=seed)
    seconds = time.process_time() - began
    strategy = settings.make_strategy(settings.make_controller(settings.make_task(system)).n_parameters, 0)
    candidates = len(strategy.ask())
    samples = candidates * trials * generations * len(members) * make_task(settings.task).horizon
    return Entry(champion, seconds, samples)


def compared(entries: list[Entry], members: Mapping[str, Dynamics], robot: Robot, *, trials: int) -> TransferMatrix:
    """Run every champion on every member, and on the robot."""
    runner = robot.runner()
    assert runner is not None
    runners = {label: DynamicsRunner(member) for label, member in members.items()}
    columns = {**runners, robot.name: runner}
    return transfer([entry.champion for entry in entries], columns, seed=0, robot=robot.name, trials=trials, traces=0)


def main(arguments: list[str] | None = None) -> None:
    """Print one line for each way to a controller."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default='gymnasium(id="Pendulum-v1")')
    parser.add_argument("--task", default='environment(id="Pendulum-v1")')
    parser.add_argument("--models", default="sindy,nearest_neighbour")
    parser.add_argument("--algorithms", default="ppo,sac")
    parser.add_argument("--minutes", type=float, default=6.0)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--generations", type=int, default=900)
    parser.add_argument("--trials", type=int, default=5)
    parser.add_argument("--judged", type=int, default=100, help="trials in which every controller is run at the end")
    parser.add_argument("--seed", type=int, default=0)
    add_markdown(parser)
    given = parser.parse_args(arguments)
    robot = find_robot(given.robot)
    data = robot.record(seed=given.seed, duration=60.0 * given.minutes).dataset
    specs = Spec.parse_many(given.models)
    members: dict[str, Dynamics] = {spec.label: make_model(spec).fit(data, rng=given.seed) for spec in specs}
    entries = [
        evolved(members, given.task, generations=given.generations, trials=given.trials, seed=given.seed),
        *(
            learned(name, members, given.task, steps=given.steps, seed=given.seed)
            for name in given.algorithms.split(",")
        ),
    ]
    matrix = compared(entries, members, robot, trials=given.judged)
    table = Table("", "claimed", "achieved", "processor s", "samples", box=None)
    for entry in entries:
        claim = MatrixEstimates(matrix).on(entry.champion, tuple(members))
        claimed = float("nan") if claim is None else claim.value
        achieved = matrix.cell(entry.champion.name, robot.name).mean
        figures = (f"{claimed:.1f}", f"{achieved:.1f}", f"{entry.seconds:.1f}", f"{entry.samples:,}")
        table.add_row(entry.champion.name, *figures)
    print_tables([table], given.markdown)


if __name__ == "__main__":
    main()
