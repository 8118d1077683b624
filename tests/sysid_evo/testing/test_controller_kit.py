"""The contract of controllers: all that are listed keep it, each broken one is caught with its sentence."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any, Self

import numpy as np
import pytest

from sysid_evo.controllers import Controller, RecurrentNetwork, View
from sysid_evo.errors import ContractViolation
from sysid_evo.registry import controllers
from sysid_evo.tasks import SetPoint
from sysid_evo.testing import check_controller, run_controller_checks
from sysid_evo.testing import closed_loop as kit
from sysid_evo.testing.examples import ExampleDynamics, continuous_car
from sysid_evo.types import Array
from tests.broken import broken, sentence


class Sluggish(Controller):
    """A sound one: weights on the observations, and on what it did before."""

    def bind(self, n_observations: int, n_outputs: int) -> Self:
        bound = copy.copy(self)
        bound.n_outputs = bound.n_memory = n_outputs
        bound.n_parameters = n_observations * n_outputs
        return bound

    n_outputs: int

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        weights = parameters.reshape(len(parameters), -1, self.n_outputs)
        raw = np.tanh(view.observation @ weights + 0.5 * memory)
        return raw, raw.copy()


class TwoOutputs(Sluggish):
    def bind(self, n_observations: int, n_outputs: int) -> Self:
        return super().bind(n_observations, 2)


class Indifferent(Sluggish):
    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        raw = np.tanh(view.observation[..., : self.n_outputs])
        return raw, raw.copy()


class SinglePrecision(Sluggish):
    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        raw, memory = super().act(parameters, memory, view)
        return raw.astype(np.float32), memory


class Unlimited(Sluggish):
    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        raw, memory = super().act(parameters, memory, view)
        return 1.1 * raw, memory


class Overwriting(Sluggish):
    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        raw, new = super().act(parameters, memory, view)
        memory[:] = new
        return raw, memory


class Remembering(Sluggish):
    """Remembers in itself whether it has ever been called before."""

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        self.calls = getattr(self, "calls", 0) + 1
        raw, memory = super().act(parameters, memory, view)
        return raw * (1.0 - 1e-11 * self.calls), memory


class Comparing(Sluggish):
    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        raw, memory = super().act(parameters, memory, view)
        return 0.9 * raw + 0.1 * raw.mean(axis=1, keepdims=True), memory


class OtherKernel(RecurrentNetwork):
    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        raw, memory = super().act(parameters, memory, view)
        return 0.999 * raw, memory

    def program(self, parameters: Array) -> Any:
        return None


class OtherProgram(RecurrentNetwork):
    def program(self, parameters: Array) -> Any:
        return super().program(0.999 * parameters)


BROKEN: list[tuple[type[Controller], Callable[..., None], str]] = [
    (TwoOutputs, kit.binding_gives_a_controller_of_that_size, r"bound to three outputs it gives \(2,\)"),
    (Indifferent, kit.it_has_parameters_to_evolve, "all parameter vectors act alike"),
    (SinglePrecision, kit.an_action_has_the_right_shape_and_type, r"outputs: expected \(3, 4, 2\) float64, got"),
    (Unlimited, kit.outputs_stay_within_their_limits, r"an output is -?1\.1"),
    (Overwriting, kit.an_action_is_pure, "action overwrites its arguments"),
    (Remembering, kit.an_action_is_pure, "the same action twice gives two results"),
    (Comparing, kit.candidates_and_trials_are_independent, "candidate 0 in trial 0 acts otherwise when it is alone"),
    (OtherKernel, kit.the_compiled_form_acts_as_act_does, "controls differ from sample 0"),
    (OtherProgram, kit.the_form_for_other_languages_acts_as_act_does, r"outputs are \[.*\] in sample 0, those of act"),
]


ARGUMENTS: dict[str, dict[str, Any]] = {
    "lqr": {"model": ExampleDynamics(continuous_car()), "at": SetPoint(horizon=60).bind(continuous_car())},
    "predictive": {"model": ExampleDynamics(continuous_car()), "horizon": 6, "samples": 24},
}
"""What a controller cannot do without."""


@pytest.mark.parametrize("name", controllers.names())
def test_every_controller_keeps_every_sentence(name: str) -> None:
    check_controller(name, **ARGUMENTS.get(name, {}))


def test_a_sound_controller_keeps_every_sentence_but_those_of_its_other_forms(register: Callable[..., Any]) -> None:
    register(controllers, "sluggish", Sluggish)
    results = list(run_controller_checks("sluggish"))
    assert broken(results) == {}
    compiled, elsewhere = kit.the_compiled_form_acts_as_act_does, kit.the_form_for_other_languages_acts_as_act_does
    assert [result.sentence for result in results if result.idle] == [sentence(compiled)]
    assert len(results) == len(kit.CONTROLLER_CHECKS), "one that it is made, none of the other languages"
    assert sentence(elsewhere) not in [result.sentence for result in results]


def test_a_controller_that_wants_noise_is_given_some(register: Callable[..., Any]) -> None:
    class Restless(Sluggish):
        n_noise = 2

        def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
            raw, memory = super().act(parameters, memory, view)
            assert view.noise is not None
            return np.clip(raw + 0.1 * view.noise[..., :1], -1.0, 1.0), memory

    register(controllers, "restless", Restless)
    assert broken(run_controller_checks("restless")) == {}


@pytest.mark.parametrize(("made", "check", "reason"), BROKEN)
def test_a_broken_controller_is_caught_with_the_one_sentence_it_breaks(
    made: type[Controller], check: Callable[..., None], reason: str, register: Callable[..., Any]
) -> None:
    register(controllers, "broken", made)
    found = broken(run_controller_checks("broken"))
    assert list(found) == [sentence(check)]
    with pytest.raises(ContractViolation, match=f"controller 'broken' breaks 1 of .*\n- .*{reason}"):
        check_controller("broken")


def test_every_sentence_has_something_that_breaks_it() -> None:
    assert {check for _, check, _ in BROKEN} == set(kit.CONTROLLER_CHECKS)
