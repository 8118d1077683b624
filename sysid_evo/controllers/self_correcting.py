"""A predictive controller whose model goes on learning while it drives."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.controllers.controller import Controller, View
from sysid_evo.controllers.inner_models import inner_model
from sysid_evo.controllers.predictive import Predictive
from sysid_evo.dynamics import Dynamics
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import register_controller
from sysid_evo.tasks.task import Task

if TYPE_CHECKING:
    from sysid_evo.adaptation import Corrected, SelfCorrection


@register_controller("self_correcting")
class SelfCorrecting(Controller):
    """`predictive` with a model that corrects itself from what it did not foresee, sample by sample.

    Every trial begins with ``model`` as it is. What it lacks in this trial is learned by recursive least squares over
    its free runs of ``learned_steps`` (`SelfCorrection`) and added to what it imagines, as long as a gate finds that
    it foresaw better with what it had learned before. ``model`` is the file of a fitted model or a fitted model;
    the other parameters are those of `predictive`, and so are the two that are evolved.

    A decision costs what one of `predictive` costs, and learning no more than a few milliseconds, however long it
    drives (``python -m tests.benchmarks.shift`` measures both).
    """

    hand_written: ClassVar[bool] = True
    unwritten: ClassVar[str] = Predictive.unwritten
    n_parameters = 2

    def __init__(
        self,
        *,
        model: str | Dynamics,
        horizon: int = 30,
        samples: int = 64,
        temperature: float = 0.1,
        spread: float = 0.8,
        hold: int = 8,
        seed: int = 0,
        learned_steps: int = 20,
    ) -> None:
        if learned_steps < 1:
            raise InvalidArgument(f"self_correcting: expected learned_steps >= 1, got {learned_steps}")
        self.model, self.learned_steps = model, learned_steps
        self.horizon, self.samples, self.temperature = horizon, samples, temperature
        self.spread, self.hold, self.seed = spread, hold, seed

    def bind_to(self, task: Task) -> Self:
        from sysid_evo.adaptation import Corrected, SelfCorrection

        model = inner_model("self_correcting", self.model, task)
        bound = copy.copy(self)
        bound.learning = SelfCorrection.of(model, horizon=self.learned_steps)
        bound.corrected = Corrected(model, bound.learning.terms)
        bound.planning = Predictive(
            model=bound.corrected,
            horizon=self.horizon,
            samples=self.samples,
            temperature=self.temperature,
            spread=self.spread,
            hold=self.hold,
            seed=self.seed,
        ).bind_to(task)
        bound.task, bound.n_learned = task, bound.learning.n_memory
        bound.n_memory = bound.n_learned + task.system.nu + bound.planning.n_memory
        return bound

    task: Task
    learning: SelfCorrection
    corrected: Corrected
    planning: Predictive
    n_learned: int

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        system, cut = self.task.system, self.n_learned + self.task.system.nu
        flat = memory.reshape(-1, self.n_memory)
        state = view.state.reshape(-1, system.nx)
        begun = flat[:, self.learning.places["count"]] > 0.0
        control = np.where(begun, flat[:, self.n_learned : cut], system.neutral_control)
        learned = self.learning.observed(flat[:, : self.n_learned], state, control)
        coefficients = self.learning.coefficients(learned)
        raw, plan = self.planning.planned(
            parameters, memory[..., cut:], view, lambda carry: self.corrected.told(carry, coefficients)
        )
        given = system.actuate(raw).reshape(len(flat), -1)
        after = np.concatenate([learned, given, plan.reshape(len(flat), -1)], axis=1)
        return raw, after.reshape(memory.shape)
