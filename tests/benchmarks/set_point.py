"""Comparison of set-point controllers: ``python -m tests.benchmarks.set_point --out FOLDER``.

The emulated heater (``--robot``) is recorded and a linear model is identified in ``FOLDER`` (finished steps are not
repeated). LQR is computed from that model. A PID, linear feedback and networks are evolved in the model for
``--generations``, and on the robot itself (a PID evolved there is a tuned one). All run the same ``--trials`` fresh
trials of `set_point` on the robot. Prints score, share of trials that settle, settling time and overshoot.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from rich.table import Table

from evaluation import compare
from sysid_evo import (
    ControllerEvolution,
    DynamicsRunner,
    evolve_controller,
    load_model,
    make_controller,
    make_robot,
    make_task,
)
from sysid_evo.randomness import trial_seeds
from sysid_evo.types import Array
from tests.benchmarks.markdown import add_markdown, print_tables

EVOLVED = ("pid", "linear", "feed_forward", "recurrent")
TASK = "set_point"


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--robot", default="thermal")
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--generations", type=int, default=60)
    add_markdown(parser)
    options = parser.parse_args(arguments)
    compare(out=options.out, robot=options.robot, models=["linear"], stop_after="fit")
    file = next((options.out / "models").glob("linear-*.json"))
    robot, model = make_robot(options.robot), load_model(file)
    task, runner, seeds = make_task(TASK), DynamicsRunner(robot.dynamics), trial_seeds(9, options.trials)
    table = Table(title=f"{TASK} on {options.robot}, {options.trials} trials")

    def add(name: str, where: str, controller: str, parameters: Array) -> None:
        run = runner.bind(make_controller(controller), task)(parameters[None], seeds)
        measures = task.bind(robot.system).measures(run.task_state)
        if not table.columns:
            for heading in ("controller", "from", "score", *measures):
                table.add_column(heading, justify="left" if heading in ("controller", "from") else "right")
        known = [value[np.isfinite(value)] for value in measures.values()]
        table.add_row(name, where, *(f"{v.mean():.1f}" if v.size else "-" for v in (run.fitness, *known)))

    add("lqr", "the model", f"lqr(model={str(file)!r})", np.zeros(1))
    for controller in EVOLVED:
        settings = ControllerEvolution(
            generations=options.generations, controller=controller, task=TASK, selection_trials=40
        )
        for where, dynamics in (("the model", model), ("the robot", robot.dynamics)):
            runners = {where: DynamicsRunner(dynamics)}
            champion = evolve_controller(controller, runners, robot.system, settings, seed=0)
            add(controller, where, controller, champion.parameters)
    print_tables([table], options.markdown)
    return 0


if __name__ == "__main__":
    sys.exit(main())
