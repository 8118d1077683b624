"""Faults: when their windows are open, and what they do to bytes."""

import json
import math

import numpy as np
import pytest

from sysid_evo.errors import InvalidArgument
from tests.system.rig.faults import KINDS, Fault, FaultSchedule
from tests.system.rig.wire import Wire

DATA = bytes(range(1, 256)) * 20


def wire_with(*faults, seed=5):
    return Wire(FaultSchedule(faults, start=100.0), np.random.default_rng(seed))


def through(wire, data=DATA):
    wire.push(data, 100.0)
    return wire.pull(100.0)


def test_a_window_repeats_and_ends():
    fault = Fault(kind="unplug", at=2.0, every=10.0, duration=1.0)
    schedule = FaultSchedule([fault], start=100.0)
    opened = [t for t in np.arange(100.0, 130.0, 0.5) if any(schedule.active("unplug", t))]
    assert opened == [102.0, 102.5, 112.0, 112.5, 122.0, 122.5]
    assert [schedule.windows("unplug", t) for t in (101.9, 102.0, 111.9, 112.0)] == [0, 1, 1, 2]


def test_the_next_change_is_the_next_edge_of_any_window():
    schedule = FaultSchedule([Fault(kind="unplug", at=2.0, every=10.0, duration=1.0), Fault(kind="reset", at=4.0)], 0.0)
    assert [schedule.next_change(t) for t in (0.0, 2.0, 3.5, 4.0, 12.0, 12.5)] == [2.0, 3.0, 4.0, 12.0, 13.0, 13.0]
    assert FaultSchedule([], 0.0).next_change(1.0) == math.inf


def test_a_fault_told_later_counts_from_then():
    schedule = FaultSchedule([], start=100.0)
    schedule.add(Fault(kind="silence", at=1.0, duration=2.0), now=150.0)
    assert [any(schedule.active("silence", t)) for t in (150.0, 151.5, 153.5)] == [False, True, False]


def test_a_fault_that_is_written_comes_back():
    for fault in (Fault(kind="reset", at=3.0), Fault(kind="delay", at=1.0, duration=2.0, every=4.0, seconds=0.1)):
        assert Fault(**json.loads(fault.to_json())) == fault


@pytest.mark.parametrize(
    "entries",
    [
        {"kind": "gremlin"},
        {"kind": "drop", "probability": 1.5},
        {"kind": "drop", "at": -1.0},
        {"kind": "unplug", "duration": 2.0, "every": 1.0},
        {"kind": "unplug", "probability": 0.5},
        {"kind": "delay"},
        {"kind": "drop", "seconds": 1.0},
    ],
)
def test_senseless_faults_are_refused(entries):
    with pytest.raises(InvalidArgument, match="fault"):
        Fault(**entries)


def test_every_kind_can_be_made():
    for kind in KINDS:
        Fault(kind=kind, seconds=0.1 if kind == "delay" else 0.0)


def test_a_line_without_faults_passes_everything():
    assert through(wire_with()) == DATA


def test_flipped_bytes_are_as_many_as_asked_for_and_really_differ():
    damaged = through(wire_with(Fault(kind="flip", probability=0.1)))
    assert len(damaged) == len(DATA)
    hit = sum(a != b for a, b in zip(damaged, DATA, strict=True))
    assert hit == pytest.approx(0.1 * len(DATA), abs=5.0 * math.sqrt(0.09 * len(DATA)))


def test_dropped_and_doubled_bytes_are_as_many_as_asked_for():
    spread = 5.0 * math.sqrt(0.09 * len(DATA))
    assert len(through(wire_with(Fault(kind="drop", probability=0.1)))) == pytest.approx(0.9 * len(DATA), abs=spread)
    assert len(through(wire_with(Fault(kind="duplicate", probability=0.1)))) == pytest.approx(
        1.1 * len(DATA), abs=spread
    )


def test_the_same_seed_damages_the_same_bytes():
    fault = Fault(kind="flip", probability=0.1)
    assert through(wire_with(fault)) == through(wire_with(fault)) != through(wire_with(fault, seed=6))


def test_delayed_bytes_keep_their_order():
    wire = wire_with(Fault(kind="delay", probability=0.1, seconds=0.5))
    early = through(wire)
    assert early == DATA[: len(early)]
    assert 0 < len(early) < len(DATA)
    assert wire.due == pytest.approx(100.5)
    assert early + wire.pull(100.5) == DATA


def test_a_stall_holds_everything_back_until_it_ends():
    wire = wire_with(Fault(kind="stall", at=1.0, duration=2.0))
    wire.push(b"before", 100.5)
    wire.push(b"within", 101.5)
    assert wire.pull(102.9) == b"before"
    assert wire.pull(103.0) == b"within"
