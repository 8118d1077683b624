"""Tasks of a rigid body in space against cases worked out by hand, and against the contract of tasks."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks import PointToPoint
from sysid_evo.tasks.in_space import Hover
from sysid_evo.tasks.references import TrackReference
from sysid_evo.testing import check_task
from sysid_evo.testing.examples import continuous_car, drone

IDLE = np.zeros((1, 4))
SEEDS = trial_seeds(5, 3)


def flying(speeds=(0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0), up=(0.0, 0.0, 1.0)):
    return np.array([[*speeds, *rates, *up]])


@pytest.mark.parametrize("frame", ["ENU", "NED"])
@pytest.mark.parametrize(
    ("name", "parameters"),
    [("hover", {}), ("point_to_point", {"waypoint_radius": 1.0}), ("track_reference", {"kind": "helix"})],
)
def test_the_tasks_keep_the_contract_of_tasks_in_both_frames(frame, name, parameters):
    check_task(name, drone(frame), horizon=40, **parameters)


def test_waypoints_fill_a_cube_and_flying_through_one_counts_it():
    task = PointToPoint(horizon=50, arena_radius=2.0, waypoint_radius=0.3).bind(drone())
    begun = task.begin(trial_seeds(1, 200))
    assert np.abs(begun.waypoints).max() <= 2.0
    quarters = np.quantile(begun.waypoints, [0.25, 0.75], axis=(0, 1))
    np.testing.assert_allclose(quarters, [[-1.0] * 3, [1.0] * 3], atol=0.06)
    trial = replace(begun.only(0), waypoints=np.array([[[0.0, 0.0, 0.49], *[[9.0, 9.0, 9.0]] * 50]]))
    passed = []
    for _ in range(30):  # 0.02 m a step along z: within 0.3 m of (0, 0, 0.49) from the tenth on
        trial, _ = task.advance(trial, flying((0.0, 0.0, 1.0)), flying((0.0, 0.0, 1.0)), control=IDLE)
        passed.append(task.fitness(trial)[0])
    assert passed.index(1.0) + 1 == 10
    assert passed[-1] == 1.0
    assert task.hide_future(trial).goal.tolist() == [[9.0, 9.0, 9.0]]


def test_the_way_is_observed_along_the_axes_of_the_body():
    task = Hover().bind(drone())
    attitude = Rotation.from_rotvec([0.4, -0.9, 2.0])
    trial = task.begin(SEEDS[:1])
    pose = np.array([[1.0, -2.0, 0.5, *attitude.as_quat()[[3, 0, 1, 2]]]])
    seen = task.observe(replace(trial, pose=pose), flying((1.0, 2.0, 3.0), (4.0, 5.0, 6.0)))[0]
    np.testing.assert_allclose(seen[:10], [1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(seen[10:], attitude.inv().apply(trial.goal[0] - pose[0, :3]), atol=1e-12)


@pytest.mark.parametrize(("frame", "level"), [("ENU", 1.0), ("NED", -1.0)])
def test_a_body_that_turns_over_ends_its_trial(frame, level):
    task = Hover().bind(drone(frame))
    trial = task.begin(SEEDS[:1])
    leaning = flying(up=(0.99, 0.0, 0.14 * level))
    assert task.advance(trial, leaning, leaning, control=IDLE)[0].alive.all()
    over = flying(up=(0.99, 0.0, -0.14 * level))
    assert not task.advance(trial, leaning, over, control=IDLE)[0].alive.any()


def test_hovering_at_the_point_has_full_score_and_one_tolerance_away_half():
    for off, expected in ((0.0, 100.0), (0.2, 50.0)):
        task = Hover(spread=0.0, tolerance=0.2, horizon=10).bind(drone())
        trial = task.begin(SEEDS[:1])
        trial = replace(trial, pose=trial.pose + np.array([[0.0, off, 0.0, 0.0, 0.0, 0.0, 0.0]]))
        for _ in range(10):
            trial, _ = task.advance(trial, flying(), flying(), control=IDLE)
        assert task.fitness(trial)[0] == pytest.approx(expected)
        assert task.scene(trial, 0).markers.tolist() == [[0.0, 0.0, 0.0]]


@pytest.mark.parametrize("kind", ["helix", "figure_of_eight"])
def test_a_path_begins_at_the_start_and_following_it_has_full_score(kind):
    made = TrackReference(kind=kind, low=-2.0, high=2.0, horizon=200, period=3.0)
    task = made.bind(drone())
    trial = task.begin(SEEDS)
    np.testing.assert_array_equal(trial.waypoints[:, 0], 0.0)
    extent = np.ptp(trial.waypoints[:, :, :2], axis=1)
    assert 1.5 < extent.min() < extent.max() < 4.2
    assert np.ptp(trial.waypoints[:, :, 2], axis=1).max() <= 2.0
    assert not np.array_equal(trial.waypoints[0], trial.waypoints[1])
    for k in range(200):
        there = np.concatenate([trial.waypoints[:, k + 1], trial.pose[:, 3:]], axis=1)
        trial, _ = task.advance(trial, trial.state, trial.state, control=np.zeros((3, 4)), pose=there)
    np.testing.assert_allclose(task.fitness(trial), 100.0)
    np.testing.assert_array_equal(made.scene(trial, 1).walls[0], trial.waypoints[1])


def test_a_slow_body_is_warned_of_waypoints_that_are_far_apart():
    task = PointToPoint(arena_radius=10.0).bind(drone())
    farthest = np.full(9, 0.5)
    assert "covers 5 m in a trial" in task.feasibility_warnings(farthest)[0]
    assert task.feasibility_warnings(10.0 * farthest) == ()


def test_what_does_not_fit_is_refused_with_what_is_needed():
    with pytest.raises(IncompatibleTask, match=r"hover needs a rigid body in space .*made-up car has .*planar_body"):
        Hover().bind(continuous_car())
    with pytest.raises(IncompatibleTask, match=r"track_reference\(kind=helix\) needs a rigid body"):
        TrackReference(kind="helix").bind(continuous_car())
    with pytest.raises(InvalidArgument, match="expected no channels, effort or start_spread"):
        TrackReference(kind="helix", effort=0.1).bind(drone())
    with pytest.raises(InvalidArgument, match="expected tolerance > 0 m, got 0"):
        Hover(tolerance=0.0)
