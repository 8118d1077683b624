"""The closed loop against a plain scalar loop, and what it does when trials end or diverge."""

import dataclasses
import math

import numpy as np
import pytest

from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import DynamicsRunner, behaviour_names, rollout
from sysid_evo.engine.compiled import loops
from sysid_evo.errors import IncompatibleTask, InvalidArgument, ShapeError
from sysid_evo.evolution import Champion
from sysid_evo.models.base import make_model
from sysid_evo.randomness import draw_for_steps, draw_for_trials, trial_seeds
from sysid_evo.registry import make_robot
from sysid_evo.system import Channel
from sysid_evo.tasks import PointToPoint
from tests.fixtures.by_hand import Climber, Constant, Echo, Ladder, LadderState, Restless, SluggishCar, network_by_hand
from tests.fixtures.compiled_ladder import seeds_from

SEEDS = seeds_from(12, 7, 33)
RADIUS = 1.0  # m: a random network passes a few waypoints of this size


def drive_by_hand(weights, waypoints, noise, draw, horizon):
    """One network drives one `SluggishCar` for one trial: waypoints passed, and every state."""
    dt = 0.05
    u = v = r = x = y = heading = last_drive = 0.0
    battery = 1.0 + 0.1 * draw
    passed = 0
    observations = []
    states = [[u, v, r]]
    for k in range(horizon):
        dx, dy = waypoints[passed][0] - x, waypoints[passed][1] - y
        angle = math.atan2(dy, dx) - heading
        while angle > math.pi:
            angle -= 2 * math.pi
        while angle <= -math.pi:
            angle += 2 * math.pi
        observations.append([1.0, u, r, angle, math.hypot(dx, dy)])
        outputs = network_by_hand(weights, np.array(observations), 6, 2)[-1]
        drive, steer = (1.0 if value > 0.3 else -1.0 if value < -0.3 else 0.0 for value in outputs)
        new_u = u + dt * (4.0 * battery * last_drive - u) + 0.01 * noise[k][0]
        new_v = 0.8 * v + 0.02 * r
        new_r = r + dt * (5.0 * u * steer - 2.0 * r) + 0.02 * noise[k][1]
        mean_u, mean_v, turn = (u + new_u) / 2, (v + new_v) / 2, (r + new_r) / 2 * dt
        middle = heading + turn / 2
        x += dt * (mean_u * math.cos(middle) - mean_v * math.sin(middle))
        y += dt * (mean_u * math.sin(middle) + mean_v * math.cos(middle))
        heading += turn
        u, v, r, last_drive = new_u, new_v, new_r, drive
        if math.hypot(waypoints[passed][0] - x, waypoints[passed][1] - y) <= RADIUS:
            passed += 1
        states.append([u, v, r])
    return passed, states


def test_a_rollout_equals_a_plain_scalar_loop(car):
    horizon = 60
    task = PointToPoint(horizon=horizon, waypoint_radius=RADIUS)
    weights = np.random.default_rng(8).standard_normal((4, 78))
    run = rollout(SluggishCar(car), RecurrentNetwork(), weights, task, SEEDS, record=True)
    waypoints = task.bind(car).begin(SEEDS).waypoints
    noise, draws = draw_for_steps(SEEDS, horizon, 2), draw_for_trials(SEEDS, 1)
    for p in range(4):
        for e in range(3):
            passed, states = drive_by_hand(weights[p], waypoints[e], noise[e], draws[e, 0], horizon)
            assert run.fitness[p, e] == passed
            np.testing.assert_allclose(run.trajectories[p * 3 + e].states, states, rtol=1e-9, atol=1e-9)
    assert run.fitness.max() >= 2  # something happened
    assert (run.survived == horizon).all()


def drive(car, weights, seeds=SEEDS):
    task = PointToPoint(horizon=40, waypoint_radius=0.5)
    return rollout(SluggishCar(car), RecurrentNetwork(), weights, task, seeds, record=True)


def test_candidates_and_trials_keep_their_order_and_do_not_touch_each_other(car):
    weights = np.random.default_rng(8).standard_normal((5, 78))
    every, again, some = drive(car, weights), drive(car, weights), drive(car, weights[[3, 1]], SEEDS[[2, 0]])
    assert every.fitness.shape == every.survived.shape == every.clipped.shape == (5, 3)
    for i, p in enumerate((3, 1)):
        for j, e in enumerate((2, 0)):
            assert some.fitness[i, j] == every.fitness[p, e]
            part, whole = some.trajectories[i * 2 + j], every.trajectories[p * 3 + e]
            assert whole.name == f"candidate-{p}-trial-{e}"
            np.testing.assert_allclose(part.states, whole.states, rtol=1e-12, atol=1e-12)
            np.testing.assert_allclose(part.pose, whole.pose, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(again.fitness, every.fitness)
    for a, b in zip(again.trajectories, every.trajectories, strict=True):
        np.testing.assert_array_equal(a.states, b.states)
        moved = car.motion.move(a.pose[:-1], a.states[:-1], a.states[1:], car.dt, car.state_names)
        np.testing.assert_allclose(a.pose[1:], moved, atol=1e-12)
        np.testing.assert_array_equal(a.pose[0], [0.0, 0.0, 0.0])
    run = DynamicsRunner(SluggishCar(car)).bind(RecurrentNetwork(), PointToPoint(horizon=40))
    assert not run(weights, SEEDS).trajectories


def test_every_candidate_has_the_same_noise_in_the_same_trial(ladder):
    parameters = np.array([[0.0], [0.5], [0.0]])
    dynamics = Climber(ladder, n_noise=2)
    run = rollout(dynamics, Constant(), parameters, Ladder(horizon=12), SEEDS, record=True)
    heights = np.stack([t.states[:, 0] for t in run.trajectories]).reshape(3, 3, 13)
    noise = np.diff(heights, axis=2) - parameters[:, :, None]
    np.testing.assert_allclose(noise[1], noise[0], atol=1e-12)
    np.testing.assert_array_equal(noise[2], noise[0])
    np.testing.assert_allclose(noise[0], draw_for_steps(SEEDS, 12, 2).sum(axis=2), atol=1e-12)
    assert np.abs(noise[0, 0] - noise[0, 1]).min() > 1e-6


def test_a_controller_that_wants_noise_gets_the_same_in_the_same_trial(ladder):
    parameters = np.array([[0.1], [0.3]])
    given = (Climber(ladder), Restless(), parameters, Ladder(horizon=12), SEEDS)
    run = rollout(*given, record=True)
    assert run.engine == "reference"
    raw = np.stack([t.controls[:, 0] for t in run.trajectories]).reshape(2, 3, 12)
    drawn = (raw - parameters[:, :, None]) / 0.1
    np.testing.assert_allclose(drawn[0], drawn[1], atol=1e-9)
    assert np.unique(np.round(drawn[0], 9)).size == 36
    np.testing.assert_array_equal(rollout(*given).fitness, run.fitness)
    other = draw_for_steps(SEEDS, 12, 1)[..., 0]
    assert np.abs(drawn[0] - other).max() > 0.1, "the dynamics draws from a stream of its own"


def test_noise_depends_on_its_own_trial_and_step_alone():
    long = draw_for_steps(SEEDS, 50, 3)
    assert long.shape == (3, 50, 3)
    np.testing.assert_array_equal(draw_for_steps(SEEDS[1:2], 20, 3)[0], long[1, :20])
    assert draw_for_steps(SEEDS, 50, 0).shape == (3, 50, 0)
    assert draw_for_trials(SEEDS, 0).shape == (3, 0)
    assert not np.isin(draw_for_trials(SEEDS, 3), long).any()
    assert abs(draw_for_steps(trial_seeds(1, 100), 100, 1).std() - 1.0) < 0.03


def test_trial_seeds_are_keyed_by_seed_generation_and_trial():
    seeds = trial_seeds(3, 10, generation=4)
    np.testing.assert_array_equal(trial_seeds(3, 4, generation=4), seeds[:4])
    others = np.concatenate([trial_seeds(3, 10, generation=5), trial_seeds(4, 10, generation=4)])
    assert len({*seeds, *others}) == 30


def climb(dynamics, parameters, *heights, **ladder):
    """Run constant climbs from these heights, recorded."""
    given = dynamics, Constant(), np.array(parameters)[:, None], Ladder(**ladder), seeds_from(*heights)
    return rollout(*given, record=True)


def test_a_diverged_trial_scores_below_any_other_by_how_long_it_survived(ladder):
    """From height 2 at 0.5 a step: infinite on step 3 above 3.2, so that two steps survive of ten."""
    run = climb(Climber(ladder, breaks_above=3.2), [0.5, 0.0, 1.0], 2, 0, horizon=10)
    np.testing.assert_array_equal(run.survived, [[2, 6], [10, 10], [1, 3]])
    np.testing.assert_allclose(run.fitness, [[-0.8, -0.4], [10.0, 10.0], [-0.9, -0.7]])
    np.testing.assert_array_equal(run.trajectories[0].states[:, 0], [2.0, 2.5, 3.0])
    np.testing.assert_array_equal(run.trajectories[0].controls[:, 0], [0.5, 0.5])


def test_a_trial_that_diverges_at_once_scores_least_and_leaves_no_trajectory(ladder):
    run = climb(Climber(ladder, breaks_above=3.0), [0.1], 9, 0, horizon=4)
    np.testing.assert_allclose(run.fitness, [[-1.0, 4.0]])
    assert [t.name for t in run.trajectories] == ["candidate-0-trial-1"]


@pytest.mark.parametrize("weights", [np.nan, np.inf, 1e300])
def test_a_controller_of_broken_numbers_never_gives_a_nan_fitness(ladder, weights):
    for controller, size in ((Constant(), 1), (RecurrentNetwork(hidden=1), 3)):
        run = rollout(Climber(ladder), controller, np.full((1, size), weights), Ladder(horizon=5), SEEDS)
        assert np.isfinite(run.fitness).all()


def test_clipped_steps_are_counted_and_the_rollout_continues_from_the_clipped_state(ladder):
    run = climb(Climber(ladder, state_bounds=np.array([[-1.0], [1.2]])), [0.5, 0.1, -1.0], 0, horizon=5)
    np.testing.assert_allclose(run.trajectories[0].states[:, 0], [0.0, 0.5, 1.0, 1.2, 1.2, 1.2])
    np.testing.assert_array_equal(run.clipped[:, 0], [3, 0, 4])
    np.testing.assert_array_equal(run.survived[:, 0], [5, 5, 5])
    np.testing.assert_array_equal(run.fitness[:, 0], [5, 5, 5])


def test_a_trial_that_its_task_ends_stays_unchanged_while_others_continue(ladder):
    """From 0: 0.5 ... 3.5 on step 7; from 2: 2.5, 3.0, 3.5 on step 3."""
    run = climb(Climber(ladder), [0.5, 0.0], 0, 2, horizon=8, top=3.2)
    np.testing.assert_array_equal(run.survived, [[7, 3], [8, 8]])
    np.testing.assert_array_equal(run.fitness, [[7, 3], [8, 8]])
    assert isinstance(run.task_state, LadderState)
    np.testing.assert_array_equal(run.task_state.alive, [False, False, True, True])
    assert [len(t) for t in run.trajectories] == [7, 3, 8, 8]
    np.testing.assert_array_equal(run.trajectories[1].states[:, 0], [2.0, 2.5, 3.0, 3.5])


def test_a_trial_that_is_over_is_clipped_no_more(ladder):
    """0.5 ends on 2.0 in step 4; four steps more would each be clipped."""
    run = climb(Climber(ladder, state_bounds=np.array([[-1.0], [2.1]])), [0.5, 0.1], 0, horizon=8, top=1.7)
    np.testing.assert_array_equal(run.survived[:, 0], [4, 8])
    np.testing.assert_array_equal(run.clipped[:, 0], [0, 0])


def test_a_wall_alters_the_state_of_the_next_step(ladder):
    run = climb(Climber(ladder), [0.5], 0, horizon=4, ceiling=0.8)
    np.testing.assert_allclose(run.trajectories[0].states[:, 0], [0.0, 0.5, 0.8, 0.8, 0.8])
    assert run.clipped[0, 0] == 0


def test_a_lagged_model_starts_with_its_first_state_repeated_and_neutral_controls(ladder):
    """Neutral is 0.25: 10 * 0.25 + 3 twice, then 10 * 1 + 3, then 10 * 1 + 5.5."""
    run = climb(Echo(ladder), [1.0], 3, horizon=4)
    np.testing.assert_allclose(run.trajectories[0].states[:, 0], [3.0, 5.5, 5.5, 13.0, 15.5])


def test_a_continuous_control_is_scaled_before_it_reaches_the_dynamics(ladder):
    wide = dataclasses.replace(ladder, controls=(Channel("climb", "m", 0.0, 4.0),))
    run = climb(Climber(wide), [-1.0, 0.0, 1.0], 0, horizon=1)
    np.testing.assert_allclose([t.controls[0, 0] for t in run.trajectories], [0.0, 2.0, 4.0])


@pytest.mark.parametrize("lags", [{}, {"state_lags": 2, "control_lags": 1}])
def test_a_recorded_rollout_is_the_free_run_under_its_controls(car_data, lags):
    model = make_model("linear", **lags).fit(car_data, rng=0)
    weights = np.random.default_rng(8).standard_normal((3, 78))
    run = rollout(model, RecurrentNetwork(), weights, PointToPoint(horizon=50), SEEDS, record=True, engine="reference")
    assert len({tuple(t.controls.ravel()) for t in run.trajectories}) > 1
    for trajectory in run.trajectories:
        past = np.repeat(trajectory.states[:1][None], model.n_lags + 1, axis=1)
        neutral = np.zeros((1, model.n_lags, 2))
        again = model.simulate(past, neutral, trajectory.controls[None])[0]
        np.testing.assert_allclose(trajectory.states[1:], again, rtol=1e-9, atol=1e-9)


def test_names_of_behaviours_are_in_the_order_of_states_and_controls():
    system = make_robot("emulated_car").system
    names = behaviour_names(system)
    assert names[:2] == ("forward_speed above", "forward_speed below")
    assert names[-4:] == ("drive above", "drive below", "steer above", "steer below")
    assert len(names) == 2 * (system.nx + system.nu)


def test_samples_of_behaviour_are_counted_by_hand(ladder):
    """Heights begin at 0, which is neutral, and at 3; samples are those of steps 0 and 5; 0.25 is no command."""
    assert loops.SAMPLE_EVERY == 5
    climbs, stays, descends = climb(Climber(ladder), [1.0, 0.25, -1.0], 0, 3).behaviour
    np.testing.assert_array_equal(climbs, [[0.5, 0.0, 1.0, 0.0], [1.0, 0.0, 1.0, 0.0]])
    np.testing.assert_array_equal(stays[:, 2:], 0.0)
    np.testing.assert_array_equal(descends, [[0.0, 0.5, 0.0, 1.0], [0.5, 0.5, 0.0, 1.0]])


def test_only_the_time_of_the_trial_counts_as_behaviour(ladder):
    """From 0 up by one a step: above 6.5 a trial has seven steps and samples at 0 and 5, above 2.5 three and one."""
    for top, steps, expected in ((6.5, 7, [0.5, 0.0, 1.0, 0.0]), (2.5, 3, [0.0, 0.0, 1.0, 0.0])):
        found = climb(Climber(ladder), [1.0, 0.0], 0, top=top)  # the second continues
        assert found.survived[:, 0].tolist() == [steps, 10]
        np.testing.assert_array_equal(found.behaviour[0, 0], expected)


def test_a_trial_that_diverges_has_no_behaviour(ladder):
    found = climb(Climber(ladder, breaks_above=10.2), [1.0], *range(6))
    broken = found.fitness[0] < 0.0
    assert broken.any()
    np.testing.assert_array_equal(found.behaviour[0, broken], 0.0)


def test_the_champion_of_a_human_driver_has_no_tensors_of_candidates():
    person = Champion("anna", np.empty(0), (), "min", 0, np.empty((0, 3)))
    assert person.tensors["finalists"].shape == (0, 0)
    assert person.tensors["population"].shape == (0, 0)


def test_wrong_arguments_are_refused_before_anything_runs(car, ladder):
    task = PointToPoint(horizon=5)
    with pytest.raises(ShapeError, match=r"parameters: expected shape \(any, 78\), got \(2, 77\)"):
        rollout(SluggishCar(car), RecurrentNetwork(), np.zeros((2, 77)), task, SEEDS)
    with pytest.raises(InvalidArgument, match="expected at least one trial seed, got none"):
        rollout(SluggishCar(car), RecurrentNetwork(), np.zeros((2, 78)), task, SEEDS[:0])
    with pytest.raises(IncompatibleTask, match="needs a planar body"):
        rollout(Climber(ladder), RecurrentNetwork(), np.zeros((2, 78)), task, SEEDS)
