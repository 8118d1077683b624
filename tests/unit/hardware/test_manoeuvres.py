"""The scripted manoeuvres."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.recording.manoeuvres import excitation_manoeuvres
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import make_robot
from sysid_evo.system import Channel


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
