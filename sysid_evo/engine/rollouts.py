"""Closed loop: controllers in a dynamics at a task, many candidates in many trials at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol, TypeAlias, get_args

import numpy as np

from sysid_evo.arrays import Array, IntArray, Seeds, check_shape
from sysid_evo.controllers.controller import Controller
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import reference
from sysid_evo.errors import InvalidArgument
from sysid_evo.processors import available_processors as available_processors
from sysid_evo.tasks.task import Task, TaskState

Engine: TypeAlias = Literal["auto", "reference", "float32", "float64"]


@dataclass(frozen=True)
class Rollouts:
    """What P candidates did in E trials.

    ``fitness`` (P, E) is never nan: a trial that diverged has ``task.worst - 1 + survived /
    horizon``, below any that did not. ``survived`` (P, E) steps; ``clipped`` (P, E) counts the
    steps whose state was clipped to the model's envelope. ``behaviour`` (P, E, d) says what the controller
    did, see `behaviour_names`; d is 0 where nobody counted. ``doubt`` (P, E) is what the dynamics counted of it, in
    steps, see `Dynamics`; 0 where it counts none, empty where nobody asked it. ``trajectories`` (only when recorded)
    stand candidate first, trial second; ``task_state`` is the last one. ``engine`` names the form
    that ran. On a robot trials may be ``missing``: one reason for each that is not among the E.
    """

    fitness: Array
    survived: IntArray
    clipped: IntArray
    task_state: TaskState
    engine: str
    behaviour: Array = field(default_factory=lambda: np.empty((0, 0, 0)))
    doubt: Array = field(default_factory=lambda: np.empty((0, 0)))
    trajectories: tuple[Trajectory, ...] = ()
    missing: tuple[str, ...] = ()


class Runner(Protocol):
    """How a controller is run on something: a column of the transfer matrix, a member of an ensemble.

    `DynamicsRunner` runs a model or an emulated robot, all trials at once; a physical robot is run by its
    control loop, one trial at a time. Anything else with this one method can be evolved on and compared.
    """

    def run(
        self, controller: Controller, parameters: Array, task: Task, seeds: Seeds, *, record: bool = False
    ) -> Rollouts:
        """Run every candidate (P, n_parameters) in a trial of every seed (E,), the same trials for all.

        ``controller`` and ``task`` are bound here, to what is run on. The fitness (P, E) is never nan. With
        ``record`` the trajectories are kept. Only a robot leaves trials out, and says why in ``missing``.
        """
        ...


@dataclass(frozen=True)
class DynamicsRunner:
    """Runs controllers on a `Dynamics`: a model or an emulated robot.

    ``engine`` and ``threads`` as for `rollout`.
    """

    dynamics: Dynamics
    engine: Engine = "auto"
    threads: int | None = None

    def run(
        self, controller: Controller, parameters: Array, task: Task, seeds: Seeds, *, record: bool = False
    ) -> Rollouts:
        """Run every candidate (P, n_parameters) in a trial of every seed (E,), see `rollout`."""
        return rollout(
            self.dynamics,
            controller,
            parameters,
            task,
            seeds,
            record=record,
            engine=self.engine,
            threads=self.threads,
        )


def as_runners(given: Mapping[str, Runner | Dynamics], what: str) -> dict[str, Runner]:
    """Return runners by name; a bare model or emulated robot is run by a `DynamicsRunner`. Raises `InvalidArgument`."""
    if not isinstance(given, Mapping):
        raise InvalidArgument(
            f"{what}: expected models or runners by name, {{name: model}}, got {type(given).__name__}"
        )
    found = {name: DynamicsRunner(one) if isinstance(one, Dynamics) else one for name, one in given.items()}
    for name, runner in found.items():
        if not hasattr(runner, "run"):
            raise InvalidArgument(f"{what}: {name!r} is a {type(runner).__name__}, no model and no runner")
    return found


def rollout(
    dynamics: Dynamics,
    controller: Controller,
    parameters: Array,
    task: Task,
    seeds: Seeds,
    *,
    record: bool = False,
    engine: Engine = "auto",
    threads: int | None = None,
) -> Rollouts:
    """Run every candidate ``parameters`` (P, n_parameters) in a trial of every seed (E,).

    Candidates meet the same trials: waypoints, noise and draws depend on the trial's seed alone.

    ``engine`` is "float32" or "float64" (dynamics, controller and task compiled) or "reference" (NumPy, any object);
    "auto" is compiled, in the precision of the dynamics' kernel, if all three have kernels, else the reference.
    `Rollouts.engine` says which ran.
    Scores do not depend on ``threads`` (default: all processors this process may use).
    Raises `IncompatibleTask`, `ShapeError`, `InvalidArgument`.
    """
    task = task.bind(dynamics.system)
    controller = controller.bind_to(task)
    parameters = check_shape("parameters", parameters, (None, controller.n_parameters))
    if len(seeds) < 1:
        raise InvalidArgument("rollout: expected at least one trial seed, got none")
    if engine not in get_args(Engine):
        raise InvalidArgument(f"rollout: engine is {', '.join(get_args(Engine))}, not {engine!r}")
    if threads is not None and threads < 1:
        raise InvalidArgument(f"rollout: expected at least one thread, got {threads}")
    if engine != "reference":
        of_dynamics, of_task = dynamics.kernel(), task.kernel()
        of_controller = None if controller.n_noise else controller.kernel()
        if of_dynamics is not None and of_controller is not None and of_task is not None:
            from sysid_evo.engine.compiled import run

            found = run.run(
                run.Kernels(of_dynamics, of_controller, of_task),
                dynamics,
                controller,
                parameters,
                task,
                seeds,
                record=record,
                precision=of_dynamics.precision if engine == "auto" else engine,
                threads=threads or available_processors(),
            )
            return Rollouts(**found)
        if engine != "auto":
            roles = {"dynamics": of_dynamics, "controller": of_controller, "task": of_task}
            missing = ", ".join(role for role, kernel in roles.items() if kernel is None)
            raise InvalidArgument(f"rollout: engine {engine!r} cannot run this: there is no kernel of the {missing}")
    return Rollouts(**reference.run(dynamics, controller, parameters, task, seeds, record=record))
