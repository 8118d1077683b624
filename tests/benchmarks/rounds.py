"""Comparisons in rounds on environments that fall at once: ``python -m tests.benchmarks.rounds --out FOLDER``.

For each of ``--ids`` and ``--seeds`` a comparison records in ``--rounds`` rounds, in a folder of its own in ``FOLDER``
(finished ones are not repeated). Rewards and ends of the environments are functions of their observations, with
``--own`` they are learned. Prints the recorded steps, the mean return of the chosen controller over ``--trials``
episodes of 1000 steps in the environment, the round it comes from, the return of controls at rest, and the wall time.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from evaluation.rounds import ROUNDS
from evaluation.running import compare
from evaluation.transfer import transfer_seeds
from hardware.simulators.gymnasium_robot import GymnasiumRobot
from sysid_evo.controllers.controller import make_controller
from sysid_evo.evolution import Champion
from sysid_evo.evolution.champion import load_champion
from sysid_evo.tasks.task import make_task
from tests.benchmarks.markdown import add_markdown, print_tables

REWARDS = Path(__file__).with_name("pendulum_rewards.py")
"""The plugin with the rewards, which every process loads."""


@dataclass(frozen=True)
class Case:
    """The settings of the robot of one environment, and its task."""

    settings: Mapping[str, str]
    task: str

    def robot(self, name: str) -> GymnasiumRobot:
        return GymnasiumRobot(id=name, **self.settings)

    def spec(self, name: str) -> str:
        """Return the robot as text."""
        return f"gymnasium({', '.join(f'{key}={value!r}' for key, value in {'id': name, **self.settings}.items())})"


CASES: Mapping[str, Case] = {
    "InvertedPendulum-v5": Case({"channels": "cart, pole, cart_speed, pole_speed"}, "inverted_pendulum"),
    "InvertedDoublePendulum-v5": Case(
        {
            "angle": "3,1; 4,2",
            "channels": "cart, pole [rad], second [rad], cart_speed, pole_speed, second_speed, constraint_force",
        },
        "inverted_double_pendulum",
    ),
}


def returns(champion: Champion, case: Case, name: str, trials: int) -> float:
    """Return the mean return of a controller over episodes of the environment; the task's fitness is its mean."""
    task, law = make_task(champion.task), make_controller(champion.controller)
    run = case.robot(name).runner().bind(law, task)(champion.parameters[None], transfer_seeds(0, trials), record=True)
    return float(np.mean([episode.total_reward for episode in run.trajectories]))


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--ids", default=",".join(CASES))
    parser.add_argument("--seeds", default="0")
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--own", action="store_true", help="the own task of the environment, a learned reward")
    add_markdown(parser)
    given = parser.parse_args(arguments)
    heads = ("environment", "seed", "steps", "returns of the rounds", "chosen", "its return", "rest", "clock s")
    table = Table(*heads, title=f"at most {given.rounds} rounds, {given.trials} episodes", box=None)
    table.columns[0].no_wrap = True
    for name in given.ids.split(","):
        for seed in map(int, given.seeds.split(",")):
            case, folder, began = CASES[name], given.out / f"{name}-{seed}", time.perf_counter()
            report = compare(
                out=folder,
                robot=case.spec(name),
                task=None if given.own else case.task,
                rounds=given.rounds,
                seed=seed,
                transfer_trials=20,
                plugins=[REWARDS],
            )
            clock = time.perf_counter() - began
            assert report.transfer is not None
            assert report.rounds is not None
            pick = report.transfer.pick or ROUNDS
            champion, best = (
                load_champion((folder / report.controllers[one]).with_suffix("")) for one in (pick, ROUNDS)
            )
            each = [
                Champion("", one.parameters, (), "min", 0, np.empty((0, 3)), best.controller, best.task)
                for one in report.rounds.rounds
            ]
            reached = ", ".join(f"{returns(one, case, name, given.trials):.0f}" for one in each)
            chosen = [one.number for one in report.rounds.rounds if np.array_equal(one.parameters, champion.parameters)]
            rest = Champion.baseline("constant", champion.task, case.robot(name).system)
            figures = [returns(one, case, name, given.trials) for one in (champion, rest)]
            table.add_row(
                name, str(seed), str(report.rounds.steps), reached, f"{pick} {chosen[0] if chosen else ''}".strip(),
                *(f"{figure:.0f}" for figure in figures), f"{clock:.0f}",
            )  # fmt: skip
    print_tables([table], given.markdown)
    return 0


if __name__ == "__main__":
    sys.exit(main())
