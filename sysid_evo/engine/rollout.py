"""Rollouts of many candidates in many trials on a dynamics, and the runners that make them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal, Protocol, get_args, runtime_checkable

import numpy as np

from sysid_evo.controllers.controller import Controller
from sysid_evo.engine import reference
from sysid_evo.engine.compiled.closed_loop import LoopData, LoopTrials, run_in_threads
from sysid_evo.engine.results import Rollouts, finished
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import Precision
from sysid_evo.models.adapters import adapter_of
from sysid_evo.models.dynamics import Dynamics, enough, started
from sysid_evo.processors import Engine, available_processors, resolve
from sysid_evo.progress import Progress
from sysid_evo.randomness import draw_for_steps, draw_for_trials
from sysid_evo.registry.objects import class_name
from sysid_evo.tasks.task import Task
from sysid_evo.types import Array, Seeds, check_shape


class BoundRunner(Protocol):
    """A controller and a task bound to a model or robot: bound once, run often."""

    def __call__(self, parameters: Array, seeds: Seeds, *, record: bool = False) -> Rollouts:
        """Return the rollouts of all candidates (P, n_parameters) in the same trials, one for each seed (E,).

        The fitness (P, E) is never nan. With ``record`` the result holds trajectories. Only a robot may skip trials;
        ``missing`` lists the reasons.
        """
        ...


class Runner(Protocol):
    """A model or robot that runs controllers: a column of the transfer matrix, a member of an ensemble.

    `DynamicsRunner` runs a model or an emulated robot, all trials at once. A physical robot runs one trial at a time.
    Any other object with this method can be used in evolution and comparison.
    """

    def bind(self, controller: Controller, task: Task) -> BoundRunner:
        """Return the bound runner of ``controller`` and ``task``. Raises `IncompatibleTask` before any trial."""
        ...


@runtime_checkable
class SteppedRunner(Runner, Protocol):
    """A runner that takes its time for every step, and reports them."""

    def reporting(self, progress: Progress) -> Runner:
        """Return this runner, which calls ``progress`` with the steps done of a trial."""
        ...


@dataclass(frozen=True)
class DynamicsRunner:
    """Runner of a `Dynamics`: a model or an emulated robot; ``engine`` and ``threads`` as in `rollout`."""

    dynamics: Dynamics
    engine: Engine = "auto"
    threads: int | None = None

    def bind(self, controller: Controller, task: Task) -> BoundRollout:
        """Return the bound rollout of ``controller`` and ``task`` in the dynamics, see `rollout`."""
        return BoundRollout(self.dynamics, controller, task, engine=self.engine, threads=self.threads)


def as_runners(given: Mapping[str, Runner | Dynamics], what: str) -> dict[str, Runner]:
    """Return runners by name; a model or emulated robot gets a `DynamicsRunner`. Raises `InvalidArgument`."""
    if not isinstance(given, Mapping):
        raise InvalidArgument(
            f"{what}: expected models or runners by name, {{name: model}}, got {type(given).__name__}"
        )
    found = {name: DynamicsRunner(one) if isinstance(one, Dynamics) else one for name, one in given.items()}
    for name, runner in found.items():
        if not hasattr(runner, "bind"):
            hint = f"; fit it first: as_model({class_name(runner)}(...)).fit(dataset)" if adapter_of(runner) else ""
            raise InvalidArgument(f"{what}: expected a model or a runner as {name!r}, got {class_name(runner)}{hint}")
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
    """Return the rollouts of all candidates ``parameters`` (P, n_parameters) in a trial of each seed (E,).

    All candidates have the same trials: waypoints, noise and draws depend on the trial's seed alone.

    - ``engine``: "float32" or "float64" (dynamics, controller and task compiled) or "reference" (NumPy, any object).
      "auto" is compiled if all three have kernels, in the precision of the dynamics' kernel, or in float64 if a state
      is far from zero compared with its changes (`far_from_zero`); otherwise, or with `SYSID_EVO_ENGINE=reference` in
      the environment, it is the reference. `Rollouts.engine` names the form that ran.
    - ``threads``: default all processors of this process. Scores do not depend on it.

    Raises `IncompatibleTask`, `ShapeError`, `InvalidArgument`.
    """
    return BoundRollout(dynamics, controller, task, engine=engine, threads=threads)(parameters, seeds, record=record)


class BoundRollout:
    """A controller and a task bound to a dynamics, with compiled kernels; arguments as in `rollout`.

    It holds the kernel that the dynamics has at this moment: bind again after a model is refitted.
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
            raise InvalidArgument(f"rollout: expected engine {', '.join(get_args(Engine))}, got {engine!r}")
        if threads is not None and threads < 1:
            raise InvalidArgument(f"rollout: expected at least one thread, got {threads}")
        self._threads = threads
        engine = resolve(engine)
        self.compiled = None if engine == "reference" else self._compiled(engine)

    def _compiled(self, engine: Literal["auto"] | Precision) -> LoopData | None:
        """Return the compiled form. Without kernels: None for "auto", else raises `InvalidArgument`."""
        dynamics, task, controller = self.dynamics, self.task, self.controller
        dynamics_kernel, task_kernel = dynamics.kernel(), task.kernel()
        controller_kernel = None if controller.n_noise else controller.kernel()
        if dynamics_kernel is None or controller_kernel is None or task_kernel is None:
            if engine == "auto":
                return None
            roles = {"dynamics": dynamics_kernel, "controller": controller_kernel, "task": task_kernel}
            missing = ", ".join(role for role, kernel in roles.items() if kernel is None)
            raise InvalidArgument(
                f"rollout: engine {engine!r} needs kernels, but there is none of the {missing}: use engine='auto'"
            )
        return LoopData(
            dynamics_kernel,
            controller_kernel,
            task_kernel,
            dynamics.system,
            n_memory=controller.n_memory,
            n_observations=len(task.observations),
            observed_at=dynamics.observed_at,
            outside_at=dynamics.outside_at,
            state_bounds=dynamics.state_bounds,
            precision=enough(dynamics_kernel.precision, dynamics.state_bounds) if engine == "auto" else engine,
        )

    @property
    def threads(self) -> int:
        """Number of threads of the next call: the processors that this process may use change while it runs."""
        return self._threads or available_processors()

    def __call__(self, parameters: Array, seeds: Seeds, *, record: bool = False) -> Rollouts:
        """Return the rollouts of all candidates (P, n_parameters) in a trial of each seed (E,), see `rollout`."""
        dynamics, task = self.dynamics, self.task
        parameters = check_shape("parameters", parameters, (None, self.controller.n_parameters))
        if len(seeds) < 1:
            raise InvalidArgument("rollout: expected at least one trial seed, got none")
        if self.compiled is None:
            return reference.run(dynamics, self.controller, parameters, task, seeds, record=record)
        trials, start, task_kernel = len(seeds), task.begin(seeds), self.compiled.task
        noise = np.empty((trials, task.horizon, dynamics.n_noise))
        run_in_threads(lambda: partial(_draw, seeds, noise), trials, self.threads)
        carry = started(dynamics, start.state, draw_for_trials(seeds, dynamics.n_draws))
        loop_trials = LoopTrials(
            theta=parameters,
            carry=check_shape("start", carry, (trials, dynamics.n_carry)),
            task=task_kernel.rows(start),
            trial_data=task_kernel.trial_data(start),
            noise=noise,
        )
        found, rows = self.compiled.run(loop_trials, record=record, threads=self.threads)
        task_state = task_kernel.state(start.tile(len(parameters)), rows)
        return finished(found, task, dynamics.system, start, task_state, f"compiled {self.compiled.precision}", record)


def _draw(seeds: Seeds, noise: Array, first: int, last: int) -> None:
    """Draw the ``noise`` (E, horizon, n_noise) of the trials ``first`` to ``last``."""
    draw_for_steps(seeds[first:last], *noise.shape[1:], out=noise[first:last])
