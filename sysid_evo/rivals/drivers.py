"""Two controllers at once: one for each of two bodies."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Self

import numpy as np

from sysid_evo.arrays import Array, check_shape
from sysid_evo.controllers.controller import Controller, View
from sysid_evo.errors import IncompatibleTask
from sysid_evo.rivals.race import Race, RaceState
from sysid_evo.tasks.task import Task

if TYPE_CHECKING:
    from sysid_evo.engine.compiled.kernel import ControllerKernel


class TwoDrivers(Controller):
    """The controller ``own`` drives the first body, ``rival`` the second; parameters and memory stand in this order.

    Each is bound to a task of one body, by default to that of the race. What that task shows must be the first of
    what the race shows to a body: who was made for `WalledTrack` does not see the other.
    """

    def __init__(self, own: Controller, rival: Controller, *, tasks: tuple[Task | None, Task | None] = (None, None)):
        self.own, self.rival, self.tasks = own, rival, tasks

    def bind_to(self, task: Task) -> Self:
        if not isinstance(task, Race):
            raise IncompatibleTask(f"two drivers need a race, got {type(task).__name__}")
        bound, laws, seen = copy.copy(self), [], []
        for law, other in zip((self.own, self.rival), self.tasks, strict=True):
            own = task.alone if other is None else other.bind(task.alone.system)
            if own.observations != task.alone.observations[: len(own.observations)]:
                raise IncompatibleTask(f"a controller for {type(own).__name__} cannot drive in this race")
            laws.append(law.bind_to(own))
            seen.append(len(own.observations))
        if any(law.n_noise for law in laws):
            raise IncompatibleTask("two drivers: expected controllers without noise")
        bound.laws, bound.seen, bound.task = tuple(laws), tuple(seen), task
        bound.n_parameters, bound.n_memory = (sum(getattr(law, name) for law in laws) for name in SIZES)
        return bound

    laws: tuple[Controller, ...]
    seen: tuple[int, ...]
    task: Race

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        check_shape("parameters", parameters, (None, self.n_parameters))
        first, state = self.laws[0], view.task_state
        assert isinstance(state, RaceState)
        thetas = np.split(parameters, [first.n_parameters], axis=1)
        memories = np.split(memory, [first.n_memory], axis=2)
        shown, states = np.split(view.observation, 2, axis=2), np.split(view.state, 2, axis=2)
        acted = [
            law.act(theta, memory, View(observed[..., :seen], x, one))
            for law, theta, memory, observed, seen, x, one in zip(
                self.laws, thetas, memories, shown, self.seen, states, (state.own, state.rival), strict=True
            )
        ]
        return np.concatenate([raw for raw, _ in acted], axis=2), np.concatenate([after for _, after in acted], axis=2)

    def kernel(self) -> ControllerKernel | None:
        kernels = [law.kernel() for law in self.laws]
        first, second = kernels
        if first is None or second is None:
            return None
        from sysid_evo.engine.kernels.race import drivers_kernel

        return drivers_kernel(first, second, self.laws[0], len(self.task.alone.observations), self.task.alone.system.nu)


SIZES = ("n_parameters", "n_memory")
