"""The compiled rollout against the reference where every number can be followed."""

import dataclasses
import multiprocessing
from dataclasses import dataclass
from typing import get_args

import numpy as np
import pytest

from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.controllers.controller import make_controller
from sysid_evo.data import Dataset
from sysid_evo.engine import rollout
from sysid_evo.engine.compiled.closed_loop import LoopData
from sysid_evo.engine.results import trajectories
from sysid_evo.engine.rollout import BoundRollout
from sysid_evo.errors import InvalidArgument, InvalidSystem
from sysid_evo.kernels import LANES, Predictor
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.models.dynamics import enough, far_from_zero
from sysid_evo.models.kernels.stepping import stepping_kernel
from sysid_evo.motion import Motion
from sysid_evo.processors import Engine, use_processors
from sysid_evo.randomness import trial_seeds
from sysid_evo.system import Channel, System
from sysid_evo.tasks.references import SetPoint
from tests.fixtures.by_hand import Climber, Constant, Ladder, LadderState
from tests.fixtures.compiled_ladder import BlindLadder, CompiledClimber, CompiledConstant, CompiledLadder, seeds_from

EITHER = pytest.mark.parametrize("engine", ["float32", pytest.param("float64", marks=pytest.mark.nightly)])
HEIGHT = (Channel("height", "m"),)


def compare(engine, dynamics, parameters, task, seeds, *, controller=None, record=False):
    """Run the compiled form and the reference; assert that they agree; return both."""
    given = (dynamics, controller or CompiledConstant(), np.asarray(parameters), task, seeds)
    fast, exact = (rollout(*given, engine=one, record=record) for one in (engine, "reference"))
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


@pytest.mark.parametrize("engine", ["float32", "float64"])
@pytest.mark.parametrize("candidates, trials", [(1, 1), (13, 5), (64, 1), (1, 64), (43, 3)])
def test_every_number_of_rollouts_fills_its_blocks(ladder, engine, candidates, trials):
    parameters, task = np.linspace(-1, 1, candidates)[:, None], CompiledLadder(horizon=9, top=9.3)
    fast, _ = compare(engine, CompiledClimber(ladder), parameters, task, seeds_from(*range(trials)))
    assert fast.engine == f"compiled {engine}"
    assert fast.fitness.shape == (candidates, trials)


@pytest.mark.parametrize("engine", ["float32", "reference"])
def test_what_is_bound_once_and_run_often_gives_what_each_rollout_gives_by_itself(ladder, engine):
    given = CompiledClimber(ladder), CompiledConstant()
    task, bound = CompiledLadder(horizon=9, top=9.3), None
    for candidates, trials, record in ((70, 2, False), (3, 5, True), (70, 2, False)):
        parameters, seeds = np.linspace(-1, 1, candidates)[:, None], seeds_from(*range(trials))
        bound = bound or BoundRollout(*given, task, engine=engine)
        alone = rollout(*given, parameters, task, seeds, engine=engine, record=record)
        found = bound(parameters, seeds, record=record)
        np.testing.assert_array_equal(found.fitness, alone.fitness)
        np.testing.assert_array_equal(found.behaviour, alone.behaviour)
        assert len(found.trajectories) == len(alone.trajectories) == (candidates * trials if record else 0)


@EITHER
def test_trials_that_their_task_ends_stay_unchanged(ladder, engine):
    task = CompiledLadder(horizon=12, top=3.2)
    fast, exact = compare(
        engine, CompiledClimber(ladder), [[0.5], [0.0], [1.0]], task, seeds_from(0, 2), record=True
    )  # fmt: skip
    assert isinstance(fast.task_state, LadderState)
    np.testing.assert_array_equal(fast.task_state.steps, exact.task_state.steps)
    assert len(np.unique(fast.survived)) > 2


def test_memory_after_the_last_step_does_not_matter(ladder):
    """Only what was written is read: a number that is none warns when it is cast."""
    none = np.array([0x7FA00000], np.uint32).view(np.float32)[0]
    states, controls, poses = (np.full(shape, none, np.float32) for shape in ((2, 4, 1), (2, 3, 1), (2, 4, 2)))
    states[0, :3, 0], controls[0, :2, 0], poses[0, 1:3] = [0.0, 1.0, 2.0], [1.0, 1.0], [[3.0, 4.0], [5.0, 6.0]]
    tape = [array.reshape(-1) for array in (states, controls, poses)]
    (found,) = trajectories(tape, np.array([2, 0]), np.array([[1.0, 2.0]]), CompiledLadder(horizon=3), ladder)
    np.testing.assert_array_equal(found.states[:, 0], [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(found.controls[:, 0], [1.0, 1.0])
    np.testing.assert_array_equal(found.pose, [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    assert found.states.dtype == found.controls.dtype == np.float64


@EITHER
def test_a_trial_that_is_over_before_it_begins_takes_no_step(ladder, engine):
    class Over(CompiledLadder):
        def begin(self, seeds):
            began = super().begin(seeds)
            return dataclasses.replace(began, alive=began.state[:, 0] < 5)

    fast, _ = compare(engine, CompiledClimber(ladder), [[0.1]], Over(horizon=4), seeds_from(7, 1))
    assert fast.survived.min() == 0


@EITHER
def test_diverged_trials_leave_the_trajectories_of_the_others_alone(ladder, engine):
    dynamics, seeds = CompiledClimber(ladder, breaks_above=3.2), seeds_from(2, 0, 9)
    compare(engine, dynamics, [[0.5], [0.0], [1.0]], CompiledLadder(), seeds, record=True)


@EITHER
def test_clipped_steps_are_counted_and_rollouts_continue_from_clipped_states(ladder, engine):
    dynamics, task = CompiledClimber(ladder, state_bounds=np.array([[-1.0], [1.2]])), CompiledLadder(horizon=8)
    fast, _ = compare(engine, dynamics, [[0.5], [0.1], [-1.0]], task, seeds_from(0, 1), record=True)
    assert fast.clipped.min() < fast.clipped.max()


@EITHER
def test_a_trial_that_is_over_is_clipped_no_more(ladder, engine):
    dynamics, task = CompiledClimber(ladder, state_bounds=np.array([[-9.0], [3.0]])), CompiledLadder(horizon=8, top=1.7)
    fast, _ = compare(engine, dynamics, [[0.5], [0.0]], task, seeds_from(0, 1))
    assert fast.survived.min() < 8
    np.testing.assert_array_equal(fast.clipped, 0)


@EITHER
def test_a_wall_alters_the_state_of_the_next_step(ladder, engine):
    """At the ceiling a climber stays below the top that would end its trial."""
    task = CompiledLadder(horizon=8, ceiling=0.8, top=0.9)
    fast, _ = compare(engine, CompiledClimber(ladder), [[0.5]], task, seeds_from(0), record=True)
    assert fast.survived[0, 0] == 8
    np.testing.assert_array_equal(fast.clipped, 0)


@EITHER
@pytest.mark.parametrize("trials", [11, 16, 17, 30])
def test_every_candidate_has_the_noise_of_its_trial(ladder, engine, trials):
    """Fitness is when the random walk crosses the top: the same for equal candidates, another in each trial."""
    task = CompiledLadder(horizon=60, top=9.5)
    fast, _ = compare(engine, CompiledClimber(ladder), np.zeros((9, 1)), task, seeds_from(*range(trials)))
    assert (fast.survived == fast.survived[0]).all()
    assert len(np.unique(fast.survived)) > 1


@EITHER
@pytest.mark.parametrize("levels", [(-1.0, 1.0), (0.0, 0.5, 2.0), (-2.0, -1.0, 0.0, 3.0), (0.0, 1.0, 2.0, 3.0, 4.0)])
def test_every_output_selects_the_level_of_the_system(engine, levels):
    system = System(HEIGHT, (Channel("climb", "m", levels=levels, neutral=levels[0]),), dt=0.1)
    raw, task = np.linspace(-1.3, 1.3, 137)[:, None], CompiledLadder(horizon=1)
    fast, _ = compare(engine, CompiledClimber(system), raw, task, seeds_from(0), record=True)
    assert {float(t.controls[0, 0]) for t in fast.trajectories} == set(levels)


@pytest.mark.parametrize("n_levels", range(2, 8))
def test_a_boundary_between_levels_belongs_to_the_inner_one(n_levels):
    system = System(HEIGHT, (Channel("climb", "m", levels=tuple(map(float, range(n_levels)))),), dt=0.1)
    raw, task = 0.9 * np.arange(2 - n_levels, n_levels, 2)[:, None] / n_levels, CompiledLadder(horizon=1)
    compare("float64", CompiledClimber(system), raw, task, seeds_from(0), record=True)


@EITHER
def test_a_continuous_control_is_scaled_to_its_limits(engine):
    system = System(HEIGHT, (Channel("climb", "m", 1.0, 4.0, neutral=2.0),), dt=0.1)
    raw, task = np.linspace(-1.5, 1.5, 31)[:, None], CompiledLadder(horizon=1)
    fast, _ = compare(engine, CompiledClimber(system), raw, task, seeds_from(0), record=True)
    assert fast.trajectories[0].controls[0, 0] == 1.0
    assert fast.trajectories[-1].controls[0, 0] == 4.0


@pytest.mark.parametrize("engine", get_args(Engine))
def test_a_control_without_limits_is_refused_by_every_form(engine):
    dynamics = CompiledClimber(System(HEIGHT, (Channel("climb", "m"),), dt=0.1))
    with pytest.raises(InvalidSystem, match="no finite limits"):
        rollout(dynamics, CompiledConstant(), np.zeros((1, 1)), CompiledLadder(), seeds_from(0), engine=engine)


@EITHER
def test_a_task_that_shows_nothing_runs(ladder, engine):
    dynamics = CompiledClimber(ladder, breaks_above=3.0)
    compare(engine, dynamics, np.linspace(-1, 1, 70)[:, None], BlindLadder(), seeds_from(0, 1))


@EITHER
@pytest.mark.parametrize("weights", [np.nan, np.inf, 1e300])
def test_broken_numbers_never_give_a_nan_fitness(ladder, engine, weights):
    for controller, size in ((CompiledConstant(), 1), (RecurrentNetwork(hidden=8), 80)):
        given = CompiledClimber(ladder), controller, np.full((2, size), weights), CompiledLadder(), seeds_from(0)
        assert np.isfinite(rollout(*given, engine=engine).fitness).all()


@EITHER
def test_the_recurrent_controller_remembers_what_it_saw(ladder, engine):
    weights, task = np.random.default_rng(5).standard_normal((30, 8 * 10)), CompiledLadder(horizon=30, top=9.0)
    network = RecurrentNetwork(hidden=8)
    compare(engine, CompiledClimber(ladder), weights, task, seeds_from(3, 6, 8), controller=network)


def attempt(dynamics, controller, task, **keywords):
    return rollout(dynamics, controller, np.zeros((1, 1)), task, seeds_from(0), **keywords).engine


def test_auto_takes_the_fastest_available_form_and_reports_it(ladder):
    compiled = CompiledClimber(ladder), CompiledConstant(), CompiledLadder()
    assert attempt(*compiled) == "compiled float32"
    assert attempt(*compiled, record=True) == "compiled float32"
    assert attempt(*compiled, engine="float64") == "compiled float64"
    assert attempt(*compiled, engine="reference") == "reference"
    assert attempt(Climber(ladder), *compiled[1:]) == "reference"
    assert attempt(compiled[0], Constant(), compiled[2]) == "reference"
    assert attempt(*compiled[:2], Ladder()) == "reference"


def test_a_form_that_cannot_run_reports_the_missing_kernels(ladder):
    compiled = CompiledClimber(ladder), CompiledConstant(), CompiledLadder()
    with pytest.raises(InvalidArgument, match=r"none of the dynamics, controller:"):
        attempt(Climber(ladder), Constant(), compiled[2], engine="float32")
    with pytest.raises(InvalidArgument, match=r"none of the task:"):
        attempt(*compiled[:2], Ladder(), engine="float64")
    with pytest.raises(InvalidArgument, match="got 'float16'"):
        attempt(*compiled, engine="float16")
    with pytest.raises(InvalidArgument, match="at least one thread, got 0"):
        attempt(*compiled, threads=0)


def test_the_number_of_threads_changes_nothing(ladder):
    dynamics, task = CompiledClimber(ladder, breaks_above=9.0), CompiledLadder(horizon=20, top=9.5)
    given = dynamics, CompiledConstant(), np.linspace(-1, 1, 150)[:, None], task, seeds_from(1, 8)
    first, *others = (rollout(*given, threads=threads, record=True) for threads in (1, 2, 3, 50))
    for other in others:
        np.testing.assert_array_equal(other.fitness, first.fitness)
        np.testing.assert_array_equal(other.survived, first.survived)
        for a, b in zip(other.trajectories, first.trajectories, strict=True):
            np.testing.assert_array_equal(a.states, b.states)


def score_in_a_fork(system, answers):
    given = CompiledClimber(system), CompiledConstant(), np.zeros((200, 1)), CompiledLadder(horizon=5), seeds_from(0)
    answers.put(float(rollout(*given, threads=2).fitness.sum()))


def test_a_bound_rollout_uses_the_processors_that_the_process_has_now(ladder, monkeypatch):
    used, run = [], LoopData.run
    monkeypatch.setattr(
        LoopData, "run", lambda *args, threads, **how: used.append(threads) or run(*args, threads=threads, **how)
    )
    bound = BoundRollout(CompiledClimber(ladder), CompiledConstant(), CompiledLadder(horizon=9, top=9.3))
    try:
        for count in (1, 3, 2):
            use_processors(count)
            bound(np.zeros((4, 1)), seeds_from(0))
    finally:
        use_processors(0)
    assert used == [1, 3, 2]


def test_a_forked_process_has_threads_of_its_own(ladder):
    context = multiprocessing.get_context("fork")
    answers = context.Queue()
    score_in_a_fork(ladder, answers)
    assert answers.get(timeout=20) == 1000.0
    child = context.Process(target=score_in_a_fork, args=(ladder, answers))
    child.start()
    try:
        assert answers.get(timeout=20) == 1000.0
    finally:
        child.kill()
        child.join()


@dataclass(frozen=True)
class Slipping(Motion):
    """A body on a pole that keeps half of every height it gains; it has no compiled form."""

    kind = "slipping"
    n_pose = 0
    pose_names = ()
    pose_units = ()

    speed: str = "height"

    def roles(self):
        return {"speed": self.speed}

    def acceleration(self, before, after, dt, names):
        return 2.0 * (after - before) / dt

    def integrate(self, state, acceleration, dt, names):
        return state + 0.5 * acceleration * dt

    def frame_rotation(self, state, names):
        return np.zeros_like(state)

    def move(self, pose, before, after, dt, names):
        return pose


def push(x, u, p, y, scratch):
    for lane in range(LANES):
        y[lane] = 10.0 * u[lane]


class Pushed(DynamicsModel):
    """The acceleration is ten times the control, known exactly, with a kernel where the motion has one."""

    def fit(self, dataset, **keywords):
        return self

    def acceleration(self, carry, control):
        return 10.0 * control

    def kernel(self):
        return stepping_kernel(Predictor(push, np.zeros(1), 0), self.system, output="acceleration")


@pytest.mark.filterwarnings("ignore::sysid_evo.errors.DataWarning")  # the data are one step
def test_a_model_whose_motion_has_no_compiled_form_runs_in_numpy(ladder):
    """Half of 0.25 or 0.75 is gained in each step; without that motion it is compiled and goes twice as far."""
    slipping = System(ladder.states, ladder.controls, ladder.dt, Slipping())
    models = [
        Pushed().fit(Dataset.from_arrays(system, [np.array([[0.0], [100.0]])], [np.zeros((1, 1))]))
        for system in (slipping, ladder)
    ]
    given = CompiledConstant(), np.array([[0.25], [0.75]]), CompiledLadder(horizon=40, top=12.5), seeds_from(0, 8)
    found = rollout(models[0], *given, record=True)
    assert found.engine == "reference"
    np.testing.assert_array_equal(found.fitness, [[40, 37], [34, 13]])
    for run in found.trajectories:
        again = models[0].simulate(run.states[None, :1], run.controls[None, :0], run.controls[None])
        np.testing.assert_allclose(again[0], run.states[1:], rtol=1e-12)
    compiled = rollout(models[1], *given)
    assert compiled.engine == "compiled float32"
    np.testing.assert_array_equal(compiled.fitness[0], [40, 19])
    with pytest.raises(InvalidArgument, match="needs kernels, but there is none of the dynamics"):
        rollout(models[0], *given, engine="float32")


@pytest.mark.parametrize("centre, precision", [(0.0, "float32"), (5e4, "float64"), (5e6, "float64")])
def test_states_far_from_zero_for_how_much_they_change_take_the_precision_that_they_need(ladder, centre, precision):
    dynamics = CompiledClimber(ladder, state_bounds=np.array([[centre - 2.0], [centre + 2.0]]))
    given = (
        dynamics,
        CompiledConstant(),
        np.array([[0.013], [-0.02]]),
        CompiledLadder(horizon=30),
        seeds_from(*range(8)),
    )
    fast, exact = (rollout(*given, engine=engine, record=True) for engine in ("auto", "reference"))
    assert fast.engine == f"compiled {precision}"
    ends = [np.array([run.states[-1] for run in found.trajectories]) for found in (fast, exact)]
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-4)
    assert np.unique(ends[1]).size > 8, "states at a limit prove nothing"


def far_recording(centre):
    """A damped oscillation of 0.5 around ``centre`` under a force, as a position in UTM metres is."""
    rng = np.random.default_rng(4)
    states = (Channel("position", "m", neutral=centre), Channel("speed", "m/s"))
    system = System(states, (Channel("force", "N", -2.0, 2.0),), dt=0.1)
    force, runs = np.repeat(rng.uniform(-2.0, 2.0, (3, 50, 1)), 4, axis=1), np.zeros((3, 201, 2))
    for k in range(200):
        position, speed = runs[:, k].T
        change = np.stack([speed, force[:, k, 0] - 2.0 * position - 0.6 * speed], axis=1)
        runs[:, k + 1] = runs[:, k] + 0.1 * change + 0.002 * rng.standard_normal((3, 2))
    return Dataset.from_arrays(system, list(runs + np.array([centre, 0.0])), list(force))


@pytest.mark.nightly
@pytest.mark.parametrize("family", ["linear", "nearest_neighbour", "linear_state_space"])
@pytest.mark.parametrize("centre", [0.0, 500.0, 5e4, 5e6])
def test_after_three_seconds_far_from_zero_the_state_of_a_family_is_that_of_the_reference(family, centre):
    dataset = far_recording(centre)
    model = make_model(family).fit(dataset, rng=0)
    task, law = SetPoint(channels="position", low=centre, high=centre, horizon=30), "linear(inputs=position_error)"
    given = model, make_controller(law), np.array([[0.7, 0.2], [-0.3, 0.5]]), task, trial_seeds(1, 4)
    runs = [rollout(*given, record=True, engine=engine) for engine in ("auto", "reference")]
    assert runs[0].engine == ("compiled float64" if centre else "compiled float32")
    ends = [np.array([trajectory.states[-1] for trajectory in run.trajectories]) for run in runs]
    assert np.abs(ends[0] - ends[1]).max() < 5e-4
    assert np.abs(ends[1][:, 0] - centre).max() > 0.01  # something moved
    assert ("double precision" in model.fit_note) == bool(centre)


def test_only_what_moves_within_limits_far_from_zero_counts():
    far, near = [1e6 - 1.0, 1e6 + 1.0], [-1.0, 3.0]
    constant, turning = [12.0, 12.0], [-np.inf, np.inf]
    state_bounds = np.array([near, constant, turning, far]).T
    assert far_from_zero(state_bounds).tolist() == [3]
    assert enough("float32", state_bounds) == "float64"
    assert enough("float32", state_bounds[:, :3]) == "float32"
    assert enough("float64", None) == "float64"
    assert enough("float32", None) == "float32"
    for centre in (0.0, 500.0):
        note = make_model("linear").fit(far_recording(centre), rng=0).fit_note
        assert ("double precision" in note) == bool(centre)
