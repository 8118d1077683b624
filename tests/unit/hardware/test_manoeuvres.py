"""The scripted manoeuvres."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.emulation.car_physics import CarParameters
from hardware.recording.manoeuvres import KINDS, excitation_manoeuvres, measuring_manoeuvres
from hardware.robot import find_robot
from sysid_evo.data import Dataset
from sysid_evo.data.response import manoeuvre_results
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.registry import make_robot
from sysid_evo.system import Channel, System


def test_six_minutes_in_twelve_manoeuvres_of_legal_commands_with_a_share_of_all_nine(car, rng):
    manoeuvres = excitation_manoeuvres(car, rng=rng)
    assert len({manoeuvre.name for manoeuvre in manoeuvres}) == len(manoeuvres) == 12
    assert all(manoeuvre.controls.shape == (600, 2) for manoeuvre in manoeuvres)
    controls = np.concatenate([manoeuvre.controls for manoeuvre in manoeuvres])
    assert np.isin(controls, [-1.0, 0.0, 1.0]).all()
    commands, counts = np.unique(controls, axis=0, return_counts=True)
    assert len(commands) == 9
    assert counts.min() > 0.02 * len(controls)
    assert all(np.all(m.controls[:10] == 0.0) and np.any(m.controls[10:15]) for m in manoeuvres[:5]), "begin at rest"


def test_manoeuvres_are_what_they_are_called(car, rng):
    by_name = {manoeuvre.name: manoeuvre.controls[10:] for manoeuvre in excitation_manoeuvres(car, rng=rng)}
    for name, drive in (("loops-forward", 1.0), ("figure-8-forward", 1.0), ("loops-backward", -1.0)):
        assert np.all(by_name[name][:, 0] == drive)
    assert 0.0 not in by_name["figure-8-backward"][:, 1]
    assert 0.0 not in by_name["reversals"][:, 0]
    assert set(by_name["starts-and-stops"][:, 0]) == {-1.0, 0.0, 1.0}
    switches = [np.any(np.diff(by_name[f"random-{mean}"], axis=0) != 0.0, axis=1).mean() for mean in (0.1, 0.4, 1.6)]
    assert switches[0] > 2.0 * switches[1] > 4.0 * switches[2]


def test_same_rng_gives_the_same_manoeuvres(car):
    one, same, other = (
        np.stack([m.controls for m in excitation_manoeuvres(car, rng=np.random.default_rng(seed))])
        for seed in (1, 1, 2)
    )
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def test_excited_car_moves_as_the_paper_reports(rng):
    car = make_robot("emulated_car").dynamics
    controls = np.stack(
        [manoeuvre.controls for manoeuvre in excitation_manoeuvres(car.system, duration=240.0, rng=rng)]
    )
    batch, steps = controls.shape[:2]
    carry = car.start(np.zeros((batch, 2, 3)), np.zeros((batch, 1, 2)), rng.standard_normal((batch, 3)))
    states = np.empty((batch, steps, 3))
    for k in range(steps):
        carry = car.step(carry, controls[:, k], rng.standard_normal((batch, car.n_noise)))
        states[:, k] = carry[:, :3]
    assert np.sqrt(np.mean(states**2, axis=(0, 1))) == pytest.approx([1.1, 0.08, 1.6], rel=0.15)


def test_continuous_controls_use_their_limits_and_neutral(car, rng):
    names, lows, highs = ("throttle", "trim", "wheel"), (0.0, -1.0, -2.0), (0.8, 1.0, 2.0)
    channels = tuple(Channel(name, low=low, high=high) for name, low, high in zip(names, lows, highs, strict=True))
    throttle = replace(car, controls=channels)
    manoeuvres = excitation_manoeuvres(throttle, duration=60.0, rng=rng)
    assert not any("backward" in manoeuvre.name or "reversal" in manoeuvre.name for manoeuvre in manoeuvres)
    controls = np.concatenate([manoeuvre.controls for manoeuvre in manoeuvres])
    assert set(controls[:, 0]) == {0.0, 0.8}
    assert set(controls[:, 2]) == {-2.0, 0.0, 2.0}
    scripted = np.concatenate([m.controls for m in manoeuvres if "random" not in m.name])
    assert np.all(scripted[:, 1] == 0.0)


def test_system_without_steering_is_excited_too(car, rng):
    manoeuvres = excitation_manoeuvres(replace(car, controls=car.controls[:1]), duration=70.0, rng=rng)
    assert [manoeuvre.name for manoeuvre in manoeuvres[:2]] == ["starts-and-stops", "reversals"]
    assert all(manoeuvre.controls.shape == (200, 1) for manoeuvre in manoeuvres)


def test_what_cannot_be_excited_is_refused(car, rng):
    with pytest.raises(InvalidArgument, match="at least 12 s"):
        excitation_manoeuvres(car, duration=5.0, rng=rng)
    with pytest.raises(InvalidArgument, match="'throttle' has no finite limits"):
        excitation_manoeuvres(replace(car, controls=(Channel("throttle"),)), rng=rng)


def test_a_system_that_goes_nowhere_gets_steps_switches_and_sweeps_over_all_of_its_range(rng):
    system = make_robot("thermal").system
    manoeuvres = {m.name: m.controls[5:, 0] for m in excitation_manoeuvres(system, duration=1080.0, rng=rng)}
    assert all(len(controls) > 250 for controls in manoeuvres.values())
    assert "steps-0.6-2" in manoeuvres
    fast, slow = (np.mean(np.diff(manoeuvres[name]) != 0.0) for name in ("steps-0.6", "steps-20"))
    assert fast > 10.0 * slow > 0.0
    assert np.histogram(manoeuvres["steps-0.6"], bins=4, range=(0.0, 1.0))[0].min() > 20
    assert set(manoeuvres["switches-1"]) == {0.0, 1.0}
    crossings = np.flatnonzero(np.diff(manoeuvres["sweep-to-fast"] > 0.5))
    assert np.diff(crossings)[0] > 2 * np.diff(crossings)[-1]


def test_a_sweep_of_a_switch_takes_its_nearest_level_one_control_after_the_other(car, rng):
    system = replace(car, motion=None)
    sweep = next(
        m for m in excitation_manoeuvres(system, duration=720.0, rng=rng) if m.name == "sweep-to-slow"
    ).controls
    assert np.isin(sweep, [-1.0, 0.0, 1.0]).all()
    assert sweep[:150, 0].any()
    assert not sweep[:150, 1].any()
    assert sweep[150:290, 1].any()
    assert not sweep[150:290, 0].any()


@pytest.fixture(scope="module")
def said():
    robot, episodes = find_robot("emulated_car"), []
    for kind in KINDS:
        episodes += robot.record_manoeuvres(measuring_manoeuvres(robot.system, kind), seed=0).dataset.episodes
    return {one.name: one for one in manoeuvre_results(Dataset(robot.system, tuple(episodes)))}


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
    assert (found, said["drag forward"].unit) == (pytest.approx(expected, rel=0.1), "1/s")


def test_a_first_order_system_shows_its_time_constant_and_its_steady_value():
    system = System((Channel("heat", "K"),), (Channel("power", "W", 0.0, 2.0),), dt=0.1)
    (step,) = measuring_manoeuvres(system, "step")
    assert step.name == "step-power-2"
    state = [0.0]
    for power in step.controls[:, 0]:
        state.append(state[-1] + (3.0 * power - state[-1]) * -np.expm1(-0.1 / 0.7))
    found = manoeuvre_results(Dataset.from_arrays(system, [np.array(state)], [step.controls], names=[step.name]))
    assert [one.name for one in found] == ["steady heat", "time constant of heat"]
    assert (found[0].value, found[1].value) == (pytest.approx(6.0, rel=0.01), pytest.approx(0.7, abs=0.03))
    assert str(found[0]).startswith("steady heat: 6 +- ")


def test_a_continuous_drive_goes_round_at_two_speeds_and_back_to_rest(car):
    drive = Channel("drive", low=-1.0, high=1.0)
    system = replace(car, controls=(drive, car.controls[1]))
    manoeuvres = measuring_manoeuvres(system, "circle")
    assert {tuple(m.controls[len(m.controls) // 3]) for m in manoeuvres} == {
        (speed, side) for speed in (1.0, 0.5, -0.5, -1.0) for side in (-1.0, 1.0)
    }
    assert all((m.controls[[0, -1]] == 0.0).all() for m in manoeuvres)
    assert len(measuring_manoeuvres(car, "circle")) == 4


def test_what_cannot_be_driven_is_refused_in_a_sentence(car):
    heater = System(("heat",), (Channel("power", "W", 0.0, 2.0),), dt=0.1)
    with pytest.raises(InvalidArgument, match="expected one of step, coast_down, circle, got 'loop'"):
        measuring_manoeuvres(car, "loop")
    with pytest.raises(InvalidArgument, match="expected a system that drives, this one has no motion; use step"):
        measuring_manoeuvres(heater, "circle")
    environment = find_robot("gymnasium")
    with pytest.raises(IncompatibleSystem, match="recorded without manoeuvres"):
        environment.record_manoeuvres(measuring_manoeuvres(environment.system, "step"), seed=0)
