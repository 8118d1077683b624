"""Looking at robots that have no pose: what is said, and what is found wrong with somebody's equations."""

import numpy as np
import pytest

from hardware.emulation.sensed_robot import Equations, SensedRobot
from hardware.robot import find_robot
from hardware.run_report import Reason, Stops
from sysid_evo.system import Channel, System


class Tank(Equations):
    """A level that a pump raises and a leak lowers."""

    system = System(
        states=(Channel("level", "m", low=0.0, high=1.0),),
        controls=(Channel("pump", "V", low=0.0, high=10.0), Channel("valve", levels=(0.0, 1.0))),
        dt=0.5,
    )
    flow, leak = 0.02, 1.0

    def rates_of_change(self, states, controls):
        return self.flow * controls[:, :1] - self.leak * (0.1 + controls[:, 1:]) * states


def findings(physics):
    return {finding.what: finding for finding in SensedRobot("tank", physics).look_at(seconds=2.0, seed=1)}


def test_sound_equations_have_nothing_wrong_and_their_answers_are_told():
    found = findings(Tank())
    assert all(finding.ok for finding in found.values())
    assert found["system"].sentence.startswith(
        "States: level (0 to 1 m). Controls: pump (0 to 10 V), valve (0, 1). One sample every 0.5 s"
    )
    assert "level 0 m" in found["sensors"].sentence
    assert found["rest"].sentence == "Without a command for 150 s it stays where it is."
    assert "at 0 V: level 0 m; at 10 V: level 0 to 1 m (level held at the limit)" in found["pump"].sentence
    assert "with the other controls full, at 0: level 0 to 1 m" in found["valve"].sentence


def test_a_control_that_changes_nothing_is_found():
    class Forgotten(Tank):
        flow = 0.0

    found = findings(Forgotten())
    assert not found["pump"].ok
    assert "changes nothing in 150 s" in found["pump"].sentence


def test_equations_that_leave_all_bounds_are_found_with_state_and_time():
    class Bursting(Tank):
        system = System(Tank.system.states, Tank.system.controls, dt=0.5)
        envelope = None

        def rates_of_change(self, states, controls):
            return controls[:, :1] + states**2

    found = findings(Bursting())
    assert found["rest"].ok
    assert not found["pump"].ok
    assert "at 10 V: it leaves all bounds: level is no finite number after" in found["pump"].sentence


def test_a_control_without_limits_is_found_before_it_is_recorded():
    class Unlimited(Tank):
        system = System(states=("level",), controls=("pump", Channel("valve", low=0.0, high=1.0)), dt=0.5)

    found = findings(Unlimited())
    assert not found["pump"].ok
    assert "give low and high" in found["pump"].sentence


def test_a_stop_from_outside_leaves_the_rest_out():
    stops = Stops()
    stops.request(Reason.SIGINT)
    found = SensedRobot("tank", Tank()).look_at(seconds=2.0, stops=stops)
    assert [finding.what for finding in found] == ["system", "sensors", "rest", "speed"]


@pytest.mark.parametrize("name", ["pendulum", "cart_pole", "thermal", "gymnasium(id='MountainCar-v0')"])
def test_every_robot_without_a_pose_that_comes_with_the_program_is_sound(name):
    robot = find_robot(name)
    found = {finding.what: finding for finding in robot.look_at(seconds=1.0, seed=2)}
    assert all(finding.ok for finding in found.values()), [f.sentence for f in found.values() if not f.ok]
    assert all(channel.name in found["system"].sentence for channel in robot.system.states)


def test_an_environment_tells_how_its_episodes_go_under_random_controls():
    found = {f.what: f.sentence for f in find_robot("gymnasium(id='CartPole-v1')").look_at(seconds=8.0, seed=3)}
    assert "force (-10, 10 N)" in found["system"]
    assert "in 400 steps; rewards from 1 to 1 a step" in found["episodes"]
    low, high = (float(word) for word in found["episodes"].split("after ")[1].split(" steps")[0].split(" to "))
    assert 5 < low < high < 200
    assert np.isfinite(low)
