"""The compiled rollout against the reference where every number can be followed."""

from __future__ import annotations

import dataclasses
import multiprocessing
from typing import Any, get_args

import numpy as np
import pytest

from sysid_evo.controllers import Controller, RecurrentNetwork
from sysid_evo.engine import Engine, Rollouts, rollout
from sysid_evo.engine.results import trajectories
from sysid_evo.errors import InvalidArgument, InvalidSystem
from sysid_evo.models import Dynamics
from sysid_evo.system import Channel, System
from sysid_evo.tasks import Task
from sysid_evo.types import Array, Seeds
from tests.fixtures.by_hand import Climber, Constant, Ladder, LadderState
from tests.sysid_evo.engine.compiled_ladder import (
    BlindLadder,
    CompiledClimber,
    CompiledConstant,
    CompiledLadder,
    seeds_from,
)

COMPILED: tuple[Engine, ...] = ("float32", "float64")


@pytest.fixture(scope="session")
def climb() -> System:
    return System((Channel("height", "m"),), (Channel("climb", "m", -1.0, 1.0, neutral=0.25),), dt=0.1)


def compare(
    engine: Engine, dynamics: Dynamics, controller: Controller, parameters: Array, task: Task, seeds: Seeds,
    *, record: bool = False, threads: int | None = None,
) -> tuple[Rollouts, Rollouts]:  # fmt: skip
    """Run the fast form and the reference; assert that they agree; return both."""
    given = (dynamics, controller, parameters, task, seeds)
    fast = rollout(*given, engine=engine, record=record, threads=threads)
    exact = rollout(*given, engine="reference", record=record)
    np.testing.assert_allclose(fast.fitness, exact.fitness, rtol=1e-6)
    np.testing.assert_array_equal(fast.survived, exact.survived)
    np.testing.assert_array_equal(fast.clipped, exact.clipped)
    np.testing.assert_array_equal(fast.task_state.alive, exact.task_state.alive)
    assert len(fast.trajectories) == len(exact.trajectories)
    for a, b in zip(fast.trajectories, exact.trajectories, strict=True):
        assert a.name == b.name
        np.testing.assert_allclose(a.states, b.states, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(a.controls, b.controls, rtol=1e-6, atol=1e-6)
    return fast, exact


@pytest.mark.parametrize("engine", COMPILED)
@pytest.mark.parametrize("candidates, trials", [(1, 1), (13, 5), (64, 1), (1, 64), (43, 3)])
def test_every_number_of_rollouts_fills_its_blocks(climb: System, engine: Engine, candidates: int, trials: int) -> None:
    parameters = np.linspace(-1, 1, candidates)[:, None]
    seeds = np.arange(trials, dtype=np.uint64)
    task = CompiledLadder(horizon=9, top=9.3)
    fast, _ = compare(engine, CompiledClimber(climb), CompiledConstant(), parameters, task, seeds)
    assert fast.engine == f"compiled {engine}"
    assert fast.fitness.shape == (candidates, trials)


@pytest.mark.parametrize("engine", COMPILED)
def test_trials_that_their_task_ends_stand_still(climb: System, engine: Engine) -> None:
    task = CompiledLadder(horizon=12, top=3.2)
    parameters = np.array([[0.5], [0.0], [1.0]])
    fast, exact = compare(
        engine, CompiledClimber(climb), CompiledConstant(), parameters, task, seeds_from(0, 2), record=True
    )
    assert isinstance(fast.task_state, LadderState)
    assert isinstance(exact.task_state, LadderState)
    np.testing.assert_array_equal(fast.task_state.steps, exact.task_state.steps)
    assert len(np.unique(fast.survived)) > 2


def test_what_stands_in_memory_after_the_last_step_does_not_matter(climb: System) -> None:
    """Only what was written is read: a number that is none warns when it is cast."""
    task = CompiledLadder(horizon=3)
    none = np.array([0x7FA00000], np.uint32).view(np.float32)[0]
    states, controls, poses = (np.full(shape, none, np.float32) for shape in ((2, 4, 1), (2, 3, 1), (2, 4, 2)))
    states[0, :3, 0], controls[0, :2, 0], poses[0, 1:3] = [0.0, 1.0, 2.0], [1.0, 1.0], [[3.0, 4.0], [5.0, 6.0]]
    tape = [array.reshape(-1) for array in (states, controls, poses)]
    (found,) = trajectories(tape, np.array([2, 0]), np.array([[1.0, 2.0]]), task, climb)
    np.testing.assert_array_equal(found.states[:, 0], [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(found.controls[:, 0], [1.0, 1.0])
    np.testing.assert_array_equal(found.pose, [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    assert found.states.dtype == found.controls.dtype == np.float64


@pytest.mark.parametrize("engine", COMPILED)
def test_a_trial_that_is_over_before_it_begins_takes_no_step(climb: System, engine: Engine) -> None:
    class Over(CompiledLadder):
        def begin(self, seeds: Seeds) -> LadderState:
            began = super().begin(seeds)
            return dataclasses.replace(began, alive=began.state[:, 0] < 5)

    fast, _ = compare(
        engine, CompiledClimber(climb), CompiledConstant(), np.array([[0.1]]), Over(horizon=4), seeds_from(7, 1)
    )
    np.testing.assert_array_equal(fast.survived, [[0, 4]])


@pytest.mark.parametrize("engine", COMPILED)
def test_a_diverged_trial_has_the_same_fitness_and_number_of_steps(climb: System, engine: Engine) -> None:
    parameters = np.array([[0.5], [0.0], [1.0]])
    dynamics = CompiledClimber(climb, breaks_above=3.2)
    fast, _ = compare(engine, dynamics, CompiledConstant(), parameters, CompiledLadder(), seeds_from(2, 0, 9))
    assert (fast.fitness < 0).any()
    assert (fast.fitness == 10).any()
    assert fast.survived.min() == 0


@pytest.mark.parametrize("engine", COMPILED)
def test_diverged_trials_leave_the_trajectories_of_the_others_alone(climb: System, engine: Engine) -> None:
    parameters = np.array([[0.5], [0.0], [1.0]])
    dynamics = CompiledClimber(climb, breaks_above=3.2)
    compare(engine, dynamics, CompiledConstant(), parameters, CompiledLadder(), seeds_from(2, 0, 9), record=True)


@pytest.mark.parametrize("engine", COMPILED)
def test_clipped_steps_are_counted_and_clipped_states_go_on(climb: System, engine: Engine) -> None:
    dynamics = CompiledClimber(climb, envelope=np.array([[-1.0], [1.2]]))
    parameters = np.array([[0.5], [0.1], [-1.0]])
    fast, _ = compare(
        engine, dynamics, CompiledConstant(), parameters, CompiledLadder(horizon=8), seeds_from(0, 1),
        record=True,
    )  # fmt: skip
    assert fast.clipped.min() < fast.clipped.max()


@pytest.mark.parametrize("engine", COMPILED)
def test_a_trial_that_is_over_is_clipped_no_more(climb: System, engine: Engine) -> None:
    dynamics = CompiledClimber(climb, envelope=np.array([[-9.0], [3.0]]))
    parameters = np.array([[0.5], [0.0]])
    fast, _ = compare(
        engine, dynamics, CompiledConstant(), parameters, CompiledLadder(horizon=8, top=1.7), seeds_from(0, 1)
    )
    assert fast.survived.min() < 8
    np.testing.assert_array_equal(fast.clipped, 0)


@pytest.mark.parametrize("engine", COMPILED)
def test_a_wall_alters_the_state_that_goes_on(climb: System, engine: Engine) -> None:
    """At the ceiling a climber stays below the top that would end its trial."""
    task = CompiledLadder(horizon=8, ceiling=0.8, top=0.9)
    fast, _ = compare(
        engine, CompiledClimber(climb), CompiledConstant(), np.array([[0.5]]), task, seeds_from(0), record=True
    )
    assert fast.survived[0, 0] == 8
    np.testing.assert_array_equal(fast.clipped, 0)


@pytest.mark.parametrize("engine", COMPILED)
@pytest.mark.parametrize("trials", [11, 16, 17, 30])
def test_every_candidate_meets_the_noise_of_its_trial(climb: System, engine: Engine, trials: int) -> None:
    """Fitness is when the random walk crosses the top: the same for equal candidates, another in each trial."""
    task = CompiledLadder(horizon=60, top=9.5)
    fast, _ = compare(
        engine, CompiledClimber(climb), CompiledConstant(), np.zeros((9, 1)), task, np.arange(trials, dtype=np.uint64)
    )
    assert (fast.survived == fast.survived[0]).all()
    assert len(np.unique(fast.survived)) > 1


@pytest.mark.parametrize("engine", COMPILED)
@pytest.mark.parametrize("levels", [(-1.0, 1.0), (0.0, 0.5, 2.0), (-2.0, -1.0, 0.0, 3.0), (0.0, 1.0, 2.0, 3.0, 4.0)])
def test_every_output_selects_the_level_that_the_system_says(engine: Engine, levels: tuple[float, ...]) -> None:
    system = System((Channel("height", "m"),), (Channel("climb", "m", levels=levels, neutral=levels[0]),), dt=0.1)
    raw = np.linspace(-1.3, 1.3, 137)[:, None]
    fast, _ = compare(
        engine, CompiledClimber(system), CompiledConstant(), raw, CompiledLadder(horizon=1), seeds_from(0), record=True
    )
    assert {float(t.controls[0, 0]) for t in fast.trajectories} == set(levels)


@pytest.mark.parametrize("n_levels", range(2, 8))
def test_a_boundary_between_levels_belongs_to_the_inner_one(n_levels: int) -> None:
    levels = tuple(float(i) for i in range(n_levels))
    system = System((Channel("height", "m"),), (Channel("climb", "m", levels=levels),), dt=0.1)
    raw = 0.9 * np.arange(2 - n_levels, n_levels, 2)[:, None] / n_levels
    compare(
        "float64", CompiledClimber(system), CompiledConstant(), raw, CompiledLadder(horizon=1), seeds_from(0),
        record=True,
    )  # fmt: skip


@pytest.mark.parametrize("engine", COMPILED)
def test_a_continuous_control_is_scaled_to_its_limits(engine: Engine) -> None:
    system = System((Channel("height", "m"),), (Channel("climb", "m", 1.0, 4.0, neutral=2.0),), dt=0.1)
    raw = np.linspace(-1.5, 1.5, 31)[:, None]
    fast, _ = compare(
        engine, CompiledClimber(system), CompiledConstant(), raw, CompiledLadder(horizon=1), seeds_from(0), record=True
    )
    assert fast.trajectories[0].controls[0, 0] == 1.0
    assert fast.trajectories[-1].controls[0, 0] == 4.0


@pytest.mark.parametrize("engine", get_args(Engine))
def test_a_control_without_limits_is_refused_by_every_form(engine: Engine) -> None:
    system = System((Channel("height", "m"),), (Channel("climb", "m"),), dt=0.1)
    with pytest.raises(InvalidSystem, match="no finite limits"):
        rollout(
            CompiledClimber(system), CompiledConstant(), np.zeros((1, 1)), CompiledLadder(), seeds_from(0),
            engine=engine,
        )  # fmt: skip


@pytest.mark.parametrize("engine", COMPILED)
def test_a_task_that_shows_nothing_runs(climb: System, engine: Engine) -> None:
    compare(
        engine, CompiledClimber(climb, breaks_above=3.0), CompiledConstant(), np.linspace(-1, 1, 70)[:, None],
        BlindLadder(), seeds_from(0, 1),
    )  # fmt: skip


@pytest.mark.parametrize("engine", COMPILED)
@pytest.mark.parametrize("weights", [np.nan, np.inf, 1e300])
def test_broken_numbers_never_give_a_nan_fitness(climb: System, engine: Engine, weights: float) -> None:
    for controller, size in ((CompiledConstant(), 1), (RecurrentNetwork(hidden=1), 3)):
        parameters = np.full((2, size), weights)
        run = rollout(CompiledClimber(climb), controller, parameters, CompiledLadder(), seeds_from(0), engine=engine)
        assert np.isfinite(run.fitness).all()


@pytest.mark.parametrize("engine", [*COMPILED, "auto"])
def test_the_recurrent_controller_remembers_what_it_saw(climb: System, engine: Engine) -> None:
    weights = np.random.default_rng(5).standard_normal((30, 8 * 10))
    task = CompiledLadder(horizon=30, top=9.0)
    compare(engine, CompiledClimber(climb), RecurrentNetwork(hidden=8), weights, task, seeds_from(3, 6, 8))


def test_auto_takes_the_fastest_form_there_is_and_says_so(climb: System) -> None:
    def form(dynamics: Dynamics, controller: Controller, task: Task, **keywords: Any) -> str:
        return rollout(dynamics, controller, np.zeros((1, 1)), task, seeds_from(0), **keywords).engine

    compiled = CompiledClimber(climb), CompiledConstant(), CompiledLadder()
    assert form(*compiled) == "compiled float32"
    assert form(*compiled, record=True) == "compiled float32"
    assert form(*compiled, engine="float64") == "compiled float64"
    assert form(*compiled, engine="reference") == "reference"
    assert form(Climber(climb), *compiled[1:]) == "reference"
    assert form(compiled[0], Constant(), compiled[2]) == "reference"
    assert form(*compiled[:2], Ladder()) == "reference"


def test_a_form_that_cannot_run_says_what_is_missing(climb: System) -> None:
    def attempt(dynamics: Dynamics, controller: Controller, task: Task, **keywords: Any) -> None:
        rollout(dynamics, controller, np.zeros((1, 1)), task, seeds_from(0), **keywords)

    compiled = CompiledClimber(climb), CompiledConstant(), CompiledLadder()
    with pytest.raises(InvalidArgument, match=r"no kernel of the dynamics, controller$"):
        attempt(Climber(climb), Constant(), compiled[2], engine="float32")
    with pytest.raises(InvalidArgument, match=r"no kernel of the task$"):
        attempt(*compiled[:2], Ladder(), engine="float64")
    with pytest.raises(InvalidArgument, match="not 'float16'"):
        attempt(*compiled, engine="float16")
    with pytest.raises(InvalidArgument, match="at least one thread, got 0"):
        attempt(*compiled, threads=0)


def test_the_number_of_threads_changes_nothing(climb: System) -> None:
    parameters = np.linspace(-1, 1, 150)[:, None]
    task = CompiledLadder(horizon=20, top=9.5)
    runs = [
        rollout(
            CompiledClimber(climb, breaks_above=9.0), CompiledConstant(), parameters, task, seeds_from(1, 8),
            threads=threads, record=True,
        )
        for threads in (1, 2, 3, 50)
    ]  # fmt: skip
    for other in runs[1:]:
        np.testing.assert_array_equal(other.fitness, runs[0].fitness)
        np.testing.assert_array_equal(other.survived, runs[0].survived)
        for a, b in zip(other.trajectories, runs[0].trajectories, strict=True):
            np.testing.assert_array_equal(a.states, b.states)


def score_in_a_fork(system: System, answers: Any) -> None:
    task = CompiledLadder(horizon=5)
    parameters = np.zeros((200, 1))
    run = rollout(CompiledClimber(system), CompiledConstant(), parameters, task, seeds_from(0), threads=2)
    answers.put(float(run.fitness.sum()))


def test_a_forked_process_has_threads_of_its_own(climb: System) -> None:
    context = multiprocessing.get_context("fork")
    answers = context.Queue()
    score_in_a_fork(climb, answers)
    assert answers.get(timeout=20) == 1000.0
    child = context.Process(target=score_in_a_fork, args=(climb, answers))
    child.start()
    try:
        assert answers.get(timeout=20) == 1000.0
    finally:
        child.kill()
        child.join()
