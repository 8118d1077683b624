"""The contract of a task, sentence by sentence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import Rollouts, rollout
from sysid_evo.errors import ContractViolation, IncompatibleTask
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_task
from sysid_evo.system import Channel, System
from sysid_evo.tasks.task import Task, TaskState
from sysid_evo.testing.arrays import expect_numbers, same, twice
from sysid_evo.testing.closed_loop import expect_engines_agree
from sysid_evo.testing.examples import ExampleDynamics, bare_system, example_systems
from sysid_evo.testing.verdicts import Check, CheckResult, DoesNotApply, expect, raise_broken, verdicts

CANDIDATES, TRIALS = 6, 4
SEEDS = trial_seeds(3, TRIALS)


@dataclass(frozen=True)
class Given:
    """A task as it is made, and the same bound to a system that has its roles."""

    made: Task
    task: Task

    @property
    def system(self) -> System:
        """The system of the bound task."""
        return self.task.system

    def moment(self) -> tuple[TaskState, Array, Array, Array]:
        """Return trials that have gone on for some steps, the states (B, nx) before and after the next, its control."""
        dynamics, rng = ExampleDynamics(self.system), np.random.default_rng(7)
        task_state = self.task.begin(SEEDS)
        before = task_state.state.copy()
        controls = self.system.actuate(rng.uniform(-1.0, 1.0, (4, TRIALS, self.system.nu)))
        for control in controls[:3]:
            task_state, reached = self.advance(task_state, before, dynamics.step(before, control), control)
            before = np.array(reached, dtype=np.float64)
        return task_state, before, dynamics.step(before, controls[3]), controls[3]

    def advance(self, task_state: TaskState, before: Array, after: Array, control: Array) -> tuple[TaskState, Array]:
        """Advance the task, the control as the last argument."""
        return self.task.advance(task_state, before, after, control=control)

    def drive(self, parameters: Array, seeds: Any = SEEDS) -> Rollouts:
        """Return rollouts of networks with these parameters in the reference form."""
        return rollout(
            ExampleDynamics(self.system), RecurrentNetwork(hidden=3), parameters, self.task, seeds, engine="reference"
        )

    @property
    def networks(self) -> Array:
        """Parameters (P, n) of random networks, small enough that none is chaotic: rounding stays rounding."""
        bound = RecurrentNetwork(hidden=3).bind_to(self.task)
        return 0.5 * np.random.default_rng(8).standard_normal((CANDIDATES, bound.n_parameters))


def check_task(name: str, system: System | None = None, **parameters: Any) -> None:
    """Raise `ContractViolation` listing every sentence that the registered task ``name`` breaks.

    ``system`` is one that has the roles of the task; without it, the first of `example_systems` that has.
    """
    raise_broken("task", name, run_task_checks(name, system, **parameters))


def run_task_checks(name: str, system: System | None = None, **parameters: Any) -> Iterator[CheckResult]:
    """Yield the result of every check of the registered task ``name``, see `check_task`."""

    def make() -> Given:
        made = make_task(name, **parameters)
        return Given(made, _bound(made, example_systems() if system is None else (system,)))

    return verdicts(make, CHECKS)


def binding_leaves_the_task_as_it_is(given: Given) -> None:
    """bind gives a task on that system and leaves the task itself as it is"""
    before = dict(vars(given.made))
    bound = given.made.bind(given.system)
    expect(bound is not given.made and vars(given.made) == before, "bind changes the task itself")
    expect(bound.system == given.system, "the bound task has another system")


def a_missing_role_is_named(given: Given) -> None:
    """bind refuses a system that lacks a role with IncompatibleTask, and names the role"""
    try:
        given.made.bind(bare_system())
    except IncompatibleTask as error:
        motion = given.system.motion
        roles = [*given.system.state_names, *given.system.control_names, *(motion.roles() if motion else ())]
        expect(any(role in str(error) for role in roles), f"expected one of {', '.join(roles)} in: {error}")


def it_says_what_it_is(given: Given) -> None:
    """It has a horizon of at least one step, and every observation a name of its own"""
    task = given.task
    expect(isinstance(task.horizon, int) and task.horizon >= 1, f"expected horizon >= 1 steps, got {task.horizon!r}")
    expect(
        task.observations and all(isinstance(channel, Channel) for channel in task.observations),
        f"expected observations to be channels, got {task.observations!r}",
    )
    names = [channel.name for channel in task.observations]
    expect(len(set(names)) == len(names), f"two observations have one name: {', '.join(names)}")


def a_trial_begins_within_the_system(given: Given) -> None:
    """begin gives one living trial for each seed, with a state (E, nx) and a pose (E, n_pose)"""
    began = given.task.begin(SEEDS)
    expect_numbers("state", began.state, (TRIALS, given.system.nx))
    expect_numbers("pose", began.pose, (TRIALS, given.system.n_pose))
    alive = np.asarray(began.alive)
    expect(alive.shape == (TRIALS,) and alive.dtype == bool and alive.all(), f"alive is {alive} after begin")


def a_trial_depends_on_its_seed_alone(given: Given) -> None:
    """A trial depends on its seed alone: not on the other trials, and not on chance"""
    expect(same(given.task.begin(SEEDS), given.task.begin(SEEDS)), "the same seeds begin other trials")
    together = given.drive(given.networks).fitness
    alone = np.concatenate([given.drive(given.networks, SEEDS[e : e + 1]).fitness for e in range(TRIALS)], axis=1)
    expect(np.allclose(together, alone, rtol=1e-9), "a trial ends otherwise when it is run alone")


def candidates_meet_the_same_trials(given: Given) -> None:
    """All candidates meet the same trials"""
    alike = np.repeat(given.networks[:1], 3, axis=0)
    found = given.drive(alike).fitness
    expect(np.allclose(found, found[0], rtol=1e-9), "the same controller scores otherwise as another candidate")


def an_observation_has_the_right_shape_and_type(given: Given) -> None:
    """observe gives one finite float64 number for each observation of each trial"""
    task_state, before, *_ = given.moment()
    expect_numbers("observation", given.task.observe(task_state, before), (TRIALS, len(given.task.observations)))


def observing_is_pure(given: Given) -> None:
    """observe changes neither its arguments nor its own later results"""
    task_state, before, *_ = given.moment()
    twice("observation", given.task.observe, task_state, before)


def advancing_is_pure(given: Given) -> None:
    """advance changes neither its arguments nor its own later results"""
    twice("advance", given.advance, *given.moment())


def advancing_keeps_shapes(given: Given) -> None:
    """advance gives trials and a state (B, nx) of the same shapes, finite and in float64"""
    task_state, *step = given.moment()
    advanced, reached = given.advance(task_state, *step)
    expect(type(advanced) is type(task_state), f"the trials become a {type(advanced).__name__}")
    expect_numbers("state", reached, (TRIALS, given.system.nx))
    expect_numbers("pose", advanced.pose, (TRIALS, given.system.n_pose))
    expect(np.shape(advanced.alive) == (TRIALS,), f"alive has the shape {np.shape(advanced.alive)}")


def a_tracked_pose_is_believed(given: Given) -> None:
    """advance takes the pose that a tracker saw, if it is given one"""
    if given.system.n_pose == 0:
        raise DoesNotApply
    task_state, before, after, control = given.moment()
    seen = np.random.default_rng(6).uniform(-0.5, 0.5, task_state.pose.shape)
    advanced, _ = given.task.advance(task_state, before, after, control=control, pose=seen)
    expect(same(advanced.pose, seen), "the pose after the step is another one")


def fitness_is_a_number_and_never_below_the_worst(given: Given) -> None:
    """fitness is one number for each trial, never nan and never below worst"""
    task_state, *_ = given.moment()
    expect_numbers("fitness", given.task.fitness(task_state), (TRIALS,))
    driven = given.drive(given.networks).fitness
    expect(not np.isnan(driven).any(), "the fitness of a random controller is nan")
    lowest = min(driven.min(), given.task.fitness(task_state).min())
    expect(lowest >= given.task.worst, f"a fitness of {lowest:g} is below worst, which is {given.task.worst:g}")


def a_trial_that_is_over_keeps_its_fitness(given: Given) -> None:
    """A trial that is over can be held while others go on"""
    task_state, *step = given.moment()
    going = np.arange(TRIALS) % 2 == 0
    advanced, _ = given.advance(task_state, *step)
    kept = given.task.fitness(task_state.keep(advanced, going))
    expected = np.where(going, given.task.fitness(advanced), given.task.fitness(task_state))
    expect(same(kept, expected), "the fitness of a trial that is held changes with the others")


def a_scene_can_be_drawn(given: Given) -> None:
    """scene gives what can be drawn of a trial: places (k, 2) in m, those reached among them"""
    task_state, *_ = given.moment()
    for trial in range(TRIALS):
        scene = given.task.scene(task_state, trial)
        expect_numbers("markers", scene.markers, (len(scene.markers), 2))
        expect(0 <= scene.reached <= len(scene.markers), f"{scene.reached} of {len(scene.markers)} are reached")
        expect(scene.radius >= 0.0, f"a radius is {scene.radius} m")


def the_compiled_form_is_the_reference(given: Given) -> None:
    """The compiled form scores as the reference form does"""
    if given.task.kernel() is None:
        raise DoesNotApply
    expect_engines_agree(ExampleDynamics(given.system), RecurrentNetwork(hidden=3), given.networks, given.task, SEEDS)


CHECKS: tuple[Check[Given], ...] = (
    binding_leaves_the_task_as_it_is,
    a_missing_role_is_named,
    it_says_what_it_is,
    a_trial_begins_within_the_system,
    a_trial_depends_on_its_seed_alone,
    candidates_meet_the_same_trials,
    an_observation_has_the_right_shape_and_type,
    observing_is_pure,
    advancing_is_pure,
    advancing_keeps_shapes,
    a_tracked_pose_is_believed,
    fitness_is_a_number_and_never_below_the_worst,
    a_trial_that_is_over_keeps_its_fitness,
    a_scene_can_be_drawn,
    the_compiled_form_is_the_reference,
)


def _bound(task: Task, systems: tuple[System, ...]) -> Task:
    """Return ``task`` on the first system that it takes. Raises `ContractViolation`."""
    reasons = []
    for system in systems:
        try:
            return task.bind(system)
        except IncompatibleTask as error:
            reasons.append(f"{system.name or 'the system'}: {error}")
    raise ContractViolation(f"bind refuses every system; give one that has its roles. {'; '.join(reasons)}")
