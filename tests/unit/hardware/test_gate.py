"""The gate: what a tracker's faults do to a track, and what they must not."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.connection import GateLimits, Measurement
from hardware.gate import PoseGate
from hardware.trackers.tracker import LEAK, SourceClock
from sysid_evo.errors import InvalidArgument

RATE = 200.0  # Hz


def frame(time, pose, body="car", valid=True):
    return Measurement(time, time + 0.004, 0, body, valid, np.asarray(pose, dtype=float))


def drive(count, start=0, rng=None):
    """Return frames of a car that circles at 1 m/s with the errors of marker tracking."""
    rng = np.random.default_rng(start) if rng is None else rng
    times = (start + np.arange(count)) / RATE
    poses = np.stack([np.sin(times), 1.0 - np.cos(times), times], axis=1)
    poses += rng.standard_normal(poses.shape) * [0.001, 0.001, 0.005]
    poses[:, 2] = np.remainder(poses[:, 2] + math.pi, 2 * math.pi) - math.pi
    return [frame(time, pose) for time, pose in zip(times, poses, strict=True)]


def moved(frames, by):
    return [frame(one.source_time, one.pose + by) for one in frames]


def verdicts(gate, frames, *, driving=True):
    return [gate.accept(one, driving=driving) for one in frames]


@pytest.fixture
def gate():
    return PoseGate("car")


def test_driving_is_accepted_as_one_track_and_a_dropout_of_100_ms_breaks_it_not(gate):
    seen = verdicts(gate, drive(3000) + drive(100, start=3020))
    assert all(verdict.accepted for verdict in seen)
    assert sum(verdict.new_track for verdict in seen) == 1


@pytest.mark.parametrize(
    "by, reason",
    [([0.3, 0, 0], "jumped"), ([0.1, 0, 0], "too fast"), ([0, 0, 3.14], "flipped"), ([0, 0, 0.3], "turned too fast")],
)
def test_frames_off_the_track_are_dropped_and_the_track_goes_on(gate, by, reason):
    frames = drive(100)
    frames[40:60] = moved(frames[40:60], by)
    seen = verdicts(gate, frames)
    assert {one.reason for one in seen[40:60]} == {reason}
    assert all(one.accepted and not one.new_track for one in seen[60:])


def test_frames_that_mean_nothing_are_dropped(gate):
    good = drive(10)
    bad = [
        frame(0.02, [0, 0, 0], body="other"), frame(0.02, [0, 0, 0], valid=False), frame(0.02, [0, math.nan, 0]),
        frame(0.02, [0, 0]), frame(math.inf, [0, 0, 0]), good[3],
    ]  # fmt: skip
    verdicts(gate, good[:5])
    reasons = [one.reason for one in verdicts(gate, bad)]
    assert reasons == ["of another body", "not valid", "not a number", "not a number", "not a number", "not newer"]
    assert all(one.accepted and not one.new_track for one in verdicts(gate, good[5:]))


def test_a_swap_with_another_body_is_accepted_only_after_the_end_of_a_run(gate):
    seen = verdicts(gate, drive(100) + moved(drive(200, start=100), [1.5, 0, 0]))
    dropped = list(itertools.takewhile(lambda one: not one.accepted, seen[100:]))
    assert len(dropped) == pytest.approx(0.6 * RATE, abs=1)
    assert [one.new_track for one in seen[100 + len(dropped) :]] == [True] + [False] * (199 - len(dropped))


def test_a_body_within_reach_after_a_dropout_is_accepted_after_ten_frames_as_a_new_track(gate):
    seen = verdicts(gate, drive(100) + drive(100, start=180))
    assert [one.accepted for one in seen[100:110]] == [False] * 9 + [True]
    assert [one.new_track for one in seen[100:]] == [False] * 9 + [True] + [False] * 90


def test_inconsistent_places_are_never_accepted(gate, rng):
    verdicts(gate, drive(100))
    wild = [frame(one.source_time, rng.uniform(-9, 9, 3)) for one in drive(2000, start=100)]
    assert sum(one.accepted for one in verdicts(gate, wild)) < 3


def test_frozen_pose_is_seen_while_driving_only_and_ends_the_track(gate):
    frames = drive(100)
    frozen = [frame(one.source_time, frames[49].pose) for one in frames[50:80]]
    assert all(one.accepted for one in verdicts(gate, frames[:50] + frozen, driving=False))
    gate = PoseGate("car")
    seen = verdicts(gate, frames[:50] + frozen + frames[80:])
    assert [one.accepted for one in seen[50:80]] == [True] * 9 + [False] * 21
    assert (seen[79].reason, [one.new_track for one in seen[80:82]]) == ("frozen", [True, False])
    unlimited = PoseGate("car", GateLimits(frozen=None))
    assert all(one.accepted for one in verdicts(unlimited, frames[:50] + frozen))


def straight(count, speed=0.0, yaw_rate=0.0, *, rate, start=0):
    """Return frames of a body that goes and turns at constant speeds."""
    times = (start + np.arange(count)) / rate
    return [frame(t, [speed * t, 0.0, math.remainder(yaw_rate * t, 2 * math.pi)]) for t in times]


@pytest.mark.parametrize(
    "frames, sentence",
    [
        (straight(60, 8.0, rate=200.0), "it moves at 8.0 m/s, frames above speed = 5 m/s are rejected"),
        (straight(60, yaw_rate=40.0, rate=60.0), "it turns at 40.0 rad/s, frames above yaw_rate = 12"),
        (drive(50) + moved(drive(50, start=50), [1.5, 0, 0]), "it was seen 1."),
        (drive(50) + moved(drive(50, start=50), [0, 0, 3.0]), "it was seen turned by "),
    ],
)
def test_a_body_beyond_the_limits_is_reported_with_its_motion_the_limit_and_its_key(gate, frames, sentence):
    verdicts(gate, frames)
    assert gate.excess.startswith(sentence)
    assert "[gate] of its file" in gate.excess


def test_a_single_frame_far_away_is_no_fast_robot(gate):
    verdicts(gate, drive(98) + moved(drive(1, start=98), [2.0, 0, 0]))
    assert gate.excess.startswith("it was seen 2.0")
    verdicts(gate, moved(drive(20, start=99), [2.0, 0, 0]))
    assert gate.excess.startswith("it was seen ")


def test_nothing_exceeds_a_limit_once_a_frame_is_accepted_again(gate):
    frames = drive(100)
    verdicts(gate, frames[:40] + moved(frames[40:60], [1.0, 0, 0]))
    assert gate.excess
    verdicts(gate, frames[60:61])
    assert gate.excess == ""


def test_a_fast_robot_is_accepted_if_its_limits_allow_it():
    gate = PoseGate("car", GateLimits.read({"speed": 9}))
    assert all(one.accepted for one in verdicts(gate, straight(60, 8.0, rate=200.0)))


@pytest.mark.parametrize(
    "table, sentence",
    [
        ({"sped": 8.0}, "gate: no key is called 'sped'. Did you mean 'speed'?"),
        ({"speed": "fast"}, "gate: speed: expected a number above 0, got 'fast'"),
        ({"speed": math.nan}, "gate: speed: expected a number above 0, got nan"),
        ({"jump": True}, "gate: jump: expected a number above 0, got True"),
        ({"position_error": -1}, "gate: position_error: expected a number of 0 or more, got -1"),
        ({"confirm": 2.5}, "gate: confirm: expected a whole number from 1"),
        ({"frozen": 0}, "gate: frozen: expected a whole number from 1"),
        ({"speed": 0.0}, "gate: speed: expected a number above 0, got 0.0"),
        ({"confirm": 0}, "gate: confirm: expected a whole number from 1"),
        (8.0, "gate: expected a table with some of speed, yaw_rate"),
    ],
)
def test_a_table_of_limits_that_cannot_be_is_refused_in_a_sentence(table, sentence):
    with pytest.raises(InvalidArgument) as raised:
        GateLimits.read(table)
    assert str(raised.value).startswith(sentence)
    if isinstance(table, dict) and table.keys() <= set(GateLimits.__dataclass_fields__):
        with pytest.raises(InvalidArgument, match=next(iter(table))):
            GateLimits(**table)


def test_limits_that_are_left_out_hold_as_for_most_robots():
    assert GateLimits.read(None) == GateLimits.read({}) == GateLimits()
    assert GateLimits.read({"speed": 8}).yaw_rate == GateLimits().yaw_rate


anything = st.builds(
    Measurement,
    source_time=st.one_of(st.floats(), st.floats(0.0, 2.0)),
    arrival_time=st.floats(0.0, 3.0),
    frame=st.integers(0, 400),
    body=st.sampled_from(["car", "car", "car", "other"]),
    valid=st.sampled_from([True, True, False]),
    pose=st.one_of(st.lists(st.floats(), max_size=4), st.lists(st.floats(-0.4, 0.4), min_size=3, max_size=3)).map(
        np.array
    ),
)


@settings(max_examples=50)
@given(st.lists(st.tuples(anything, st.booleans()), max_size=60))
def test_whatever_comes_no_two_frames_of_a_track_contradict_the_limits(script):
    gate, limits = PoseGate("car"), GateLimits()
    last = None
    for one, driving in sorted(script, key=lambda step: step[0].source_time):
        verdict = gate.accept(one, driving=driving)
        assert verdict.accepted == (verdict.reason == "")
        assert verdict.accepted or not verdict.new_track
        if not verdict.accepted:
            continue
        assert one.valid
        assert one.body == "car"
        if last is not None:
            dt = one.source_time - last.source_time
            assert dt > 0.0
            if not verdict.new_track:
                step = math.dist(one.pose[:2], last.pose[:2])
                turn = abs(math.remainder(one.pose[2] - last.pose[2], 2 * math.pi))
                assert step <= min(limits.jump, limits.speed * dt + limits.position_error)
                assert turn <= min(limits.turn, limits.yaw_rate * dt + limits.heading_error)
        else:
            assert verdict.new_track
        last = one


def mapped(clock, source, arrival):
    return np.array([clock.map(s, a) for s, a in zip(source, arrival, strict=True)])


@pytest.mark.parametrize("drift", [-1e-4, 0.0, 1e-4])
def test_mapped_times_are_late_by_the_shortest_way_whatever_the_jitter_and_drift(drift, rng):
    true = 1000.0 + np.arange(20_000) * 0.005
    arrival = true + 0.002 + rng.exponential(0.003, len(true))
    source = (true - 990.0) * (1.0 + drift)
    error = mapped(SourceClock(), source, arrival) - true
    assert np.all(np.abs(error[200:] - 0.002) < 3e-4)


def test_backlog_read_at_once_keeps_the_ages_of_its_frames():
    clock = SourceClock()
    mapped(clock, np.arange(200) * 0.005, 50.0 + np.arange(200) * 0.005)
    stalled = np.arange(200, 1200) * 0.005
    times = mapped(clock, stalled, np.full(1000, 56.0))
    assert times == pytest.approx(50.0 + stalled, abs=2 * LEAK * 5.0)


def test_mapped_times_are_never_after_the_arrival_not_even_by_rounding(rng):
    source, arrival = np.sort(rng.uniform(0, 9, 500)), np.sort(rng.uniform(0, 9, 500))
    assert np.all(mapped(SourceClock(), source, arrival) <= arrival)
    source, arrival = 472.14271545271333, 100.7012080683658
    assert source + (arrival - source) > arrival
    assert SourceClock().map(source, arrival) <= arrival


@pytest.mark.parametrize("jump", [-3600.0, 3600.0])
def test_a_source_that_sets_its_clock_is_mapped_again(jump):
    clock = SourceClock()
    mapped(clock, np.arange(100) * 0.005, 50.0 + np.arange(100) * 0.005)
    after = np.arange(100, 200) * 0.005
    assert mapped(clock, after + jump, 50.0 + after) == pytest.approx(50.0 + after, abs=1e-3)
    assert clock.restarts == 1
