"""Two bodies in one race, against cases worked out by hand and against one body alone."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sysid_evo.controllers import LinearFeedback, RecurrentNetwork
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import rollout
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_robot
from sysid_evo.rivals import Race, RaceState, TwoBodies, TwoDrivers, one_body, two_bodies
from sysid_evo.tasks import Duel, PointToPoint, WalledTrack
from sysid_evo.testing import check_task
from sysid_evo.testing.examples import ExampleDynamics, switched_car
from sysid_evo.wrappers import DelayedEstimate

SEEDS = trial_seeds(4, 12)
STILL, IDLE = np.zeros((1, 6)), np.zeros((1, 4))


def ring(**parameters: Any) -> tuple[Race, RaceState]:
    """A race on a round track of radius 2 m about (0, 2), and one trial of it."""
    race = Race(Duel(radius=2.0, width=0.6, bends=0.0, **parameters)).bind(two_bodies(switched_car()))
    return race, race.begin(SEEDS[:1])


def placed(state: RaceState, own: tuple[float, float, float], rival: tuple[float, float, float]) -> RaceState:
    first, second = (replace(one, pose=np.array([pose])) for one, pose in ((state.own, own), (state.rival, rival)))
    return state.of(first, second, state.contacts)


def test_the_system_of_two_bodies_holds_both_and_is_taken_apart_again() -> None:
    both = two_bodies(switched_car())
    assert both.nx == 2 * switched_car().nx
    assert both.control_names == ("drive", "steer", "rival_drive", "rival_steer")
    assert one_body(both) == switched_car()
    with pytest.raises(IncompatibleTask, match="two bodies"):
        Race(Duel()).bind(switched_car())


def test_they_begin_side_by_side_on_the_same_track_and_sides_change_with_the_seed() -> None:
    race, _ = ring()
    begun = race.begin(SEEDS)
    np.testing.assert_array_equal(begun.own.tracks, begun.rival.tracks)
    np.testing.assert_allclose(np.abs(begun.own.pose[:, 1]), 0.15)
    np.testing.assert_allclose(begun.own.pose[:, 1], -begun.rival.pose[:, 1])
    assert set(np.sign(begun.own.pose[:, 1])) == {1.0, -1.0}


def test_each_sees_where_the_other_is() -> None:
    """A rival 0.3 m along x and 0.4 m along y; the body looks along y, the rival along x."""
    race, state = ring(reach=0.35)
    shown = race.observe(placed(state, (0.0, 0.0, math.pi / 2.0), (0.3, 0.4, 0.0)), STILL)[0]
    own, rival = np.split(shown, 2)
    np.testing.assert_allclose(own[-2:], [0.35, -0.3], atol=1e-12)
    np.testing.assert_allclose(rival[-2:], [-0.3, -0.35], atol=1e-12)


def test_who_touches_is_slowed_and_the_other_too() -> None:
    """Two bodies of 0.07 m touch within 0.14 m; both keep 0.8 of their speeds, not of their yaw rates."""
    race, state = ring()
    after = np.array([[1.0, 0.5, 2.0, -1.0, 0.0, 3.0]])
    advanced, near = race.advance(placed(state, (0.0, 0.1, 0.0), (0.0, 0.0, 0.0)), STILL, 0.0 * after, control=IDLE)
    assert advanced.contacts[0] == 1
    _, near = race.advance(placed(state, (0.0, 0.0, 0.0), (0.12, 0.0, math.pi)), after, after, control=IDLE)
    np.testing.assert_allclose(near, [[0.8, 0.4, 2.0, -0.8, 0.0, 3.0]])
    apart, free = race.advance(placed(state, (0.0, -0.1, 0.0), (0.0, 0.1, 0.0)), STILL, after, control=IDLE)
    np.testing.assert_array_equal(free, after)
    assert apart.contacts[0] == 0


def test_fitness_is_the_lead_and_no_more_than_ten_metres() -> None:
    race, state = ring()
    for own, rival, lead in ((5.0, 3.0, 2.0), (1.0, 4.5, -3.5), (50.0, 0.0, 10.0), (0.0, 50.0, -10.0)):
        ways = (replace(one, furthest=np.array([way])) for one, way in ((state.own, own), (state.rival, rival)))
        assert race.fitness(state.of(*ways, state.contacts))[0] == lead


def test_two_bodies_are_one_body_twice() -> None:
    car = make_robot("emulated_car").dynamics
    assert car is not None
    two, rng = TwoBodies(car), np.random.default_rng(0)
    states, controls = rng.uniform(-1.0, 1.0, (5, two.n_lags + 1, 6)), rng.uniform(-1.0, 1.0, (5, two.n_lags, 4))
    draws, noise = rng.standard_normal((5, two.n_draws)), rng.standard_normal((5, two.n_noise))
    carry = two.step(two.start(states, controls, draws), controls[:, 0], noise)
    parts = zip(*(np.split(given, 2, axis=-1) for given in (states, controls, draws, noise)), strict=True)
    alone = [car.step(car.start(x, u, drawn), u[:, 0], some) for x, u, drawn, some in parts]
    np.testing.assert_array_equal(carry[:, :3], alone[0][:, :3])
    np.testing.assert_array_equal(carry[:, 3:6], alone[1][:, :3])
    rest = car.n_carry - 3
    np.testing.assert_array_equal(carry[:, 6 : 6 + rest], alone[0][:, 3:])
    np.testing.assert_array_equal(carry[:, 6 + rest :], alone[1][:, 3:])


@pytest.mark.parametrize("car", [ExampleDynamics(switched_car()), make_robot("emulated_car").dynamics])
def test_the_compiled_race_is_the_reference(car: Dynamics) -> None:
    race, drivers = Race(Duel(horizon=60)), TwoDrivers(RecurrentNetwork(hidden=3), LinearFeedback())
    two = TwoBodies(car)
    n = drivers.bind_to(race.bind(two.system)).n_parameters
    parameters = np.random.default_rng(0).standard_normal((5, n))
    exact, fast = (
        rollout(two, drivers, parameters, race, SEEDS, engine=engine, record=True)
        for engine in ("reference", "float64")
    )
    np.testing.assert_allclose(fast.fitness, exact.fitness, atol=1e-8)
    for one, other in zip(exact.trajectories, fast.trajectories, strict=True):
        np.testing.assert_allclose(other.states, one.states, atol=1e-8)
        assert one.pose is not None
        np.testing.assert_allclose(other.pose[:, :2], one.pose[:, :2], atol=1e-8)
    for name in ("contacts", "own.touches", "rival.touches"):
        counted = []
        for run in (exact, fast):
            found: Any = run.task_state
            for part in name.split("."):
                found = getattr(found, part)
            counted.append(found)
        np.testing.assert_array_equal(*counted)
    assert exact.task_state.contacts.sum() > 0


def test_in_a_race_everybody_drives_by_its_own_parameters_and_sees_what_it_knows() -> None:
    """Bodies that are points never touch: each comes as far as it comes alone from where it begins."""
    car, law = ExampleDynamics(switched_car()), RecurrentNetwork(hidden=3)
    race = Race(Duel(horizon=60, body=1e-9))
    drivers = TwoDrivers(law, law, tasks=(WalledTrack(), WalledTrack()))
    parameters = np.random.default_rng(3).standard_normal((4, 2 * 3 * (8 + 3 + 2)))
    raced = rollout(TwoBodies(car), drivers, parameters, race, SEEDS, engine="reference").task_state

    class Aside(WalledTrack):
        """Begins where one of the two does."""

        def begin(self, seeds: Any) -> Any:
            begun = race.bind(two_bodies(switched_car())).begin(seeds)
            return getattr(begun, self.whose)

        whose = "own"

    for whose, own in (("own", parameters[:, :39]), ("rival", parameters[:, 39:])):
        task = Aside(horizon=60, body=1e-9)
        task.whose = whose
        alone = rollout(car, law, own, task, SEEDS, engine="reference").fitness
        np.testing.assert_allclose(getattr(raced, whose).furthest.reshape(4, -1), alone, atol=1e-9)


def test_alone_a_duel_is_the_walled_track_with_nobody_in_sight() -> None:
    duel, track = Duel().bind(switched_car()), WalledTrack().bind(switched_car())
    begun = duel.begin(SEEDS)
    shown = duel.observe(begun, begun.state)
    np.testing.assert_array_equal(shown[:, :-2], track.observe(track.begin(SEEDS), begun.state))
    np.testing.assert_array_equal(shown[:, -2:], np.tile([2.0, 0.0], (len(SEEDS), 1)))


def test_a_duel_keeps_the_contract_of_a_task() -> None:
    check_task("duel", switched_car(), horizon=60)


def test_what_cannot_race_is_told() -> None:
    two, law = TwoBodies(ExampleDynamics(switched_car())), RecurrentNetwork(hidden=2)
    with pytest.raises(IncompatibleTask, match="need a race"):
        TwoDrivers(law, law).bind_to(PointToPoint().bind(switched_car()))
    with pytest.raises(IncompatibleTask, match="PointToPoint cannot drive in this race"):
        TwoDrivers(law, law, tasks=(PointToPoint(), None)).bind_to(Race(Duel()).bind(two.system))
    with pytest.raises(InvalidArgument, match="an estimate"):
        TwoBodies(DelayedEstimate(ExampleDynamics(switched_car()), 0.05))
