"""Rollouts: controllers in a dynamics at a task, many candidates in many trials at once; the runners that make them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, Protocol, get_args

import numpy as np

from sysid_evo.controllers.controller import Controller
from sysid_evo.engine import reference
from sysid_evo.engine.compiled.closed_loop import LoopData, LoopTrials, RolloutKernels, run_in_threads
from sysid_evo.engine.results import Rollouts, finished
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import Precision
from sysid_evo.models.dynamics import Dynamics, enough, started
from sysid_evo.processors import Engine, available_processors, resolve
from sysid_evo.randomness import draw_for_steps, draw_for_trials
from sysid_evo.tasks.task import Task
from sysid_evo.types import Array, Seeds, check_shape


class BoundRunner(Protocol):
    """A controller and a task bound to what they are run on: bound once, run often."""

    def __call__(self, parameters: Array, seeds: Seeds, *, record: bool = False) -> Rollouts:
        """Run every candidate (P, n_parameters) in a trial of every seed (E,), the same trials for all.

        The fitness (P, E) is never nan. With ``record`` the trajectories are kept. Only a robot leaves trials out, and
        says why in ``missing``.
        """
        ...


class Runner(Protocol):
    """How a controller is run on something: a column of the transfer matrix, a member of an ensemble.

    `DynamicsRunner` runs a model or an emulated robot, all trials at once; a physical robot is run by its
    control loop, one trial at a time. Anything else with this one method can be evolved on and compared.
    """

    def bind(self, controller: Controller, task: Task) -> BoundRunner:
        """Return what runs ``controller`` at ``task``, both bound here. Raises `IncompatibleTask` before any trial."""
        ...


@dataclass(frozen=True)
class DynamicsRunner:
    """Runs controllers on a `Dynamics`: a model or an emulated robot.

    ``engine`` and ``threads`` as for `rollout`.
    """

    dynamics: Dynamics
    engine: Engine = "auto"
    threads: int | None = None

    def bind(self, controller: Controller, task: Task) -> BoundRollout:
        """Return what runs ``controller`` at ``task`` in the dynamics, see `rollout`."""
        return BoundRollout(self.dynamics, controller, task, engine=self.engine, threads=self.threads)


@dataclass(frozen=True)
class PenalisedRunner:
    """A runner whose fitness is that of ``runner`` less the penalty: its mean over the steps of the task.

    A trial that diverges is in penalty from beginning to end and loses ``most``, so that it stays below all others.
    """

    runner: Runner
    most: float

    def bind(self, controller: Controller, task: Task) -> BoundRunner:
        """Return what runs ``controller`` at ``task``, see `Runner`."""
        bound = self.runner.bind(controller, task)

        def discounted(parameters: Array, seeds: Seeds, *, record: bool = False) -> Rollouts:
            run = bound(parameters, seeds, record=record)
            if run.penalty.shape != run.fitness.shape:
                return run
            lost = np.where(run.fitness < task.worst, self.most, run.penalty / task.horizon)
            return replace(run, fitness=run.fitness - lost)

        return discounted


def as_runners(given: Mapping[str, Runner | Dynamics], what: str) -> dict[str, Runner]:
    """Return runners by name; a bare model or emulated robot is run by a `DynamicsRunner`. Raises `InvalidArgument`."""
    if not isinstance(given, Mapping):
        raise InvalidArgument(
            f"{what}: expected models or runners by name, {{name: model}}, got {type(given).__name__}"
        )
    found = {name: DynamicsRunner(one) if isinstance(one, Dynamics) else one for name, one in given.items()}
    for name, runner in found.items():
        if not hasattr(runner, "bind"):
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
    "auto" is compiled, in the precision of the dynamics' kernel, if all three have kernels, else the reference; in
    float64 where a state is far from zero for how much it changes (`far_from_zero`). With `SYSID_EVO_ENGINE=reference`
    in the environment, "auto" is the reference.
    `Rollouts.engine` says which ran.
    Scores do not depend on ``threads`` (default: all processors this process may use).
    Raises `IncompatibleTask`, `ShapeError`, `InvalidArgument`.
    """
    return BoundRollout(dynamics, controller, task, engine=engine, threads=threads)(parameters, seeds, record=record)


class BoundRollout:
    """A controller and a task bound to a dynamics, and what of it is compiled; arguments as for `rollout`.

    It keeps the kernel of the dynamics as it is now: a model that is fitted again must be bound again.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        controller: Controller,
        task: Task,
        *,
        engine: Engine = "auto",
        threads: int | None = None,
    ) -> None:
        self.dynamics, self.task = dynamics, task.bind(dynamics.system)
        self.controller = controller.bind_to(self.task)
        if engine not in get_args(Engine):
            raise InvalidArgument(f"rollout: engine is {', '.join(get_args(Engine))}, not {engine!r}")
        if threads is not None and threads < 1:
            raise InvalidArgument(f"rollout: expected at least one thread, got {threads}")
        self.threads = threads or available_processors()
        engine = resolve(engine)
        self.compiled = None if engine == "reference" else self._compiled(engine)

    def _compiled(self, engine: Literal["auto"] | Precision) -> LoopData | None:
        """Return the compiled form; None where a kernel is missing. Raises `InvalidArgument` if it was asked for."""
        dynamics, task, controller = self.dynamics, self.task, self.controller
        of_dynamics, of_task = dynamics.kernel(), task.kernel()
        of_controller = None if controller.n_noise else controller.kernel()
        if of_dynamics is None or of_controller is None or of_task is None:
            if engine == "auto":
                return None
            roles = {"dynamics": of_dynamics, "controller": of_controller, "task": of_task}
            missing = ", ".join(role for role, kernel in roles.items() if kernel is None)
            raise InvalidArgument(f"rollout: engine {engine!r} cannot run this: there is no kernel of the {missing}")
        return LoopData(
            RolloutKernels(of_dynamics, of_controller, of_task),
            dynamics.system,
            n_memory=controller.n_memory,
            n_observations=len(task.observations),
            seen=dynamics.observed_at,
            penalty_at=dynamics.penalty_at,
            state_bounds=dynamics.state_bounds,
            precision=enough(of_dynamics.precision, dynamics.state_bounds) if engine == "auto" else engine,
        )

    def __call__(self, parameters: Array, seeds: Seeds, *, record: bool = False) -> Rollouts:
        """Run every candidate (P, n_parameters) in a trial of every seed (E,), see `rollout`."""
        dynamics, task = self.dynamics, self.task
        parameters = check_shape("parameters", parameters, (None, self.controller.n_parameters))
        if len(seeds) < 1:
            raise InvalidArgument("rollout: expected at least one trial seed, got none")
        if self.compiled is None:
            return reference.run(dynamics, self.controller, parameters, task, seeds, record=record)
        trials, began, of_task = len(seeds), task.begin(seeds), self.compiled.kernels.task
        noise = np.empty((trials, task.horizon, dynamics.n_noise))
        run_in_threads(lambda: partial(_draw, seeds, noise), trials, self.threads)
        carry = started(dynamics, began.state, draw_for_trials(seeds, dynamics.n_draws))
        begun = LoopTrials(
            theta=parameters,
            carry=check_shape("start", carry, (trials, dynamics.n_carry)),
            task=of_task.rows(began),
            trial_data=of_task.trial_data(began),
            noise=noise,
        )
        found, rows = self.compiled.run(begun, record=record, threads=self.threads)
        task_state = of_task.state(began.tile(len(parameters)), rows)
        return finished(found, task, dynamics.system, began, task_state, f"compiled {self.compiled.precision}", record)


def _draw(seeds: Seeds, noise: Array, first: int, last: int) -> None:
    """Fill the ``noise`` (E, horizon, n_noise) of some trials."""
    draw_for_steps(seeds[first:last], *noise.shape[1:], out=noise[first:last])
