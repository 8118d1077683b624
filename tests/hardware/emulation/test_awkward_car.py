"""The awkward car: it starts late, has no reverse, and some of its recordings show nothing."""

import numpy as np
import pytest

from hardware.emulation.car_physics import CarParameters
from hardware.emulation.cars import AWKWARD, AwkwardCar, ToyCarDynamics
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import make_robot

SECOND = 200  # fine steps


def speeds(drive, parameters=AWKWARD):
    """Return the forward speed after each fine step from rest under ``drive`` (T,)."""
    car = ToyCarDynamics(parameters)
    carry = car.start(np.zeros((1, 11, 3)), np.zeros((1, 10, 2)))
    found = np.empty(len(drive))
    for k, value in enumerate(drive):
        carry = car.step(carry, np.array([[value, 0.0]]))
        found[k] = carry[0, 0]
    return found


def test_it_starts_only_after_drive_was_held_and_then_races_as_any_car():
    found, usual = (speeds(np.ones(3 * SECOND), parameters) for parameters in (AWKWARD, CarParameters()))
    assert found[: int(0.38 * SECOND)].max() == 0.0
    assert usual[: int(0.38 * SECOND)].max() > 0.3
    assert found[-1] == pytest.approx(usual[-1], rel=0.02)


def test_short_taps_of_the_drive_do_not_move_it():
    taps = np.tile(np.repeat([1.0, 0.0], [20, 60]), 10)  # 0.1 s in every 0.4 s
    assert speeds(taps).max() == 0.0
    assert speeds(taps, CarParameters()).max() > 0.1


def test_in_reverse_it_stands_and_from_speed_it_brakes():
    assert not speeds(-np.ones(2 * SECOND)).any()
    launched = np.concatenate([np.ones(2 * SECOND), -np.ones(3 * SECOND)])
    coasting = np.concatenate([np.ones(2 * SECOND), np.zeros(3 * SECOND)])
    braked, free = speeds(launched), speeds(coasting)
    assert (braked >= 0.0).all()
    assert braked[int(2.5 * SECOND)] < free[int(2.5 * SECOND)]


def test_a_session_is_free_and_a_jammed_recording_shows_a_standing_car(tmp_path):
    car = make_robot("awkward_car(stuck=1.0)")
    assert isinstance(car, AwkwardCar)
    states = np.concatenate([one.states for one in car.record(seed=0, duration=30.0).dataset.episodes])
    assert np.abs(states[:, 0]).max() < 0.1
    with car.connect(seed=0) as link:
        for _ in range(3 * SECOND):
            link.send(np.array([1.0, 0.0]), valid_for=0.15)
            link.measure(1.0)
    assert np.hypot(*link.pose[:2]) > 1.0


def test_more_than_half_of_a_recording_is_useless():
    episodes = make_robot("awkward_car").record(seed=0, duration=60.0).dataset.episodes
    standing = np.concatenate([np.abs(one.states[:, 0]) < 0.05 for one in episodes])
    assert 0.5 < standing.mean() < 0.8


def test_stuck_is_a_share():
    with pytest.raises(InvalidArgument, match="stuck as a share up to 1"):
        make_robot("awkward_car(stuck=1.5)")
    with pytest.raises(InvalidArgument, match="stuck: expected a number of 0 or more, got -1"):
        make_robot("awkward_car(stuck=-1)")


def test_a_longer_lag_starts_later():
    usual, later = (make_robot(name).physics.parameters for name in ("awkward_car", "awkward_car(start_lag=1.5)"))
    drive = np.ones(2 * SECOND)
    starts = [int(np.argmax(speeds(drive, parameters) > 0.0)) for parameters in (usual, later)]
    assert starts[0] == pytest.approx((0.05 + 0.5 * np.log(2.0)) * SECOND, abs=4)
    assert starts[1] == pytest.approx((0.05 + 1.5 * np.log(2.0)) * SECOND, abs=4)


def test_a_seed_gives_another_car_without_reverse():
    other = make_robot("awkward_car:3").physics.parameters
    assert other.thrust_backward == 0.0
    assert other.start_speed != AWKWARD.start_speed
