"""Controllers evolved in models only against ones evolved on the simulator: ``python -m tests.benchmarks.bodies``.

A comparison records each of ``--cases``, a robot and perhaps a task, and evolves in the models. Another search, from
the same starts, runs on the compiled equations of the simulator, see `tests.benchmarks.bodies.flight` and
`tests.benchmarks.bodies.sliding`. Prints what both controllers achieve on the robot in the same trials. Finished steps
in the folder ``--out`` are not repeated.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from rich.table import Table

from evaluation import compare
from evaluation.cells.controllers import DEFAULT_STARTS
from evaluation.transfer.matrix import transfer
from hardware.robot import Robot, find_robot
from hardware.simulators.drift_car import DriftCar
from hardware.simulators.quadrotor import Quadrotor
from sysid_evo.engine import DynamicsRunner
from sysid_evo.evolution import ControllerEvolution, evolve_controller
from sysid_evo.evolution.halving import Start
from sysid_evo.models.dynamics import PlainDynamics
from tests.benchmarks.bodies.agreement import agreement
from tests.benchmarks.bodies.flight import Flight
from tests.benchmarks.bodies.sliding import Slide
from tests.benchmarks.markdown import add_markdown, print_tables

CASES = ("quadrotor/hover", "quadrotor/point_to_point", "drift_car")
COLUMNS = (
    "robot",
    "task",
    "recommended",
    "from models",
    "from simulator",
    "share",
    "wall, s",
    "search, s",
)
WORDS = 3


def compiled(robot: Robot) -> tuple[PlainDynamics, float]:
    """Return the compiled equations of a robot, and the largest difference of a state from the robot."""
    if isinstance(robot, Quadrotor):
        flight = Flight(robot)
        return flight, agreement(flight, robot.simulator, amplitude=0.7)  # full commands turn it over
    assert isinstance(robot, DriftCar)
    slide = Slide(robot)
    return slide, agreement(slide, robot.simulator, amplitude=1.0)


def row_of(case: str, options: argparse.Namespace) -> tuple[str, ...]:
    """Return one row of the table; what is achieved are means over trials, ± standard errors."""
    name, _, task = case.partition("/")
    robot, began = find_robot(name), time.monotonic()
    task = task or str(getattr(robot, "default_task", ""))
    given = {name: value for name in ("minutes", "generations") if (value := getattr(options, name)) is not None}
    report = compare(
        out=options.out / case.replace("/", "-"), robot=name, task=task, seed=options.seed, robot_trials=options.trials,
        **given,
    )  # fmt: skip
    took, began = time.monotonic() - began, time.monotonic()
    simulator, difference = compiled(robot)
    search = ControllerEvolution(generations=options.on_simulator, task=task, starts=Start.listed(DEFAULT_STARTS))
    own = evolve_controller("own", {"simulator": DynamicsRunner(simulator)}, robot.system, search, seed=options.seed)
    searched, runner = time.monotonic() - began, robot.runner()
    assert runner is not None
    assert report.transfer is not None
    there = transfer([own], {name: runner}, seed=options.seed, robot=name, trials=options.trials).cell("own", name)
    pick = next(one for one in report.transfer.controllers if one.name == report.transfer.pick)
    assert pick.achieved is not None
    return (
        f"{name} (equations within {difference:.1g})",
        task,
        f"{pick.name} of {', '.join(pick.against)}",
        f"{pick.achieved.value:.1f} ± {pick.achieved.standard_error:.1f}",
        f"{there.mean:.1f} ± {there.standard_error:.1f}",
        f"{100.0 * pick.achieved.value / there.mean:.0f} %" if there.mean > 0.0 else "",
        f"{took:.0f}",
        f"{searched:.0f}",
    )


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cases", nargs="+", default=CASES)
    parser.add_argument("--minutes", type=float, help="of the first recording (default: that of a comparison)")
    parser.add_argument("--trials", type=int, default=20, help="of each controller on the robot")
    parser.add_argument("--generations", type=int, help="of each search in models (default: the preset's)")
    parser.add_argument("--on-simulator", type=int, default=450, help="generations of the search on the simulator")
    parser.add_argument("--seed", type=int, default=0)
    add_markdown(parser)
    options = parser.parse_args(arguments)
    table = Table(title="evolved in models only, and on the simulator itself")
    for number, heading in enumerate(COLUMNS):
        table.add_column(heading, justify="right" if number >= WORDS else "left")
    for case in options.cases:
        table.add_row(*row_of(case, options))
    print_tables([table], options.markdown)
    return 0


if __name__ == "__main__":
    sys.exit(main())
