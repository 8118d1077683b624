"""Racing between walls, against cases worked out by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sysid_evo.engine import rollout
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.predictive_control import Predictive
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks.track_geometry import draw_track, place_of, wall
from sysid_evo.tasks.walled_track import WalledTrack
from sysid_evo.testing.examples import ExampleDynamics, pendulum, switched_car

SEEDS = trial_seeds(4, 20)
IDLE = np.zeros((1, 2))


def circle(**parameters):
    """A round track of radius 2 m about (0, 2), and one trial on it."""
    task = WalledTrack(radius=2.0, width=0.6, bends=0.0, **parameters).bind(switched_car())
    return task, task.begin(SEEDS[:1])


def at(trial, x, y, heading=0.0):
    return replace(trial, pose=np.array([[x, y, heading]]))


def test_every_track_begins_in_the_origin_along_x_and_comes_back():
    for number in range(20):
        track = draw_track(np.random.default_rng(number), 1.5, 0.8)[None]
        here, ahead = (place_of(track, np.array([x]), np.array([0.0])) for x in (0.0, 1e-4))
        assert here.offset[0] == pytest.approx(0.0, abs=1e-8)
        assert ahead.offset[0] == pytest.approx(0.0, abs=1e-6)
        assert here.cosine[0] * ahead.sine[0] - here.sine[0] * ahead.cosine[0] > 0.0


def test_another_seed_is_another_track_and_bends_make_it_uneven():
    task = WalledTrack(bends=0.5).bind(switched_car())
    trials = task.begin(SEEDS)
    assert len(np.unique(trials.tracks.round(6), axis=0)) == len(SEEDS)
    for number, track in enumerate(trials.tracks):
        inner = task.scene(trials, number).walls[0]
        assert np.ptp(np.linalg.norm(inner - track[:2], axis=1)) > 0.1


def test_rays_of_a_circular_track_have_the_length_from_geometry():
    """From the middle of a ring of radii 1.7 and 2.3 m: 0.3 m to either side, along the tangent sqrt(2.3^2 - 2^2)."""
    task, trial = circle(rays=3, view=math.pi)
    right, ahead, left = task.observe(trial, np.zeros((1, 3)))[0, 3:]
    assert right == pytest.approx(0.3, abs=1e-6)
    assert left == pytest.approx(0.3, abs=1e-6)
    assert ahead == pytest.approx(math.sqrt(2.3**2 - 2.0**2), abs=1e-6)


def test_a_ray_that_grazes_the_inner_wall_of_a_round_track_goes_on_to_the_outer_one():
    """In (0, 0) the inner circle of 1.7 m about (0, 2) is seen at asin(1.7 / 2) from its centre, to the left."""
    task, trial = circle(rays=1, reach=3.0)
    tangent = math.pi / 2.0 - math.asin(1.7 / 2.0)
    seen = [task.observe(at(trial, 0.0, 0.0, tangent + by), np.zeros((1, 3)))[0, 3] for by in (-0.01, 0.01)]
    ways = np.array([tangent - 0.01, tangent + 0.01])
    past = 2.0 * np.sin(ways) + np.sqrt(4.0 * np.sin(ways) ** 2 - (2.0**2 - 2.3**2))
    onto = 2.0 * np.sin(ways) - np.sqrt(np.maximum(4.0 * np.sin(ways) ** 2 - (2.0**2 - 1.7**2), 0.0))
    np.testing.assert_allclose(seen, [past[0], onto[1]], atol=1e-6)


@pytest.mark.parametrize("bends", [0.5, 1.0])
def test_a_ray_ends_at_the_first_wall_in_its_way_also_where_the_track_is_bent(bends):
    """Against walking along every ray in steps of 4 mm."""
    task = WalledTrack(rays=9, view=5.0, bends=bends).bind(switched_car())
    trials = task.begin(trial_seeds(7, 60))
    trials = replace(trials, pose=np.random.default_rng(1).uniform(-0.15, 0.15, (60, 3)))
    seen = task.observe(trials, np.zeros((60, 3)))[:, 3:]
    walked = np.arange(0.0, task.reach, 0.004)
    for ray, direction in enumerate(task.directions):
        angle = trials.pose[:, 2] + direction
        ways = [
            np.abs(place_of(trials.track, trials.pose[:, 0] + far * np.cos(angle),
                            trials.pose[:, 1] + far * np.sin(angle)).offset) < 0.35
            for far in walked
        ]  # fmt: skip
        free = 0.004 * np.logical_and.accumulate(ways).sum(axis=0)
        np.testing.assert_allclose(seen[:, ray], np.minimum(free, task.reach), atol=0.005)


def test_behind_a_wall_nothing_is_seen():
    task, trial = circle(rays=5)
    assert not task.observe(at(trial, 0.0, -0.4, 0.3), np.zeros((1, 3)))[0, 3:].any()


def test_the_curvature_of_the_centre_line_lies_between_the_bounds_that_a_track_holds():
    for number in range(10):
        track = draw_track(np.random.default_rng(number), 1.5, 0.8)
        x, y = wall(track, 0.0)[:-1].T
        away = np.hypot(np.roll(x, -1) - x, np.roll(y, -1) - y)
        heading = np.arctan2(np.roll(y, -1) - y, np.roll(x, -1) - x)
        turned = (np.diff(heading, append=heading[:1]) + math.pi) % (2.0 * math.pi) - math.pi
        curvature = 2.0 * turned / (away + np.roll(away, -1))
        assert track[-2] == pytest.approx(curvature.min(), abs=0.02)
        assert track[-1] == pytest.approx(curvature.max(), abs=0.02)


def test_rays_end_at_the_walls_that_are_drawn_and_never_behind_them():
    task = WalledTrack(rays=9, view=5.0).bind(switched_car())
    trials = task.begin(SEEDS)
    seen = task.observe(trials, np.zeros((len(SEEDS), 3)))[:, 3:]
    ends = seen[:, :, None] * np.stack([np.cos(task.directions), np.sin(task.directions)], axis=1)
    for ray in range(task.rays):
        assert np.abs(place_of(trials.track, *ends[:, ray].T).offset).max() < 0.3501
    short = [
        np.linalg.norm(np.concatenate(task.scene(trials, trial).walls) - ends[trial, ray], axis=1).min()
        for trial, ray in np.argwhere(seen < task.reach)
    ]
    assert np.max(short) < 0.04  # the points of a drawn wall are 6 cm apart


def test_a_lap_of_a_round_track_is_its_length_and_the_way_back_counts_for_nothing():
    task, trial = circle()
    state = np.zeros((1, 3))
    for angle in np.linspace(0.0, 2.0 * math.pi, 101)[1:]:
        pose = np.array([[2.0 * math.sin(angle), 2.0 - 2.0 * math.cos(angle), angle]])
        trial, _ = task.advance(trial, state, state, control=IDLE, pose=pose)
    assert task.fitness(trial)[0] == pytest.approx(4.0 * math.pi, rel=1e-6)
    assert task.measures(trial)["laps"][0] == pytest.approx(1.0)
    back, _ = task.advance(trial, state, state, control=IDLE, pose=np.array([[-1.0, 0.3, 0.0]]))
    assert back.progress[0] < trial.progress[0]
    assert task.fitness(back)[0] == task.fitness(trial)[0]


def test_at_a_wall_the_body_stays_inside_and_keeps_half_of_its_speeds():
    """The room is 0.3 - 0.07 m either side; at 2 m/s to the right 0.1 m a step."""
    task, trial = circle()
    trial = at(trial, 0.0, -0.2, -math.pi / 2.0)
    state = np.array([[2.0, 0.4, 3.0]])
    moved, after = task.advance(trial, state, state, control=IDLE)
    assert np.linalg.norm(moved.pose[0, :2] - [0.0, 2.0]) == pytest.approx(2.23, abs=1e-6)
    np.testing.assert_allclose(after, [[1.0, 0.2, 3.0]])
    assert task.measures(moved)["steps at a wall"][0] == 1.0
    free, same = task.advance(at(trial, 0.0, 0.0), state, state, control=IDLE)
    assert same is state
    assert free.touches[0] == 0


def test_potential_is_higher_in_a_good_position_and_earlier_distance_does_not_count():
    task, trial = circle()
    poses = [(0.0, 0.0, 0.0), (0.0, 0.15, 0.0), (0.0, 0.0, math.pi / 2.0), (0.0, 0.0, math.pi), (2.0, 2.0, math.pi / 2)]
    promised = [task.potential(at(trial, *pose), np.zeros((1, 3)))[0] for pose in poses]
    np.testing.assert_allclose(promised, [0.1, 0.075, 0.05, 0.0, 0.1], atol=1e-8)
    back = replace(trial, progress=np.array([3.0]), furthest=np.array([5.0]))
    assert task.fitness(task.hide_future(back))[0] == 3.0
    assert task.fitness(back)[0] == 5.0


def test_a_controller_that_plans_ahead_comes_round_without_evolution():
    body = ExampleDynamics(switched_car())
    task = WalledTrack(horizon=40)
    planned = rollout(body, Predictive(model=body, horizon=12, samples=24), np.zeros((1, 2)), task, SEEDS[:3])
    assert planned.fitness.min() > 1.5
    assert planned.task_state.touches.max() < 10


def test_a_body_that_rests_at_a_wall_does_not_touch_it():
    """0.3 - 0.07 m from the centre line, to within the rounding of single precision."""
    task, trial = circle()
    rest, _ = task.advance(at(trial, 0.0, -0.23 - 5e-7), np.zeros((1, 3)), np.zeros((1, 3)), control=IDLE)
    pushed, _ = task.advance(at(trial, 0.0, -0.23 - 5e-6), np.zeros((1, 3)), np.zeros((1, 3)), control=IDLE)
    assert (rest.touches[0], pushed.touches[0]) == (0, 1)


def test_a_collision_may_end_the_trial():
    task, trial = circle(collision="end")
    state = np.array([[2.0, 0.0, 0.0]])
    ended, after = task.advance(at(trial, 0.0, -0.2, -math.pi / 2.0), state, state, control=IDLE)
    assert not ended.alive[0]
    assert after is state


@pytest.mark.parametrize(
    "wrong",
    [{"width": 0.1}, {"width": 2.0}, {"bends": 1.5}, {"collision": "bounce"}, {"rays": 0}, {"reach": 0.0}, {"view": 7}],
)
def test_sizes_that_make_no_track_and_systems_that_do_not_drive_are_refused(wrong):
    with pytest.raises(InvalidArgument, match="walled_track: expected"):
        WalledTrack(**wrong)
    with pytest.raises(IncompatibleTask, match="needs a planar body"):
        WalledTrack().bind(pendulum())
