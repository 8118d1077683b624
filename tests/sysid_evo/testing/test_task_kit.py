"""The contract of tasks: all that are listed keep it, each broken one is caught with its sentence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self, cast

import numpy as np
import pytest

from sysid_evo.errors import ContractViolation, IncompatibleTask
from sysid_evo.kernels import TaskKernel
from sysid_evo.randomness import TASK_STREAM, generator
from sysid_evo.registry import tasks
from sysid_evo.system import Channel, System
from sysid_evo.tasks import PointToPoint, Task, TaskState
from sysid_evo.tasks.task import Scene
from sysid_evo.testing import check_task, example_systems, run_task_checks
from sysid_evo.testing import closed_loop as kit
from sysid_evo.types import Array, BoolArray, IntArray, Seeds
from tests.broken import broken, sentence


@dataclass(frozen=True)
class UprightState(TaskState):
    """``score`` (B,) so far, ``trial`` (B,)."""

    score: Array
    trial: IntArray


class Upright(Task):
    """A sound one: hold an angle up, from one that the trial draws."""

    observations = (Channel("sine"), Channel("cosine"), Channel("angular_speed", "rad/s"))

    def __init__(self, *, horizon: int = 30) -> None:
        self.horizon = horizon

    def check_system(self, system: System) -> None:
        missing = {"angle", "angular_speed"} - set(system.state_names)
        if missing:
            raise IncompatibleTask(f"upright needs the states angle and angular_speed, not here: {sorted(missing)}")

    def begin(self, seeds: Seeds) -> TaskState:
        state = np.array([[generator(seed, TASK_STREAM).uniform(-1.0, 1.0), 0.0] for seed in seeds])
        count = len(seeds)
        return UprightState(state, np.zeros((count, 0)), np.ones(count, dtype=bool), np.zeros(count), np.arange(count))

    def observe(self, task_state: TaskState, state: Array) -> Array:
        return np.stack([np.sin(state[:, 0]), np.cos(state[:, 0]), state[:, 1]], axis=1)

    def advance(
        self, task_state: TaskState, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        here = cast("UprightState", task_state)
        return replace(here, score=here.score + (1.0 + np.cos(after[:, 0])) / 2.0), after

    def fitness(self, task_state: TaskState) -> Array:
        return cast("UprightState", task_state).score


class BindingItself(Upright):
    def bind(self, system: System) -> Self:
        self.check_system(system)
        self.system = system
        return self


class Nameless(Upright):
    def check_system(self, system: System) -> None:
        try:
            super().check_system(system)
        except IncompatibleTask:
            raise IncompatibleTask("this will not do") from None


class TwoOfAName(Upright):
    observations = (Channel("sine"), Channel("sine"), Channel("angular_speed", "rad/s"))


class Horizonless(Upright):
    def __init__(self) -> None:
        super().__init__(horizon=cast("int", 30.0))


class AliveInNumbers(Upright):
    def begin(self, seeds: Seeds) -> TaskState:
        return replace(super().begin(seeds), alive=np.ones(len(seeds), dtype=np.int64))  # type: ignore[arg-type]


class Sociable(Upright):
    """A trial's start depends on the first seed of its batch."""

    def begin(self, seeds: Seeds) -> TaskState:
        began = super().begin(seeds)
        return replace(began, state=began.state + 0.1 * began.state[:1])


class Partial(Upright):
    """The second candidate is seen otherwise than the first."""

    def observe(self, task_state: TaskState, state: Array) -> Array:
        trials = cast("UprightState", task_state).trial.max() + 1
        return super().observe(task_state, state) + 0.5 * (np.arange(len(state)) // trials)[:, None]


class SingleObservation(Upright):
    def observe(self, task_state: TaskState, state: Array) -> Array:
        return super().observe(task_state, state).astype(np.float32)


class Scribbling(Upright):
    def observe(self, task_state: TaskState, state: Array) -> Array:
        observation = super().observe(task_state, state)
        state[:, 0] += 1e-3
        return observation


class ScoringInPlace(Upright):
    def advance(
        self, task_state: TaskState, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        here = cast("UprightState", task_state)
        here.score[:] += (1.0 + np.cos(after[:, 0])) / 2.0
        return here, after


class SingleState(Upright):
    def advance(
        self, task_state: TaskState, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        advanced, after = super().advance(task_state, before, after, control=control, pose=pose)
        return advanced, after.astype(np.float32)


class Blind(PointToPoint):
    def advance(
        self, task_state: TaskState, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        return super().advance(task_state, before, after, control=control)


class BelowWorst(Upright):
    def fitness(self, task_state: TaskState) -> Array:
        return super().fitness(task_state) - 100.0


@dataclass(frozen=True)
class RestlessState(UprightState):
    """Goes on although its trial is over."""

    def keep(self, advanced: Self, going: BoolArray) -> Self:
        return advanced


class Restless(Upright):
    def begin(self, seeds: Seeds) -> TaskState:
        return RestlessState(**vars(super().begin(seeds)))


class Overreaching(Upright):
    def scene(self, task_state: TaskState, trial: int) -> Scene:
        return Scene(np.zeros((1, 2)), reached=2)


class OtherKernel(PointToPoint):
    def kernel(self) -> TaskKernel:
        other = PointToPoint(waypoint_radius=4.0 * self.waypoint_radius).bind(self.system)
        return replace(other.kernel(), trial_data=super().kernel().trial_data, parameters=self._parameters(other))

    def _parameters(self, other: PointToPoint) -> Array:
        mine, wide = super().kernel().parameters, other.kernel().parameters
        return np.where(np.isclose(mine, self.waypoint_radius**2), wide, mine)


BROKEN: list[tuple[type[Task], Callable[..., None], str]] = [
    (BindingItself, kit.binding_leaves_the_task_as_it_is, "bind changes the task itself"),
    (Nameless, kit.a_missing_role_is_named, "expected one of angle, angular_speed, torque in: this will not do"),
    (TwoOfAName, kit.it_says_what_it_is, "two observations have one name: sine, sine, angular_speed"),
    (AliveInNumbers, kit.a_trial_begins_within_the_system, r"alive is \[1 1 1 1\] after begin"),
    (Sociable, kit.a_trial_depends_on_its_seed_alone, "a trial ends otherwise when it is run alone"),
    (Partial, kit.candidates_meet_the_same_trials, "scores otherwise as another candidate"),
    (SingleObservation, kit.an_observation_has_the_right_shape_and_type, r"\(4, 3\) float64, got \(4, 3\) float32"),
    (Scribbling, kit.observing_is_pure, "observation overwrites its arguments"),
    (ScoringInPlace, kit.advancing_is_pure, "advance overwrites its arguments"),
    (SingleState, kit.advancing_keeps_shapes, r"state: expected \(4, 2\) float64, got \(4, 2\) float32"),
    (Blind, kit.a_tracked_pose_is_believed, "the pose after the step is another one"),
    (BelowWorst, kit.fitness_is_a_number_and_never_below_the_worst, "is below worst, which is 0"),
    (Restless, kit.a_trial_that_is_over_keeps_its_fitness, "a trial that is held changes with the others"),
    (Overreaching, kit.a_scene_can_be_drawn, "2 of 1 are reached"),
    (OtherKernel, kit.the_compiled_form_is_the_reference, r"fitness is \[.*\] compiled and \[.*\] in NumPy"),
]


@pytest.mark.parametrize("name", tasks.names())
def test_every_task_keeps_every_sentence(name: str) -> None:
    check_task(name)


@pytest.mark.parametrize("system", example_systems()[:2], ids=lambda system: system.controls[0].levels and "switched")
def test_the_shipped_task_keeps_every_sentence_under_switches_and_continuous_controls(system: System) -> None:
    results = list(run_task_checks("point_to_point", system, waypoint_radius=0.5, horizon=80))
    assert broken(results) == {}
    assert len(results) == 1 + len(kit.TASK_CHECKS)


def test_a_task_that_is_not_for_cars_finds_a_system_and_keeps_every_sentence(register: Callable[..., Any]) -> None:
    register(tasks, "upright", Upright)
    results = list(run_task_checks("upright"))
    assert broken(results) == {}
    assert [result.sentence for result in results if result.idle] == [sentence(kit.the_compiled_form_is_the_reference)]
    assert len(results) == len(kit.TASK_CHECKS), "one that it is made, none of a tracked pose"
    assert sentence(kit.a_tracked_pose_is_believed) not in {result.sentence for result in results}


@pytest.mark.parametrize(("made", "check", "reason"), BROKEN)
def test_a_broken_task_is_caught_with_the_one_sentence_it_breaks(
    made: type[Task], check: Callable[..., None], reason: str, register: Callable[..., Any]
) -> None:
    register(tasks, "broken", made)
    found = broken(run_task_checks("broken"))
    assert list(found) == [sentence(check)]
    with pytest.raises(ContractViolation, match=f"task 'broken' breaks 1 of .*\n- .*{reason}"):
        check_task("broken")


def test_every_sentence_has_something_that_breaks_it() -> None:
    assert {check for _, check, _ in BROKEN} == set(kit.TASK_CHECKS)


def test_a_horizon_is_a_whole_number(register: Callable[..., Any]) -> None:
    register(tasks, "broken", Horizonless)
    assert (
        "expected horizon >= 1 steps, got 30.0" in broken(run_task_checks("broken"))[sentence(kit.it_says_what_it_is)]
    )


def test_a_task_that_no_system_fits_says_why(register: Callable[..., Any]) -> None:
    class Impossible(Upright):
        def check_system(self, system: System) -> None:
            raise IncompatibleTask(f"impossible needs wings, {system.name} has none")

    register(tasks, "broken", Impossible)
    (reason,) = broken(run_task_checks("broken")).values()
    assert "made-up pendulum: impossible needs wings, made-up pendulum has none" in reason
