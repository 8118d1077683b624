"""The predictive controller on changed cars, with a model as it was and with one that corrects itself."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from sysid_evo import DynamicsRunner, make_task
from sysid_evo.adaptation import SelfCorrection
from sysid_evo.controllers import Controller, Predictive
from sysid_evo.controllers.self_correcting import SelfCorrecting
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.engine import rollout
from sysid_evo.randomness import trial_seeds
from tests.benchmarks.predictive import Timed
from tests.benchmarks.shift.emulated import cars, recorded

TRIALS, TIMED_STEPS = 10, 100


def drive_changed_cars(model: DynamicsModel, write: Callable[[str], object]) -> None:
    """Fit ``model`` to the nominal car, let it drive all, and write waypoints and times."""
    robots = cars()
    model.fit(recorded(robots["nominal"].dynamics, seconds=240.0, seed=1), rng=0)
    laws: dict[str, Controller] = {
        "predictive": Predictive(model=model),
        "self_correcting": SelfCorrecting(model=model),
    }
    seeds, nothing = trial_seeds(5, TRIALS), np.zeros((1, 2))
    for name, robot in robots.items():
        for label, law in laws.items():
            fitness = DynamicsRunner(robot.dynamics).run(law, nothing, make_task("point_to_point"), seeds).fitness[0]
            error = fitness.std(ddof=1) / np.sqrt(len(fitness))
            write(f"{name:14s} {label:16s} {fitness.mean():5.1f} waypoints, standard error {error:.1f}\n")
    task = make_task("point_to_point", horizon=TIMED_STEPS)
    for label, law in laws.items():
        timed = Timed(law.bind_to(task.bind(model.system)))
        rollout(robots["nominal"].dynamics, timed, nothing, task, trial_seeds(0, 1), engine="reference")
        spent = timed.spent[1:]
        write(f"{label}: a decision takes {np.median(spent):.1f} ms, 99 % of them less than "
              f"{np.percentile(spent, 99):.1f} ms\n")  # fmt: skip
    learning, episode = SelfCorrection.of(model), recorded(robots["nominal"].dynamics, seconds=20.0, seed=3).episodes[0]
    memory, spent = np.zeros((1, learning.n_memory)), []
    for state, control in zip(episode.states[1:], episode.controls, strict=True):
        began = time.thread_time()
        memory = learning.observed(memory, state[None], control[None])
        spent.append(1e3 * (time.thread_time() - began))
    write(f"learning: {np.median(spent):.1f} ms a sample, 99 % less than {np.percentile(spent, 99):.1f} ms\n")
