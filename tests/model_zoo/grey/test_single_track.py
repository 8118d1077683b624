"""The single-track car: it finds the emulated car's physics, and its tyres do what tyres do."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hardware.emulation.car_physics import CarParameters
from hardware.recording.manoeuvres import measuring
from hardware.robot import find_robot
from model_zoo.car.single_track import MAGIC, PARAMETERS, SingleTrack, magic, pacejka_rate, tanh_rate
from sysid_evo.data import Dataset
from sysid_evo.data.response import measured
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.motion import PlanarBody
from sysid_evo.registry import make_robot
from sysid_evo.system import Channel, System

GUESS = tuple(parameter.guess for parameter in (*PARAMETERS, *MAGIC))


@pytest.fixture(scope="module")
def learned() -> SingleTrack:
    dataset = make_robot("emulated_car").record(seed=0, duration=180.0).dataset
    return SingleTrack(tyre="tanh", starts=1, windows=150).fit(dataset, rng=0)


def test_what_a_recording_tells_of_the_emulated_car_is_found(learned: SingleTrack) -> None:
    """Within a fifth: thrust, grip of the front, where the rear axle is; the lags within 30 ms, with the delay 15 ms.

    The car has battery sag, play, noise and other drags, which this one has not.
    """
    car = CarParameters()
    found = {row["parameter"]: row["value"] for row in learned.parameters_table()}
    assert found["thrust_forward"] == pytest.approx(car.thrust_forward, rel=0.2)
    assert found["thrust_backward"] == pytest.approx(car.thrust_backward, rel=0.2)
    assert found["rolling_resistance"] == pytest.approx(car.rolling_resistance, rel=0.3)
    assert found["front_grip"] == pytest.approx(car.front_grip / car.mass, rel=0.25)
    assert found["steer_left"] / found["steer_right"] == pytest.approx(car.steer_left / car.steer_right, rel=0.1)
    late = 0.05 * found["delay of commands"]
    assert found["lag of drive"] + late == pytest.approx(car.motor_lag + 0.05, abs=0.03)
    assert found["lag of steer"] + late == pytest.approx(car.steering_lag + 0.05, abs=0.03)


@pytest.mark.parametrize("law", [pacejka_rate, tanh_rate])
def test_tyres_push_to_the_side_that_is_steered_to_and_no_more_than_their_grip(law) -> None:
    along, across, turning = law((1.5, 0.0, 0.0), (0.0, 0.5), GUESS)
    mirrored = law((1.5, 0.0, 0.0), (0.0, -0.5), GUESS)
    assert across > 0.0
    assert turning > 0.0
    np.testing.assert_allclose(mirrored, (along, -across, -turning))
    sliding = law((1.5, -9.0, 0.0), (0.0, 0.0), GUESS)
    grip = (
        GUESS[[p.name for p in PARAMETERS].index("front_grip")] + GUESS[[p.name for p in PARAMETERS].index("rear_grip")]
    )
    assert 0.5 * grip < sliding[1] <= grip


def test_the_magic_formula_begins_with_slope_c_and_has_its_peak_at_one() -> None:
    assert magic(1e-6, 1.4, 0.3) == pytest.approx(1.4e-6, rel=1e-6)
    assert max(magic(slip, 1.4, 0.0) for slip in np.linspace(0.0, 20.0, 2001)) == pytest.approx(1.0, abs=1e-4)
    assert magic(50.0, 1.4, 0.0) == pytest.approx(math.sin(1.4 * math.atan(50.0)))


def test_a_car_whose_sideways_speed_is_not_measured_is_refused() -> None:
    states = (Channel("forward_speed"), Channel("yaw_rate"))
    system = System(states, (Channel("drive"), Channel("steer")), 0.05, PlanarBody(lateral=None))
    with pytest.raises(IncompatibleSystem, match="needs the lateral speed"):
        SingleTrack().check_system(system)


def test_manoeuvres_in_the_data_give_guesses_and_priors(learned: SingleTrack) -> None:
    """A fifth of the value at best: they are of another day. Without such episodes there are none."""
    robot = find_robot("emulated_car")
    episodes = [
        episode
        for kind in ("step", "coast_down")
        for episode in robot.record_manoeuvres(measuring(robot.system, kind), seed=0).dataset.episodes
    ]
    data = Dataset(robot.system, tuple(episodes))
    guesses = SingleTrack().guesses_from({one.name: one for one in measured(data)})
    assert set(guesses) == {"rolling_resistance", "drag_linear", "thrust_forward", "thrust_backward", "back_emf"}
    assert guesses["thrust_forward"][0] == pytest.approx(CarParameters().thrust_forward, rel=0.3)
    assert all(spread >= 0.2 * value for value, spread in guesses.values())
    model = SingleTrack(tyre="tanh", starts=1, windows=40).fit(data, rng=0)
    assert "manoeuvres gave first guesses of thrust_forward" in model.fit_note
    assert "manoeuvres" not in learned.fit_note
