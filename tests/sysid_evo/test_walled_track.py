"""Racing between walls, against cases worked out by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import rollout
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.randomness import trial_seeds
from sysid_evo.system import System
from sysid_evo.tasks import WalledTrack
from sysid_evo.tasks.track import draw_track, place_of
from sysid_evo.testing import check_task
from sysid_evo.testing.examples import ExampleDynamics, pendulum, switched_car

SEEDS = trial_seeds(4, 20)
IDLE = np.zeros((1, 2))


def circle(**parameters: Any) -> tuple[WalledTrack, Any]:
    """A round track of radius 2 m about (0, 2), and one trial on it."""
    task = WalledTrack(radius=2.0, width=0.6, bends=0.0, **parameters).bind(switched_car())
    return task, task.begin(SEEDS[:1])


def at(trial: Any, x: float, y: float, heading: float = 0.0) -> Any:
    from dataclasses import replace

    return replace(trial, pose=np.array([[x, y, heading]]))


def test_every_track_begins_in_the_origin_along_x_and_comes_back() -> None:
    for number in range(20):
        track = draw_track(np.random.default_rng(number), 1.5, 0.8)[None]
        here, ahead = (place_of(track, np.array([x]), np.array([0.0])) for x in (0.0, 1e-4))
        assert here.offset[0] == pytest.approx(0.0, abs=1e-8)
        assert ahead.offset[0] == pytest.approx(0.0, abs=1e-6)
        assert here.cosine[0] * ahead.sine[0] - here.sine[0] * ahead.cosine[0] > 0.0


def test_another_seed_is_another_track_and_bends_make_it_uneven() -> None:
    task = WalledTrack(bends=0.5).bind(switched_car())
    trials = task.begin(SEEDS)
    assert len(np.unique(trials.tracks.round(6), axis=0)) == len(SEEDS)
    for number, track in enumerate(trials.tracks):
        inner = task.scene(trials, number).walls[0]
        assert np.ptp(np.linalg.norm(inner - track[:2], axis=1)) > 0.1


def test_rays_of_a_round_track_are_as_long_as_geometry_says() -> None:
    """From the middle of a ring of radii 1.7 and 2.3 m: 0.3 m to either side, along the tangent sqrt(2.3^2 - 2^2)."""
    task, trial = circle(rays=3, view=math.pi)
    right, ahead, left = task.observe(trial, np.zeros((1, 3)))[0, 3:]
    assert right == pytest.approx(0.3, abs=1e-3)
    assert left == pytest.approx(0.3, abs=1e-3)
    assert ahead == pytest.approx(math.sqrt(2.3**2 - 2.0**2), abs=0.05)


def test_rays_end_at_the_walls_that_are_drawn_and_never_behind_them() -> None:
    task = WalledTrack(rays=9, view=5.0).bind(switched_car())
    trials = task.begin(SEEDS)
    seen = task.observe(trials, np.zeros((len(SEEDS), 3)))[:, 3:]
    ends = seen[:, :, None] * np.stack([np.cos(task.directions), np.sin(task.directions)], axis=1)
    for ray in range(task.rays):
        assert np.abs(place_of(trials.track, *ends[:, ray].T).offset).max() < 0.36
    short = [
        np.linalg.norm(np.concatenate(task.scene(trials, trial).walls) - ends[trial, ray], axis=1).min()
        for trial, ray in np.argwhere(seen < task.reach)
    ]
    assert np.median(short) < 0.03
    assert np.quantile(short, 0.9) < 0.1


def test_a_lap_of_a_round_track_is_its_length_and_the_way_back_counts_for_nothing() -> None:
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


def test_at_a_wall_the_body_stays_inside_and_keeps_half_of_its_speeds() -> None:
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


def test_a_collision_may_end_the_trial() -> None:
    task, trial = circle(collision="end")
    state = np.array([[2.0, 0.0, 0.0]])
    ended, after = task.advance(at(trial, 0.0, -0.2, -math.pi / 2.0), state, state, control=IDLE)
    assert not ended.alive[0]
    assert after is state


@pytest.mark.parametrize(
    "parameters", [{}, {"collision": "end", "rays": 1, "width": 0.4}, {"rays": 7, "view": 4.0, "bends": 0.9}]
)
def test_the_contract_is_kept_and_the_compiled_form_is_the_reference(parameters: dict[str, Any]) -> None:
    check_task("walled_track", switched_car(), horizon=150, **parameters)


def test_in_single_precision_the_same_way_is_driven() -> None:
    task, network = WalledTrack(horizon=60), RecurrentNetwork(hidden=3)
    parameters = 0.3 * np.random.default_rng(2).standard_normal((5, network.bind(8, 2).n_parameters))
    found, exact = (
        rollout(ExampleDynamics(switched_car()), network, parameters, task, SEEDS, engine=engine)
        for engine in ("float32", "reference")
    )
    assert exact.fitness.max() > 0.2
    assert np.median(np.abs(found.fitness - exact.fitness)) < 1e-3


@pytest.mark.parametrize(
    "wrong",
    [{"width": 0.1}, {"width": 2.0}, {"bends": 1.5}, {"collision": "bounce"}, {"rays": 0}, {"reach": 0.0}, {"view": 7}],
)
def test_sizes_that_make_no_track_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InvalidArgument, match="walled_track: expected"):
        WalledTrack(**wrong)


@pytest.mark.parametrize("system", [pendulum()])
def test_a_system_that_does_not_drive_is_refused(system: System) -> None:
    with pytest.raises(IncompatibleTask, match="needs a planar body"):
        WalledTrack().bind(system)
