"""The contract of a controller, sentence by sentence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.controllers.controller import Controller, View
from sysid_evo.errors import ContractViolation, IncompatibleTask
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_controller
from sysid_evo.system import Channel
from sysid_evo.tasks import PointToPoint, Task
from sysid_evo.testing.arrays import expect_numbers, same, twice
from sysid_evo.testing.closed_loop import expect_engines_agree
from sysid_evo.testing.examples import ExampleDynamics, continuous_car
from sysid_evo.testing.verdicts import Check, CheckResult, DoesNotApply, expect, raise_broken, verdicts

CANDIDATES, TRIALS = 3, 4


@dataclass(frozen=True)
class Given:
    """A controller as it is made, the same bound to ``task``, and parameters (P, n_parameters) for it."""

    made: Controller
    bound: Controller
    parameters: Array
    task: Task

    def view(self, moment: int, candidates: slice = slice(None), trials: slice = slice(None)) -> View:
        """Return what some candidates see in some trials at a ``moment``, an arbitrary number."""
        system = self.task.system
        p, e = len(range(CANDIDATES)[candidates]), len(range(TRIALS)[trials])
        rng = np.random.default_rng(moment)
        state = rng.standard_normal((CANDIDATES, TRIALS, system.nx))[candidates, trials]
        task_state = self.task.begin(trial_seeds(moment, TRIALS)[trials]).tile(p)
        observation = self.task.observe(task_state, state.reshape(p * e, system.nx))
        noise = None
        if self.bound.n_noise:
            of_trials = rng.standard_normal((TRIALS, self.bound.n_noise))[trials]
            noise = np.broadcast_to(of_trials, (p, e, self.bound.n_noise)).copy()
        return View(observation.reshape(p, e, -1), state, task_state, noise)

    def memory(self, moment: int) -> Array:
        """Return some memory (P, E, n_memory): zeros at moment 0, else what an action has left."""
        memory = np.zeros((CANDIDATES, TRIALS, self.bound.n_memory))
        for earlier in range(moment):
            _, memory = self.bound.act(self.parameters, memory, self.view(earlier))
        return memory


def check_controller(name: str, *, at: Task | None = None, **parameters: Any) -> None:
    """Raise `ContractViolation` listing every sentence that the registered controller ``name`` breaks.

    ``at`` is the task that it is tried at, see `run_controller_checks`.
    """
    raise_broken("controller", name, run_controller_checks(name, at=at, **parameters))


def run_controller_checks(name: str, *, at: Task | None = None, **parameters: Any) -> Iterator[CheckResult]:
    """Yield the result of every check of the registered controller ``name``.

    It is tried ``at`` a task that is bound, by default `PointToPoint` on a made-up car.
    """

    def make() -> Given:
        task = PointToPoint(horizon=60).bind(continuous_car()) if at is None else at
        made = make_controller(name, **parameters)
        bound = made.bind_to(task)
        weights = np.random.default_rng(4).standard_normal((CANDIDATES, bound.n_parameters))
        return Given(made, bound, weights, task)

    return verdicts(make, CHECKS)


def binding_gives_a_controller_of_that_size(given: Given) -> None:
    """bind gives a controller of that many inputs and outputs, and leaves the others as they are"""
    before = dict(vars(given.bound))
    system = given.task.system
    wider = replace(system, controls=(*system.controls, Channel("spare_control", low=-1.0, high=1.0)))
    try:
        other = given.made.bind_to(given.task.bind(wider))
    except IncompatibleTask as error:  # it was made for this one system
        raise DoesNotApply from error
    raw, _ = other.act(
        np.zeros((1, other.n_parameters)), np.zeros((1, 1, other.n_memory)), given.view(1, slice(1), slice(1))
    )
    expect(raw.shape == (1, 1, 3), f"bound to three outputs it gives {raw.shape[-1:]}")
    expect(vars(given.bound) == before, "a controller changes when another is bound")


def it_has_parameters_to_evolve(given: Given) -> None:
    """It has at least one parameter, and parameters decide what it does"""
    count = given.bound.n_parameters
    expect(isinstance(count, int) and count >= 1, f"expected n_parameters >= 1, got {count!r}")
    raw, _ = given.bound.act(given.parameters, given.memory(2), given.view(2))
    alike = np.repeat(given.parameters[:1], CANDIDATES, axis=0)
    other, _ = given.bound.act(alike, given.memory(2), given.view(2))
    expect(not same(raw, other), "all parameter vectors act alike")


def an_action_has_the_right_shape_and_type(given: Given) -> None:
    """act gives outputs (P, E, n_outputs) and memory (P, E, n_memory), finite and in float64"""
    for moment in (0, 3):
        raw, memory = given.bound.act(given.parameters, given.memory(moment), given.view(moment))
        expect_numbers("outputs", raw, (CANDIDATES, TRIALS, given.task.system.nu))
        expect_numbers("memory", memory, (CANDIDATES, TRIALS, given.bound.n_memory))


def outputs_stay_within_their_limits(given: Given) -> None:
    """Outputs stay within [-1, 1], whatever the parameters"""
    raw, _ = given.bound.act(30.0 * given.parameters, given.memory(2), given.view(2))
    expect(np.abs(raw).max() <= 1.0, f"an output is {raw.ravel()[np.abs(raw).argmax()]:.3g}")


def an_action_is_pure(given: Given) -> None:
    """act changes neither its arguments nor its own later results: what it remembers stands in its memory"""
    view, memory = given.view(2), given.memory(2)
    first = twice("action", given.bound.act, given.parameters, memory, view)
    for moment in range(3):
        given.bound.act(given.parameters, given.memory(moment), given.view(moment))
    again = given.bound.act(given.parameters, memory, view)
    expect(same(first, again), "what it did in between changes what it does")


def candidates_and_trials_are_independent(given: Given) -> None:
    """Every candidate acts for itself in every trial"""
    memory = given.memory(2)
    together = given.bound.act(given.parameters, memory.copy(), given.view(2))
    for p in range(CANDIDATES):
        for e in range(TRIALS):
            one, trial = slice(p, p + 1), slice(e, e + 1)
            alone = given.bound.act(given.parameters[one], memory[one, trial], given.view(2, one, trial))
            for found, expected in zip(alone, together, strict=True):
                if not np.allclose(found, expected[one, trial], rtol=1e-9, atol=1e-12):
                    raise ContractViolation(f"candidate {p} in trial {e} acts otherwise when it is alone")


def the_compiled_form_acts_as_act_does(given: Given) -> None:
    """The compiled form acts as act does"""
    if given.bound.kernel() is None:
        raise DoesNotApply
    expect_engines_agree(ExampleDynamics(given.task.system), given.made, given.parameters, given.task)


def the_form_for_other_languages_acts_as_act_does(given: Given) -> None:
    """The form for other languages acts as act does"""
    for p in range(CANDIDATES):
        program = given.bound.program(given.parameters[p])
        if program is None:
            raise DoesNotApply
        remembered, memory = program.begin(), given.memory(0)
        for moment in range(4):
            view = given.view(moment)
            raw, memory = given.bound.act(given.parameters, memory, view)
            found, remembered = program.run(view.observation[p, 0], remembered)
            expect(
                np.allclose(found, raw[p, 0], rtol=1e-9, atol=1e-12),
                f"outputs are {found} in sample {moment}, those of act {raw[p, 0]}",
            )


CHECKS: tuple[Check[Given], ...] = (
    binding_gives_a_controller_of_that_size,
    it_has_parameters_to_evolve,
    an_action_has_the_right_shape_and_type,
    outputs_stay_within_their_limits,
    an_action_is_pure,
    candidates_and_trials_are_independent,
    the_compiled_form_acts_as_act_does,
    the_form_for_other_languages_acts_as_act_does,
)
