"""Default comparisons and reinforcement learning: ``python -m tests.benchmarks.rounds --out FOLDER``.

For each of ``--ids`` and ``--seeds`` the default comparison is made in a folder of its own in ``FOLDER``. Returns are
means over ``--trials`` episodes in a loop of ``env.step``: of the exported Python file of the recommended controller,
of controls at rest, and of the ``--references``: ``learned`` is SAC after as many steps of the environment (PPO for
discrete actions), ``environment`` a controller of the same kind after ``--generations`` generations on the environment
itself. What was measured stands in ``figures.json`` of each folder and is not measured again.
"""

from __future__ import annotations

import argparse
import itertools
import json
import runpy
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import gymnasium
import numpy as np
from rich.table import Table
from stable_baselines3 import PPO, SAC

from evaluation.running import compare
from hardware.simulators.gymnasium_robot import GymnasiumRobot
from sysid_evo.evolution import Champion, ControllerEvolution, evolve_controller
from sysid_evo.evolution.champion import load_champion
from sysid_evo.export import exported_controller, python_text
from tests.benchmarks.markdown import add_markdown, print_tables

IDS = (
    "InvertedPendulum-v5", "InvertedDoublePendulum-v5", "Reacher-v5", "CartPole-v1", "Acrobot-v1", "Pendulum-v1",
    "MountainCarContinuous-v0",
)  # fmt: skip
FIRST_SEED = 1000
"""Seed of the first episode in which returns are measured."""

Act: TypeAlias = Callable[[Any], Any]
"""The raw action for a raw observation."""


def returns(begin: Callable[[], Act], name: str, trials: int) -> list[float]:
    """Return the return of each episode of the environment ``name``; ``begin`` is called before each of them."""
    env, found = gymnasium.make(name), []
    for trial in range(trials):
        act, total, over = begin(), 0.0, False
        observation, _ = env.reset(seed=FIRST_SEED + trial)
        while not over:
            observation, reward, terminated, truncated, _ = env.step(act(observation))
            total, over = total + float(reward), terminated or truncated
        found.append(total)
    env.close()
    return found


def exported(champion: Champion, file: Path) -> Callable[[], Act]:
    """Write the controller as a Python file, and return how it is made for an episode."""
    file.write_text(python_text(exported_controller(champion)), encoding="utf-8")
    made: Callable[[], Act] = runpy.run_path(str(file))["Controller"]
    return made


def learned(name: str, steps: int, seed: int) -> Callable[[], Act]:
    """Return a policy after ``steps`` steps of the environment, with the settings of Stable-Baselines3."""
    env = gymnasium.make(name)
    discrete = isinstance(env.action_space, gymnasium.spaces.Discrete)
    algorithm = (PPO if discrete else SAC)("MlpPolicy", env, seed=seed, device="cpu")
    algorithm.learn(steps)
    return lambda: lambda observation: algorithm.predict(observation, deterministic=True)[0]


def evolved(champion: Champion, robot: GymnasiumRobot, generations: int, seed: int) -> Champion:
    """Evolve a controller like ``champion`` on the environment itself."""
    settings = ControllerEvolution(
        generations=generations,
        trials=3,
        selection_trials=20,
        task=champion.task,
        controller=champion.controller,
        strategy="cma_es(sigma=0.3)",
    )
    return evolve_controller("environment", {"environment": robot.runner()}, robot.system, settings, seed=seed)


def compared(name: str, folder: Path, seed: int, trials: int) -> dict[str, Any]:
    """Make the default comparison for the environment ``name`` in ``folder``, and return its figures."""
    began = time.perf_counter()
    report = compare(out=folder, robot=f'gymnasium(id="{name}")', seed=seed)
    clock = time.perf_counter() - began
    assert report.transfer is not None
    assert report.transfer.pick is not None
    file = folder / report.controllers[report.transfer.pick]
    champion = load_champion(file.with_suffix(""))
    rest = Champion.baseline("constant", champion.task, GymnasiumRobot(id=name).system)
    found = returns(exported(champion, folder / "recommended.py"), name, trials)
    return {
        "file": str(file.relative_to(folder)),
        "controller": champion.controller.text,
        "steps": sum(episode.steps for part in (report.data.training, report.data.test) for episode in part),
        "rounds": None if report.rounds is None else len(report.rounds.rounds),
        "return": float(np.mean(found)),
        "lowest": min(found),
        "rest": float(np.mean(returns(exported(rest, folder / "rest.py"), name, trials))),
        "clock": clock,
    }


def measured(name: str, folder: Path, seed: int, given: argparse.Namespace) -> dict[str, Any]:
    """Return the figures of one row: those of ``figures.json``, and those that are asked for and not there yet."""
    file = folder / "figures.json"
    figures: dict[str, Any] = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    if not figures:
        figures |= compared(name, folder, seed, given.trials)
    if "learned" in given.references and "learned" not in figures:
        figures["learned"] = float(np.mean(returns(learned(name, figures["steps"], seed), name, given.trials)))
    if "environment" in given.references and "environment" not in figures:
        like = load_champion((folder / figures["file"]).with_suffix(""))
        own = exported(evolved(like, GymnasiumRobot(id=name), given.generations, seed), folder / "environment.py")
        figures["environment"] = float(np.mean(returns(own, name, given.trials)))
    file.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    return figures


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--ids", default=",".join(IDS))
    parser.add_argument("--seeds", default="0")
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--references", nargs="*", choices=("learned", "environment"), default=())
    parser.add_argument("--generations", type=int, default=60)
    add_markdown(parser)
    given = parser.parse_args(arguments)
    heads = (
        "environment", "seed", "recorded steps", "rounds", "controller", "return", "lowest", "rest", "SAC or PPO",
        "evolved on the environment", "comparison, s",
    )  # fmt: skip
    table = Table(*heads, title=f"default settings, {given.trials} episodes", box=None)
    for name, seed in itertools.product(given.ids.split(","), map(int, given.seeds.split(","))):
        row = measured(name, given.out / f"{name}-{seed}", seed, given)
        shown = (row.get(key) for key in ("return", "lowest", "rest", "learned", "environment"))
        table.add_row(
            name, str(seed), str(row["steps"]), str(row["rounds"] or "–"), row["controller"],
            *("–" if value is None else f"{value:.4g}" for value in shown), f"{row['clock']:.0f}",
        )  # fmt: skip
    print_tables([table], given.markdown)
    return 0


if __name__ == "__main__":
    sys.exit(main())
