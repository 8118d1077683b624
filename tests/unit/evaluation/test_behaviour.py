"""What a controller does: known paths give known numbers, and these the words for them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from evaluation.behaviour import (
    DrivingSummary,
    Measure,
    chase,
    driving_sentence,
    driving_sentences,
    driving_summaries,
    driving_summary,
    trial_measures,
)
from evaluation.report.report import to_json
from evaluation.report.sections.behaviour import driving_table, measured_behaviour_table
from evaluation.transfer.matrix import Trace, TransferMatrix
from evaluation.transfer.matrix import TransferResult as Cell
from sysid_evo.data import Trajectory
from sysid_evo.system import Channel, System
from sysid_evo.tasks import Target
from tests.fixtures import reports as made_up
from tests.fixtures.known_models import SYSTEM
from tests.fixtures.reports import champion

DT = 0.05
RADIUS = 0.3


def path(*legs):
    """Return pose (T + 1, 3), speed and yaw rate of driving legs of (seconds, m/s, rad/s) from the origin."""
    rates = np.concatenate([np.tile([speed, turn], (round(seconds / DT), 1)) for seconds, speed, turn in legs])
    pose = np.zeros((len(rates) + 1, 3))
    for k, (speed, turn) in enumerate(rates):
        heading = pose[k, 2] + 0.5 * turn * DT
        pose[k + 1] = pose[k] + DT * np.array([speed * np.cos(heading), speed * np.sin(heading), turn])
    both = np.concatenate([rates[:1], rates])
    return pose, both[:, 0], both[:, 1]


def trace(*legs, markers=()):
    """Return the trial of a car on this path."""
    pose, speed, turn = path(*legs)
    states = np.zeros((len(pose), SYSTEM.nx))
    states[:, SYSTEM.state_names.index("forward_speed")] = speed
    states[:, SYSTEM.state_names.index("yaw_rate")] = turn
    held = np.zeros((len(pose) - 1, SYSTEM.nu))
    return Trace(Trajectory(states, held, DT, pose), 1.0, np.array(markers).reshape(-1, 2), RADIUS)


def chased(markers, *legs):
    pose, speed, _ = path(*legs)
    return chase(pose[:, :2], np.array(markers), RADIUS, speed, DT, rest_speed=0.1)


def test_a_marker_that_is_driven_straight_to_is_not_missed():
    found = chased([[1.0, 0.2], [3.0, 0.0], [9.0, 0.0]], (4.0, 1.0, 0.0))
    assert (found.markers, found.reached, found.missed, found.reactions, found.orbiting) == (3, 2, 0, (), 0.0)


@pytest.mark.parametrize(
    ("legs", "reaction"),
    [
        (((2.0, 1.0, 0.0), (3.0, 1.0, 1.0)), "drives on"),
        (((1.8, 1.0, 0.0), (0.5, 0.0, 0.0), (3.0, 1.0, 0.5)), "stops"),
        (((1.8, 1.0, 0.0), (3.0, -1.0, 0.0)), "turns back"),
    ],
)
def test_the_reaction_to_a_miss_is_found(legs, reaction):
    found = chased([[1.0, 0.5]], *legs)
    assert found.reactions[0] == reaction
    assert (found.missed, found.reached) == (1, 0)


@pytest.mark.parametrize("marker", [[2.0, 1.0], [-0.5, 0.0]])
def test_to_drive_by_far_away_or_away_from_the_start_is_no_miss(marker):
    assert chased([marker], (4.0, 1.0, 0.0)).missed == 0


def test_the_time_from_a_miss_to_the_marker_is_measured():
    ahead = np.stack([np.linspace(0.0, 2.0, 41), np.zeros(41)], axis=1)
    back = ahead[-1] + np.linspace(0.0, 1.0, 24)[1:, None] * np.array([-1.0, 0.5])  # 1.12 m, at about 1 m/s
    found = chase(np.concatenate([ahead, back]), np.array([[1.0, 0.5]]), RADIUS, np.ones(64), DT, rest_speed=0.1)
    assert (found.missed, found.reached, found.reactions) == (1, 1, ("drives on",))
    assert found.after[0] == pytest.approx(1.0 + (1.118 - RADIUS) / (1.118 / 23 / DT), abs=DT)


def test_circles_around_a_marker_are_orbits_and_circles_next_to_it_are_none():
    around, beside = (chased([[0.0, y]], (12.0, 1.0, 1.0)) for y in (1.0, 3.0))  # circles of 1 m around (0, 1)
    assert around.orbiting == pytest.approx(1.0, abs=0.06)
    assert beside.orbiting == 0.0


def test_driving_backwards_turning_and_stopping_are_shares_of_the_trial():
    one = trace((3.0, -1.0, 0.5), (1.0, 0.0, 0.0), (1.0, 0.8, -0.5), (1.0, 0.0, 0.0))
    found = trial_measures(one, SYSTEM, np.ones(SYSTEM.nx))
    assert found["backwards"] == pytest.approx(0.75, abs=0.01)
    assert found["turning left"] == pytest.approx(0.75, abs=0.01)
    assert found["stops per minute"] == pytest.approx(20.0)
    assert found["at rest"] == pytest.approx(1 / 3, abs=0.01)
    assert found["speed"] == pytest.approx(3.8 / 6.0, abs=0.01)


def test_a_control_of_any_system_switches_and_saturates():
    system = System((Channel("angle", "rad"),), (Channel("torque", low=-2.0, high=2.0),), dt=0.1)
    controls = np.tile([[2.0], [2.0], [-1.0], [-1.05]], (25, 1))
    one = Trace(Trajectory(np.zeros((101, 1)), controls, 0.1), 0.0)
    found = trial_measures(one, system, np.ones(1))
    assert found["torque switches per second"] == pytest.approx(4.9)
    assert found["torque at a limit"] == 0.5
    assert found["torque above neutral"] == 0.5
    assert "backwards" not in found


def test_settling_is_the_time_after_which_no_target_is_left():
    angle = Channel("angle", "rad", period=2 * np.pi)
    system = System((angle,), (Channel("torque", low=-1.0, high=1.0),), dt=0.1)
    states = np.concatenate([np.linspace(3.0, 0.0, 31), np.zeros(70)])[:, None] + 2 * np.pi
    run = Trajectory(states, np.zeros((100, 1)), 0.1)
    one = Trace(run, 0.0, targets=(Target(angle, 0, np.zeros(101), 0.05),))
    found = trial_measures(one, system, np.ones(1))
    assert found["settled"] == 1.0
    assert found["settling time"] == pytest.approx(3.0)
    assert found["within tolerance"] == pytest.approx(71 / 101)
    never = replace(one, targets=(Target(angle, 0, np.ones(101), 0.05),))
    assert trial_measures(never, system, np.ones(1))["settled"] == 0.0
    summary = driving_summary("c", "pendulum", [one, never], system, np.ones(1))
    assert "settles after 3.0 s in 50 % of the trials" in driving_sentence(summary)


def summary(name="c", column="car", **measures):
    named = {key.replace("_", " "): Measure(value, value - 0.01, value + 0.01, 5) for key, value in measures.items()}
    return DrivingSummary(name, column, 5, named)


def test_a_sentence_describes_the_driving():
    orbiting = summary(
        speed=1.2, backwards=0.93, turning_left=0.1, stops_per_minute=3.0, missed_at_first=0.4, orbiting=0.12,
        drives_on_after_a_miss=0.7, stops_after_a_miss=0.25, turns_back_after_a_miss=0.05,
        reached_after_a_miss_in=2.5, drive_switches_per_second=1.5, at_rest=0.02,
    )  # fmt: skip
    assert driving_sentence(orbiting) == (
        "drives backwards 93 % of the time at 1.20 m/s; turns right in 90 % of its turns; stops 3 times a minute; "
        "misses 40 % of the waypoints at first, then drives on (70 %) or stops (25 %), and reaches it 2.5 s later; "
        "orbits a waypoint 12 % of the time; switches drive 1.5 times a second."
    )
    assert "hardly ever misses a waypoint" in driving_sentence(summary(speed=1.0, backwards=0.0, missed_at_first=0.01))


def test_differences_to_the_models_of_the_evolution_are_reported_and_nothing_else():
    robot = summary(speed=1.0, backwards=0.9, orbiting=0.3)
    model = summary(column="sindy", speed=1.05, backwards=0.9, orbiting=0.0)
    told = driving_sentences([model, robot], "car")["c"]
    assert told.startswith("On the robot: drives backwards 90 %")
    assert told.endswith("In sindy: orbiting 0 % instead of 30 %.")
    assert driving_sentences([model], None)["c"].startswith("In sindy: ")


def test_numbers_have_intervals_over_trials_that_stay_where_shares_can_be():
    trials = [trace((4.0, -1.0, 0.0)), trace((4.0, -1.0, 0.0)), trace((2.0, 1.0, 0.0), (2.0, -1.0, 0.0))]
    found = driving_summary("c", "car", trials, SYSTEM, np.ones(SYSTEM.nx)).measures["backwards"]
    assert found.value == pytest.approx((1 + 1 + 0.5) / 3, abs=0.01)
    assert 0.0 <= found.low < found.value < found.high <= 1.0
    assert np.isnan(driving_summary("c", "car", trials[:1], SYSTEM, np.ones(SYSTEM.nx)).measures["backwards"].low)


def recorded():
    traces = (trace((4.0, -1.0, 0.0), markers=[[-1.0, 0.0]]), trace((4.0, -1.0, 0.1)))
    cells = [Cell("c", column, np.ones(2), traces=traces, unit="waypoints") for column in ("a", "b", "car")]
    return TransferMatrix.of([champion("c", ("a",))], ("a", "b", "car"), cells, robot="car")


def test_controllers_are_described_on_the_robot_and_where_they_were_evolved():
    found = driving_summaries(recorded())
    assert [(one.controller, one.column) for one in found] == [("c", "a"), ("c", "car")]
    words, table = driving_table(found, "car"), measured_behaviour_table(found, "car")
    assert words.rows[0][0] == "c"
    assert words.rows[0][1].startswith("On the robot: drives backwards 100 %")
    assert table.columns[:4] == ("controller", "on", "speed\nm/s", "backwards")
    assert driving_table((), None) is measured_behaviour_table((), None) is None


def test_the_report_holds_the_numbers_and_the_sentences():
    document = json.loads(json.dumps(to_json(made_up.report(transfer=recorded())), allow_nan=False))
    row = document["behaviour"][-1]
    assert (row["controller"], row["column"], row["trials"]) == ("c", "car", 2)
    assert row["measures"]["backwards"]["value"] == 1.0
    assert row["measures"]["stops per minute"]["unit"] == "1/min"
    assert "backwards" in row["sentence"]
