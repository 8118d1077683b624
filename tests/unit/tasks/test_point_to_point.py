"""The paper's task against cases worked out by hand."""

import dataclasses

import numpy as np
import pytest

from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.motion import PlanarBody
from sysid_evo.randomness import trial_seeds
from sysid_evo.system import Channel, System
from sysid_evo.tasks import PointToPoint
from tests.fixtures.by_hand import Ladder

IDLE = np.zeros((1, 2))


def seeds_of(*values):
    return np.array(values, dtype=np.uint64)


def started(car, waypoints, **parameters):
    """The task on the toy car and one trial with known waypoints (the last one repeats)."""
    task = PointToPoint(**parameters).bind(car)
    begun = task.begin(seeds_of(1))
    padded = waypoints + [waypoints[-1]] * (task.horizon + 1 - len(waypoints))
    return task, dataclasses.replace(begun, waypoints=np.array([padded]))


def test_driving_straight_past_known_waypoints_counts_them_when_they_are_near(car):
    """At 1 m/s, 0.05 m a step: (1.02, 0) is within 0.3 m from x = 0.75, (1.5, 0.2) from x = 1.30 m."""
    task, trial = started(car, [(1.02, 0.0), (1.5, 0.2), (5.0, 5.0)])
    state = np.array([[1.0, 0.0, 0.0]])
    passed = []
    for _ in range(40):
        trial, state = task.advance(trial, state, state, control=IDLE)
        passed.append(int(task.fitness(trial)[0]))
    assert passed.index(1) + 1 == 15
    assert passed.index(2) + 1 == 26
    assert passed[-1] == 2
    np.testing.assert_allclose(trial.pose, [[2.0, 0.0, 0.0]], atol=1e-12)


def test_at_most_one_waypoint_is_passed_in_a_step(car):
    task, trial = started(car, [(0.0, 0.0)], horizon=5)
    rest = np.zeros((1, 3))
    for k in range(5):
        trial, _ = task.advance(trial, rest, rest, control=IDLE)
        assert task.fitness(trial)[0] == k + 1
    assert np.isfinite(task.observe(trial, rest)).all()


def test_the_waypoint_radius_counts_from_the_centre_of_the_body(car):
    rest = np.zeros((1, 3))
    for distance, passed in ((0.29, 1), (0.31, 0)):
        for direction in (0.0, 2.0, 4.0):
            task, trial = started(car, [(distance * np.cos(direction), distance * np.sin(direction)), (9.0, 9.0)])
            assert task.fitness(task.advance(trial, rest, rest, control=IDLE)[0])[0] == passed


@pytest.mark.parametrize(
    "heading, waypoint, angle",
    [
        (0.0, (1.0, 0.0), 0.0),
        (0.0, (0.0, 1.0), np.pi / 2),  # to the left
        (0.0, (0.0, -1.0), -np.pi / 2),  # to the right
        (0.0, (-1.0, 0.0), np.pi),  # behind
        (np.pi / 2, (0.0, 1.0), 0.0),
        (np.pi / 2, (-1.0, 0.0), np.pi / 2),
        (3.0, (-1.0, -0.2), 0.33899),  # across the cut of the arctangent: -2.94419 - 3 + 2 pi
        (20.0 * np.pi, (1.0, 1.0), np.pi / 4),
    ],
)
def test_a_waypoint_to_the_left_has_a_positive_angle(car, heading, waypoint, angle):
    task, trial = started(car, [waypoint])
    trial = dataclasses.replace(trial, pose=np.array([[0.0, 0.0, heading]]))
    assert task.observe(trial, np.zeros((1, 3)))[0, 3] == pytest.approx(angle, abs=1e-5)


def test_a_controller_is_given_bias_speed_yaw_rate_angle_and_distance(car):
    task, trial = started(car, [(4.0, 6.0)])
    trial = dataclasses.replace(trial, pose=np.array([[1.0, 2.0, 0.1]]))
    observed = task.observe(trial, np.array([[1.5, -0.3, 0.7]]))
    np.testing.assert_allclose(observed, [[1.0, 1.5, 0.7, np.arctan2(4.0, 3.0) - 0.1, 5.0]])
    names = [channel.name for channel in task.observations]
    assert names == ["bias", "forward_speed", "yaw_rate", "waypoint_angle", "waypoint_distance"]


def test_the_roles_of_the_motion_say_which_states_are_observed():
    system = System(
        ("omega", "temperature", "vx"), (Channel("u", levels=(-1, 0, 1)),), 0.05,
        PlanarBody(forward="vx", lateral=None, yaw_rate="omega"),
    )  # fmt: skip
    task = PointToPoint().bind(system)
    trial = task.begin(seeds_of(3))
    np.testing.assert_array_equal(task.observe(trial, np.array([[0.5, 99.0, 2.0]]))[0, 1:3], [2.0, 0.5])
    state = np.array([[0.0, 99.0, 2.0]])
    moved, _ = task.advance(trial, state, state, control=IDLE)
    np.testing.assert_allclose(moved.pose, [[0.1, 0.0, 0.0]])


def test_a_measured_pose_takes_the_place_of_the_motion(car):
    task = PointToPoint(horizon=20).bind(car)
    trial, rest = task.begin(seeds_of(3)), np.zeros((1, 3))
    there = np.array([[*trial.waypoint[0], 0.5]])
    seen, _ = task.advance(trial, rest, rest, control=IDLE, pose=there)
    np.testing.assert_array_equal(seen.pose, there)
    assert task.fitness(seen)[0] == 1.0


def test_a_trial_begins_at_rest_in_the_origin_heading_along_x(car):
    trial = PointToPoint(horizon=20).bind(car).begin(seeds_of(1, 2, 3))
    np.testing.assert_array_equal(trial.state, np.zeros((3, 3)))
    np.testing.assert_array_equal(trial.pose, np.zeros((3, 3)))
    assert trial.alive.all()
    assert trial.waypoints.shape == (3, 21, 2)


def test_a_seed_always_gives_the_same_waypoints_and_another_one_others(car):
    task = PointToPoint(horizon=30).bind(car)
    together = task.begin(seeds_of(5, 6, 2**63 + 1)).waypoints
    for i, seed in enumerate((5, 6, 2**63 + 1)):
        np.testing.assert_array_equal(task.begin(seeds_of(seed)).waypoints[0], together[i])
    assert len(np.unique(together.round(12))) == together.size


def test_waypoints_are_uniform_over_the_disc(car):
    task = PointToPoint(arena_radius=1.5).bind(car)
    waypoints = task.begin(trial_seeds(1, 40)).waypoints.reshape(-1, 2)
    n = len(waypoints)
    radius = np.hypot(*waypoints.T)
    assert radius.max() <= 1.5
    # the share of the area within r is (r / R)^2; a quantile of n samples has a deviation of sqrt(p (1 - p) / n)
    share = np.array([0.05, 0.25, 0.5, 0.75, 0.95])
    quantiles = np.quantile((radius / 1.5) ** 2, share)
    assert (np.abs(quantiles - share) < 4.0 * np.sqrt(share * (1 - share) / n)).all()
    direction = waypoints / radius[:, None]
    for order in (1, 2):  # the mean of n random unit vectors is shorter than 4 / sqrt(n)
        angle = order * np.arctan2(direction[:, 1], direction[:, 0])
        assert np.hypot(np.cos(angle).mean(), np.sin(angle).mean()) < 4.0 / np.sqrt(n)


def test_a_system_without_a_planar_motion_is_refused_by_the_roles_it_lacks():
    system = System((Channel("x"),), (Channel("u"),), dt=0.05, name="pendulum")
    reason = r"needs a planar body \(roles forward and yaw_rate\); pendulum has no motion"
    with pytest.raises(IncompatibleTask, match=reason):
        PointToPoint().bind(system)


@pytest.mark.parametrize("parameters", [{"horizon": 0}, {"waypoint_radius": 0.0}, {"arena_radius": -1.0}])
def test_impossible_tasks_are_refused(parameters):
    with pytest.raises(InvalidArgument, match="expected horizon >= 1 and radii > 0, got"):
        PointToPoint(**parameters)


def test_tiling_puts_the_candidate_first_and_the_trial_second(car):
    task = PointToPoint(horizon=10).bind(car)
    trials = task.begin(seeds_of(1, 2, 3))
    tiled = trials.tile(2)
    np.testing.assert_array_equal(tiled.trial, [0, 1, 2, 0, 1, 2])
    assert tiled.waypoints is trials.waypoints
    assert tiled.pose.shape == (6, 3)
    np.testing.assert_array_equal(tiled.waypoint[:3], trials.waypoint)
    np.testing.assert_array_equal(tiled.waypoint[3:], trials.waypoint)


def test_keeping_takes_the_new_state_only_of_trials_that_go_on(car):
    task = PointToPoint(horizon=10).bind(car)
    old = task.begin(seeds_of(1, 2, 3))
    new = dataclasses.replace(old, pose=old.pose + 1.0, passed=old.passed + 5)
    kept = old.updated_where(new, np.array([True, False, True]))
    np.testing.assert_array_equal(kept.passed, [5, 0, 5])
    np.testing.assert_array_equal(kept.pose[:, 0], [1.0, 0.0, 1.0])
    assert kept.passed.dtype == old.passed.dtype


def test_the_scene_of_a_trial_is_what_was_passed_and_the_next_waypoint(car, ladder):
    task = PointToPoint(horizon=50, waypoint_radius=0.4, arena_radius=2.0).bind(car)
    began = task.begin(seeds_of(3, 8)).tile(2)
    state = dataclasses.replace(began, passed=np.array([0, 2, 1, 4]))
    scenes = [task.scene(state, trial) for trial in range(4)]
    assert [len(scene.markers) for scene in scenes] == [1, 3, 2, 5]
    assert [scene.reached for scene in scenes] == [0, 2, 1, 4]
    np.testing.assert_array_equal(scenes[3].markers, began.waypoints[1, :5])
    for trial, scene in enumerate(scenes):
        np.testing.assert_array_equal(scene.next_marker, state.waypoint[trial])
        assert (scene.radius, scene.extent) == (0.4, 2.0)
    task = Ladder().bind(ladder)  # without places
    scene = task.scene(task.begin(seeds_of(1)), 0)
    assert scene.markers.shape == (0, 2)
    assert scene.next_marker is None


def test_distances_of_a_large_arena_and_the_speed_of_a_rolling_start_are_large_observations(car):
    assert PointToPoint().bind(car).observation_sizes().tolist() == [1.0] * 5
    assert PointToPoint(arena_radius=0.5).bind(car).observation_sizes().tolist() == [1.0] * 5
    rolling = System(
        [Channel("forward_speed", neutral=6.0), Channel("lateral_speed"), Channel("yaw_rate")],
        car.controls, car.dt, PlanarBody(), "rolling",
    )  # fmt: skip
    assert PointToPoint(arena_radius=30.0).bind(rolling).observation_sizes().tolist() == [1.0, 6.0, 1.0, 1.0, 20.0]
