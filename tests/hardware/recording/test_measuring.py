"""Manoeuvres that measure, and what they say of the emulated car."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.emulation.car_physics import CarParameters
from hardware.recording.manoeuvres import KINDS, measuring
from hardware.robot import find_robot
from sysid_evo.data import Dataset
from sysid_evo.data.response import measured
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.system import Channel, System


@pytest.fixture(scope="module")
def said():
    robot, episodes = find_robot("emulated_car"), []
    for kind in KINDS:
        episodes += robot.record_manoeuvres(measuring(robot.system, kind), seed=0).dataset.episodes
    return {one.name: one for one in measured(Dataset(robot.system, tuple(episodes)))}


def test_top_speeds_and_turning_radii_of_the_emulated_car_are_measured(said):
    """It does 1.8 to 2.0 m/s forward and 1.3 to 1.45 backward, as the battery is; its circles are known to 5 %."""
    assert said["top speed forward"].value == pytest.approx(1.9, rel=0.08)
    assert said["top speed backward"].value == pytest.approx(1.38, rel=0.08)
    radii = {name.split(" at ")[0]: one.value for name, one in said.items() if "radius" in name}
    expected = {"left, forward": 0.60, "right, forward": 0.66, "left, backward": 0.46, "right, backward": 0.66}
    assert radii == {f"turning radius {name}": pytest.approx(value, rel=0.05) for name, value in expected.items()}


def test_the_losses_of_coasting_add_up_to_those_of_the_car(said):
    """Resistance and drag trade against each other in one run; at 1 m/s they add up to 1.25 m/s^2."""
    car = CarParameters()
    expected = car.rolling_resistance + car.coasting_drag + car.rolling_drag
    found = said["rolling resistance forward"].value + said["drag forward"].value
    assert found == pytest.approx(expected, rel=0.1)
    assert said["drag forward"].unit == "1/s"


def test_a_first_order_system_shows_its_time_constant_and_its_steady_value():
    system = System((Channel("heat", "K"),), (Channel("power", "W", 0.0, 2.0),), dt=0.1)
    (step,) = measuring(system, "step")
    assert step.name == "step-power-2"
    state = [0.0]
    for power in step.controls[:, 0]:
        state.append(state[-1] + (3.0 * power - state[-1]) * -np.expm1(-0.1 / 0.7))
    found = measured(Dataset.from_arrays(system, [np.array(state)], [step.controls], names=[step.name]))
    assert [one.name for one in found] == ["steady heat", "time constant of heat"]
    assert found[0].value == pytest.approx(6.0, rel=0.01)
    assert found[1].value == pytest.approx(0.7, abs=0.03)
    assert str(found[0]).startswith("steady heat: 6 +- ")


def test_a_continuous_drive_goes_round_at_two_speeds_and_back_to_rest(car):
    drive = Channel("drive", low=-1.0, high=1.0)
    system = replace(car, controls=(drive, car.controls[1]))
    manoeuvres = measuring(system, "circle")
    assert {tuple(m.controls[len(m.controls) // 3]) for m in manoeuvres} == {
        (speed, side) for speed in (1.0, 0.5, -0.5, -1.0) for side in (-1.0, 1.0)
    }
    assert all((m.controls[[0, -1]] == 0.0).all() for m in manoeuvres)
    assert len(measuring(car, "circle")) == 4


def test_what_cannot_be_driven_is_refused_in_a_sentence(car):
    with pytest.raises(InvalidArgument, match="expected one of step, coast_down, circle, got 'loop'"):
        measuring(car, "loop")
    heater = System(("heat",), (Channel("power", "W", 0.0, 2.0),), dt=0.1)
    with pytest.raises(InvalidArgument, match="expected a system that drives, this one has no motion; take step"):
        measuring(heater, "circle")


def test_an_environment_is_not_driven_through_manoeuvres():
    robot = find_robot("gymnasium")
    with pytest.raises(IncompatibleSystem, match="recorded without manoeuvres"):
        robot.record_manoeuvres(measuring(robot.system, "step"), seed=0)
