"""Detection of faults planted into models: ``python -m tests.benchmarks.planted``.

Each fault of `tests.fixtures.faults` is planted into the equations of the toy car or the pendulum; the equations
without a fault are the robot. Both are examined like the models of a comparison, with random commands, the champion of
an ordinary evolution, and the controller of the search for exploits. A fault is named if one of its plausibility checks
fails, if an input-output slope of one of its states is wrong, or if one of its states behaves differently than on the
robot. Then equations without faults are examined as models, ``--seeds`` (5) of each kind, and so is every recording of
a real car: a fault that is named there is a false alarm.

Exit code 1 if a fault that helps controllers is not found by the search and named, if another fault is not named, or if
there is a false alarm. ``--generations`` (200) is the length of each evolution.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table

from evaluation.exploitability.assessment import assess_exploitability
from evaluation.exploitability.probes import probe_limits
from evaluation.exploitability.results import ModelExploitability, ProbeResult
from evaluation.exploitability.search import search_exploit
from evaluation.exploitability.slopes import SlopeComparison
from evaluation.steps import Steps, training_support
from evaluation.transfer.matrix import transfer
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.engine import DynamicsRunner
from sysid_evo.evolution import Champion, ControllerEvolution, evolve_controller
from sysid_evo.models import Dynamics
from sysid_evo.registry import Spec, make_robot
from tests.benchmarks.cars import recording
from tests.benchmarks.markdown import add_markdown, print_tables
from tests.fixtures.faults import FAULTS, Fault, driven, equations

TASKS = {
    "emulated_car": "point_to_point",
    "pendulum": "swing_up",
    "cart_pole": "balance",
    "thermal": "set_point",
}
LOG = "slippery_20hz"
MINUTES = 6.0
MODEL, ROBOT = "model", "robot"


@dataclass(frozen=True)
class Shown:
    """Data of a robot: training and held-out ``parts``."""

    robot: str
    training: Dataset
    test: Dataset

    @classmethod
    def by(cls, robot: str) -> Shown:
        """Record a robot."""
        training, test = make_robot(robot).record(seed=0, duration=60.0 * MINUTES).dataset.split(0.25)
        return cls(robot, training, test)

    def named(self, runs: Sequence[Trajectory]) -> set[str]:
        """Return the checks that fail in ``runs``, and the states with a wrong input-output slope."""
        visited, held_out = (Steps.of(self.training.system, runs), Steps.moving(self.test))
        found = {
            limit.name
            for limit in probe_limits(Steps.moving(self.training))
            if ProbeResult(limit.name, "", "", None, limit.share(visited), limit.share(held_out), None).exploited
        }
        laws = SlopeComparison(self.training, training_support(self.training))
        return found | {fact.state for fact in laws.facts(tuple(runs))}

    def looked_at(self, champion: Champion, dynamics: Mapping[str, Dynamics]) -> ModelExploitability:
        """Return the findings on a controller in the first of ``dynamics``; the one called `ROBOT` is the robot."""
        runners = {name: DynamicsRunner(one) for name, one in dynamics.items()}
        matrix = transfer([champion], runners, seed=0, robot=ROBOT if ROBOT in runners else None)
        return assess_exploitability(matrix, self.training, self.test)[0]


def names(found: ModelExploitability) -> set[str]:
    """Return the plausibility checks that failed, and the states with a wrong input-output slope."""
    return {probe.name for probe in found.exploits} | {fact.state for fact in found.slope_differences}


def verdict_on(wanted: set[str], found: ModelExploitability) -> str:
    """Return whether one of ``wanted`` is named by a check or slope ("yes"), by behaviour, or not ("no")."""
    if wanted & names(found):
        return "yes"
    return "behaviour" if any(name in one.name.split() for one in found.behaviours for name in wanted) else "no"


def settings(robot: str, generations: int) -> ControllerEvolution:
    """Return the settings of controller evolution on a robot."""
    task = Spec.parse(TASKS[robot.partition(":")[0]])
    return ControllerEvolution(
        generations=generations,
        trials=5,
        task=task,
        controller=Spec.parse("recurrent(hidden=10)"),
        strategy=Spec.parse("niches"),
    )


def planted_row(fault: Fault, shown: Shown, generations: int) -> tuple[tuple[str, ...], bool]:
    """Return a row of the table, and whether it is as it should be."""
    planted, robot = fault.planted(), equations(fault.robot)
    both, how = {MODEL: planted, ROBOT: robot}, settings(fault.robot, generations)
    runners = {name: DynamicsRunner(one) for name, one in both.items()}
    wanted = set(fault.named)
    at_random = bool(wanted & shown.named(driven(planted)))
    ordinary = evolve_controller(MODEL, {MODEL: runners[MODEL]}, planted.system, how, seed=0)
    usual = shown.looked_at(ordinary, both)
    exploit = search_exploit(MODEL, runners, planted.system, how, seed=0)
    found = shown.looked_at(exploit.champion, both)
    in_usual, in_search = verdict_on(wanted, usual), verdict_on(wanted, found)
    assert usual.claimed is not None
    assert usual.achieved is not None
    row = (
        fault.name,
        ", ".join(fault.named),
        _yes(at_random),
        f"{usual.claimed.value:.1f} → {usual.achieved.value:.1f}",
        in_usual,
        f"{exploit.here:.1f} → {exploit.elsewhere[ROBOT]:.1f}",
        f"{exploit.size:+.1f}",
        in_search,
        ", ".join(sorted((names(usual) | names(found)) - wanted)) or "–",
    )
    return row, in_search != "no" if fault.gains else at_random or {in_usual, in_search} != {"no"}


def alarms(robot: str, generations: int) -> tuple[set[str], set[str]]:
    """Return the faults named in equations without faults: under random commands, and of a controller evolved there."""
    shown, sound = Shown.by(robot), equations(robot)
    champion = evolve_controller(
        MODEL, {MODEL: DynamicsRunner(sound)}, sound.system, settings(robot, generations), seed=0
    )
    return shown.named(driven(sound)), names(shown.looked_at(champion, {MODEL: sound}))


def recorded(log: str) -> Iterator[tuple[str, set[str]]]:
    """Yield what is named of each recording of a real car, as if driven in a model of the others."""
    training, test = recording(log)
    episodes = [*training.episodes, *test.episodes]
    for number, episode in enumerate(episodes):
        others = [other for other in episodes if other is not episode]
        held_out = others.pop(number % len(others))
        shown = Shown(log, training.with_episodes(others), training.with_episodes([held_out]))
        yield f"{log}, {episode.name[-8:]}", shown.named([episode])


def _yes(found: bool) -> str:
    return "yes" if found else "no"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--generations", type=int, default=200)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--only", choices=("faults", "sound"), help="one of the two tables")
    parser.add_argument("--fault", help="the faults whose names hold this")
    add_markdown(parser)
    arguments = parser.parse_args()
    console, well, tables = Console(width=160), True, []
    if arguments.only != "sound":
        table = Table(title="claimed in the model → achieved on the robot as it is")
        for head in ("fault", "to be named", "at random", "champion", "named", "search", "size", "named", "also named"):
            table.add_column(head)
        shown = {robot: Shown.by(robot) for robot in dict.fromkeys(fault.robot for fault in FAULTS)}
        for fault in FAULTS:
            if (arguments.fault or "") in fault.name:
                row, right = planted_row(fault, shown[fault.robot], arguments.generations)
                table.add_row(*row, style=None if right else "red")
                well &= right
        tables.append(table)
    if arguments.only != "faults":
        table = Table("sound robot", "random commands, or as recorded", "evolved in it", title="false alarms")
        for kind in TASKS:
            for seed in range(arguments.seeds):
                robot = f"{kind}:{seed}" if seed else kind
                found = alarms(robot, arguments.generations)
                table.add_row(robot, *(", ".join(sorted(one)) or "–" for one in found))
                well &= not any(found)
        for name, named in recorded(LOG):
            table.add_row(name, ", ".join(sorted(named)) or "–", "")
            well &= not named
        tables.append(table)
    print_tables(tables, arguments.markdown, console)
    console.print(f"{time.process_time():.0f} s of processor time")
    sys.exit(0 if well else 1)


if __name__ == "__main__":
    main()
