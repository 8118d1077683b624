"""The contracts of a controller and of a task, tested in closed loop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid_evo.controllers.controller import Controller, View, make_controller
from sysid_evo.controllers.networks import RecurrentNetwork
from sysid_evo.engine.results import Rollouts
from sysid_evo.engine.rollout import rollout
from sysid_evo.errors import ContractViolation, IncompatibleTask
from sysid_evo.models.dynamics import Dynamics
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry.registry import controllers, tasks
from sysid_evo.system import Channel, System
from sysid_evo.tasks.point_to_point import PointToPoint
from sysid_evo.tasks.task import Task, TaskState, make_task
from sysid_evo.testing.contract import (
    Contract,
    NotApplicable,
    expect,
    expect_kernel,
    expect_numbers,
    expect_pure,
    same,
)
from sysid_evo.testing.examples import ExampleDynamics, bare_system, continuous_car, example_systems
from sysid_evo.types import Array, Seeds

CANDIDATES, NETWORKS, TRIALS = 3, 6, 4
"""Number of controllers in one call, of networks that run a task, and of trials."""

SEEDS = trial_seeds(3, TRIALS)

TOLERANCE = 1e-6
SPACE = 7
"""Number of coordinates of a pose in space."""


@dataclass(frozen=True)
class ControllerExample:
    """A controller, the same controller bound to ``task``, and its parameters (P, n_parameters)."""

    made: Controller
    bound: Controller
    parameters: Array
    task: Task

    def view(self, moment: int, candidates: slice = slice(None), trials: slice = slice(None)) -> View:
        """Return the view of some candidates in some trials; ``moment`` is the seed of its random state."""
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
        """Return the memory (P, E, n_memory) after ``moment`` actions; zeros at first."""
        memory = np.zeros((CANDIDATES, TRIALS, self.bound.n_memory))
        for earlier in range(moment):
            _, memory = self.bound.act(self.parameters, memory, self.view(earlier))
        return memory


def check_controller(name: str, *, at: Task | None = None, **parameters: Any) -> None:
    """Raise `ContractViolation` with all rules that the controller ``name`` breaks ``at`` a bound task."""
    CONTROLLER.check(name, at=at, **parameters)


def _controller(name: str, *, at: Task | None = None, **parameters: Any) -> tuple[ControllerExample]:
    task = PointToPoint(horizon=60).bind(continuous_car()) if at is None else at
    made = make_controller(name, **parameters)
    bound = made.bind_to(task)
    weights = np.random.default_rng(4).standard_normal((CANDIDATES, bound.n_parameters))
    return (ControllerExample(made, bound, weights, task),)


def binding_gives_a_controller_of_that_size(example: ControllerExample) -> None:
    """bind_to returns a controller with the inputs and outputs of the task and changes no other controller"""
    before = dict(vars(example.bound))
    system = example.task.system
    wider = replace(system, controls=(*system.controls, Channel("spare_control", low=-1.0, high=1.0)))
    try:
        other = example.made.bind_to(example.task.bind(wider))
    except IncompatibleTask as error:  # it accepts one system only
        raise NotApplicable from error
    view = replace(example, bound=other).view(1, slice(1), slice(1))
    raw, _ = other.act(np.zeros((1, other.n_parameters)), np.zeros((1, 1, other.n_memory)), view)
    expect(raw.shape == (1, 1, 3), f"bound to three controls it returns {raw.shape[-1:]}")
    expect(vars(example.bound) == before, "a controller changes when another is bound")


def it_has_parameters_to_evolve(example: ControllerExample) -> None:
    """It has at least one parameter, unless it is a baseline, and its outputs depend on the parameters"""
    count = example.bound.n_parameters
    if example.bound.is_baseline and count == 0:
        return
    expect(isinstance(count, int) and count >= 1, f"expected n_parameters >= 1, got {count!r}")
    raw, _ = example.bound.act(example.parameters, example.memory(2), example.view(2))
    equal = np.repeat(example.parameters[:1], CANDIDATES, axis=0)
    other, _ = example.bound.act(equal, example.memory(2), example.view(2))
    expect(not same(raw, other), "all parameter vectors give the same outputs")


def an_action_has_the_right_shape_and_type(example: ControllerExample) -> None:
    """act returns outputs (P, E, n_outputs) and memory (P, E, n_memory), finite and in float64"""
    for moment in (0, 3):
        raw, memory = example.bound.act(example.parameters, example.memory(moment), example.view(moment))
        expect_numbers("outputs", raw, (CANDIDATES, TRIALS, example.task.system.nu))
        expect_numbers("memory", memory, (CANDIDATES, TRIALS, example.bound.n_memory))


def outputs_stay_within_their_limits(example: ControllerExample) -> None:
    """Outputs are within [-1, 1] for any parameters"""
    raw, _ = example.bound.act(30.0 * example.parameters, example.memory(2), example.view(2))
    expect(np.abs(raw).max() <= 1.0, f"an output is {raw.ravel()[np.abs(raw).argmax()]:.3g}")


def an_action_is_pure(example: ControllerExample) -> None:
    """act changes neither its arguments nor its later results: all state is in the memory array"""
    view, memory = example.view(2), example.memory(2)
    first = expect_pure("action", example.bound.act, example.parameters, memory, view)
    for moment in range(3):
        example.bound.act(example.parameters, example.memory(moment), example.view(moment))
    again = example.bound.act(example.parameters, memory, view)
    expect(same(first, again), "calls in between change the result of the same call")


def candidates_and_trials_are_independent(example: ControllerExample) -> None:
    """The outputs of a candidate in a trial do not depend on other candidates and trials"""
    memory = example.memory(2)
    together = example.bound.act(example.parameters, memory.copy(), example.view(2))
    for p in range(CANDIDATES):
        for e in range(TRIALS):
            one, trial = slice(p, p + 1), slice(e, e + 1)
            alone = example.bound.act(example.parameters[one], memory[one, trial], example.view(2, one, trial))
            for found, expected in zip(alone, together, strict=True):
                equal = np.allclose(found, expected[one, trial], rtol=1e-9, atol=1e-12)
                expect(equal, f"candidate {p} in trial {e} acts differently when it is alone")


def the_compiled_form_acts_as_act_does(example: ControllerExample) -> None:
    """The compiled form gives the results of act"""
    expect_kernel(example.bound.kernel())
    expect_engines_agree(ExampleDynamics(example.task.system), example.made, example.parameters, example.task)


def the_exported_program_acts_as_act_does(example: ControllerExample) -> None:
    """The program for export gives the results of act"""
    for p in range(CANDIDATES):
        program = example.bound.program(example.parameters[p])
        if program is None:
            raise NotApplicable
        remembered, memory = program.begin(), example.memory(0)
        for moment in range(4):
            view = example.view(moment)
            raw, memory = example.bound.act(example.parameters, memory, view)
            found, remembered = program.run(view.observation[p, 0], remembered)
            expect(
                np.allclose(found, raw[p, 0], rtol=1e-9, atol=1e-12),
                f"outputs of the program are {found} in sample {moment}, those of act {raw[p, 0]}",
            )


CONTROLLER_CHECKS = (
    binding_gives_a_controller_of_that_size,
    it_has_parameters_to_evolve,
    an_action_has_the_right_shape_and_type,
    outputs_stay_within_their_limits,
    an_action_is_pure,
    candidates_and_trials_are_independent,
    the_compiled_form_acts_as_act_does,
    the_exported_program_acts_as_act_does,
)
CONTROLLER = Contract(controllers, _controller, CONTROLLER_CHECKS)


@dataclass(frozen=True)
class TaskExample:
    """A task, and the same task bound to a system that has its roles."""

    made: Task
    task: Task

    @property
    def system(self) -> System:
        """The system of the bound task."""
        return self.task.system

    def moment(self) -> tuple[TaskState, Array, Array, Array]:
        """Return trials after three steps, the states (B, nx) before and after the next step, and its control."""
        dynamics, rng = ExampleDynamics(self.system), np.random.default_rng(7)
        task_state = self.task.begin(SEEDS)
        before = task_state.state.copy()
        controls = self.system.actuate(rng.uniform(-1.0, 1.0, (4, TRIALS, self.system.nu)))
        for control in controls[:3]:
            task_state, reached = self.advance(task_state, before, dynamics.step(before, control), control)
            before = np.array(reached, dtype=np.float64)
        return task_state, before, dynamics.step(before, controls[3]), controls[3]

    def advance(self, task_state: TaskState, before: Array, after: Array, control: Array) -> tuple[TaskState, Array]:
        """Advance the task by one step."""
        return self.task.advance(task_state, before, after, control=control)

    def drive(self, parameters: Array, seeds: Any = SEEDS) -> Rollouts:
        """Return rollouts of networks with these parameters, in the reference form."""
        return rollout(
            ExampleDynamics(self.system), RecurrentNetwork(hidden=3), parameters, self.task, seeds, engine="reference"
        )

    @property
    def networks(self) -> Array:
        """Parameters (P, n) of random networks, small enough that rounding errors do not grow."""
        bound = RecurrentNetwork(hidden=3).bind_to(self.task)
        return 0.5 * np.random.default_rng(8).standard_normal((NETWORKS, bound.n_parameters))


def check_task(name: str, system: System | None = None, **parameters: Any) -> None:
    """Raise `ContractViolation` with all rules that the registered task ``name`` breaks.

    ``system`` has the roles of the task; by default it is the first of `example_systems` that has them.
    """
    TASK.check(name, system, **parameters)


def _task(name: str, system: System | None = None, **parameters: Any) -> tuple[TaskExample]:
    made = make_task(name, **parameters)
    return (TaskExample(made, _bound(made, example_systems() if system is None else (system,))),)


def binding_does_not_change_the_task(example: TaskExample) -> None:
    """bind returns a task on that system and does not change the task itself"""
    before = dict(vars(example.made))
    bound = example.made.bind(example.system)
    expect(bound is not example.made and vars(example.made) == before, "bind changes the task itself")
    expect(bound.system == example.system, "the bound task has another system")


def a_missing_role_is_named(example: TaskExample) -> None:
    """bind raises IncompatibleTask for a system that lacks a role, and names the role"""
    try:
        example.made.bind(bare_system())
    except IncompatibleTask as error:
        motion = example.system.motion
        roles = [*example.system.state_names, *example.system.control_names, *(motion.roles() if motion else ())]
        expect(any(role in str(error) for role in roles), f"expected one of {', '.join(roles)} in: {error}")


def it_has_a_horizon_and_named_observations(example: TaskExample) -> None:
    """It has a horizon of at least one step, and its observations have different names"""
    task = example.task
    expect(isinstance(task.horizon, int) and task.horizon >= 1, f"expected horizon >= 1 steps, got {task.horizon!r}")
    expect(
        task.observations and all(isinstance(channel, Channel) for channel in task.observations),
        f"expected observations to be channels, got {task.observations!r}",
    )
    names = [channel.name for channel in task.observations]
    expect(len(set(names)) == len(names), f"two observations have the same name: {', '.join(names)}")


def a_trial_begins_within_the_system(example: TaskExample) -> None:
    """begin returns one trial for each seed, alive, with a state (E, nx) and a pose (E, n_pose)"""
    start = example.task.begin(SEEDS)
    expect_numbers("state", start.state, (TRIALS, example.system.nx))
    expect_numbers("pose", start.pose, (TRIALS, example.system.n_pose))
    alive = np.asarray(start.alive)
    expect(alive.shape == (TRIALS,) and alive.dtype == bool and alive.all(), f"alive is {alive} after begin")


def a_trial_depends_on_its_seed_alone(example: TaskExample) -> None:
    """A trial depends only on its seed, not on other trials and not on global randomness"""
    expect(same(example.task.begin(SEEDS), example.task.begin(SEEDS)), "the same seeds begin different trials")
    together = example.drive(example.networks).fitness
    alone = np.concatenate([example.drive(example.networks, SEEDS[e : e + 1]).fitness for e in range(TRIALS)], axis=1)
    expect(np.allclose(together, alone, rtol=1e-9), "a trial ends differently when it is run alone")


def candidates_have_the_same_trials(example: TaskExample) -> None:
    """All candidates have the same trials"""
    equal = np.repeat(example.networks[:1], 3, axis=0)
    found = example.drive(equal).fitness
    expect(np.allclose(found, found[0], rtol=1e-9), "two equal candidates have different scores")


def an_observation_has_the_right_shape_and_type(example: TaskExample) -> None:
    """observe returns one finite float64 number for each observation of each trial"""
    task_state, before, *_ = example.moment()
    expect_numbers("observation", example.task.observe(task_state, before), (TRIALS, len(example.task.observations)))


def observing_is_pure(example: TaskExample) -> None:
    """observe changes neither its arguments nor its later results"""
    task_state, before, *_ = example.moment()
    expect_pure("observation", example.task.observe, task_state, before)


def advancing_is_pure(example: TaskExample) -> None:
    """advance changes neither its arguments nor its later results"""
    expect_pure("advance", example.advance, *example.moment())


def advancing_keeps_shapes(example: TaskExample) -> None:
    """advance returns trials and states (B, nx) of the same shapes, finite and in float64"""
    task_state, *step = example.moment()
    advanced, reached = example.advance(task_state, *step)
    expect(type(advanced) is type(task_state), f"the type of the trials becomes {type(advanced).__name__}")
    expect_numbers("state", reached, (TRIALS, example.system.nx))
    expect_numbers("pose", advanced.pose, (TRIALS, example.system.n_pose))
    expect(np.shape(advanced.alive) == (TRIALS,), f"alive has the shape {np.shape(advanced.alive)}")


def a_measured_pose_is_used(example: TaskExample) -> None:
    """advance uses the measured pose if it is given"""
    if example.system.n_pose == 0:
        raise NotApplicable
    task_state, before, after, control = example.moment()
    measured = np.random.default_rng(6).uniform(-0.5, 0.5, task_state.pose.shape)
    advanced, _ = example.task.advance(task_state, before, after, control=control, pose=measured)
    expect(same(advanced.pose, measured), "the pose after the step is not the measured pose")


def fitness_is_a_number_and_never_below_the_worst(example: TaskExample) -> None:
    """fitness returns one number for each trial, never nan and never below worst"""
    task_state, *_ = example.moment()
    expect_numbers("fitness", example.task.fitness(task_state), (TRIALS,))
    driven = example.drive(example.networks).fitness
    expect(not np.isnan(driven).any(), "the fitness of a random controller is nan")
    lowest = min(driven.min(), example.task.fitness(task_state).min())
    expect(lowest >= example.task.worst, f"a fitness of {lowest:g} is below worst, which is {example.task.worst:g}")


def an_ended_trial_keeps_its_fitness(example: TaskExample) -> None:
    """The fitness of a trial that has ended does not change while others continue"""
    task_state, *step = example.moment()
    active = np.arange(TRIALS) % 2 == 0
    advanced, _ = example.advance(task_state, *step)
    found = example.task.fitness(task_state.updated_where(advanced, active))
    expected = np.where(active, example.task.fitness(advanced), example.task.fitness(task_state))
    expect(same(found, expected), "the fitness of an ended trial changes with the others")


def a_scene_can_be_drawn(example: TaskExample) -> None:
    """scene returns the markers (k, 2) of a trial in m, (k, 3) in space, and the number of those reached"""
    task_state, *_ = example.moment()
    for trial in range(TRIALS):
        scene = example.task.scene(task_state, trial)
        expect_numbers("markers", scene.markers, (len(scene.markers), 3 if example.system.n_pose == SPACE else 2))
        expect(0 <= scene.reached <= len(scene.markers), f"{scene.reached} of {len(scene.markers)} are reached")
        expect(scene.radius >= 0.0, f"a radius is {scene.radius} m")


def the_compiled_form_is_the_reference(example: TaskExample) -> None:
    """The compiled form gives the scores of the reference form"""
    expect_kernel(example.task.kernel())
    expect_engines_agree(
        ExampleDynamics(example.system), RecurrentNetwork(hidden=3), example.networks, example.task, SEEDS
    )


TASK_CHECKS = (
    binding_does_not_change_the_task,
    a_missing_role_is_named,
    it_has_a_horizon_and_named_observations,
    a_trial_begins_within_the_system,
    a_trial_depends_on_its_seed_alone,
    candidates_have_the_same_trials,
    an_observation_has_the_right_shape_and_type,
    observing_is_pure,
    advancing_is_pure,
    advancing_keeps_shapes,
    a_measured_pose_is_used,
    fitness_is_a_number_and_never_below_the_worst,
    an_ended_trial_keeps_its_fitness,
    a_scene_can_be_drawn,
    the_compiled_form_is_the_reference,
)
TASK = Contract(tasks, _task, TASK_CHECKS)


def _bound(task: Task, systems: tuple[System, ...]) -> Task:
    """Return ``task`` bound to the first system that it accepts. Raises `ContractViolation`."""
    reasons = []
    for system in systems:
        try:
            return task.bind(system)
        except IncompatibleTask as error:
            reasons.append(f"{system.name or 'the system'}: {error}")
    raise ContractViolation(f"bind refuses every example system; give a system with its roles. {'; '.join(reasons)}")


def expect_engines_agree(
    dynamics: Dynamics, controller: Controller, parameters: Array, task: Task, seeds: Seeds | None = None
) -> None:
    """Raise `ContractViolation` unless the compiled form (float64) and the reference form give the same trials."""
    seeds = trial_seeds(9, 4) if seeds is None else seeds
    compiled, exact = (
        rollout(dynamics, controller, parameters, task, seeds, record=True, engine=engine)
        for engine in ("float64", "reference")
    )
    for name, found, expected in (
        ("survived", compiled.survived, exact.survived),
        ("fitness", compiled.fitness, exact.fitness),
    ):
        expect(
            np.allclose(found, expected, rtol=TOLERANCE, atol=TOLERANCE),
            f"{name} is {found.ravel()[:5]} compiled and {expected.ravel()[:5]} in NumPy",
        )
    for a, b in zip(compiled.trajectories, exact.trajectories, strict=True):
        for name, found, expected in (("controls", a.controls, b.controls), ("states", a.states, b.states)):
            size = np.abs(expected).max(initial=1.0)
            off = np.abs(found - expected).max(axis=1) > TOLERANCE * size
            expect(not off.any(), f"{name} differ from sample {int(off.argmax())} of {a.name} on")
