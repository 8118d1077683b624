"""The journal: comes back as it was written, up to a crash, and takes nothing hostile."""

import json
import math
import os
import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.connection import Command, GateLimits, Measurement, RobotStatus
from hardware.recording.journal import LONGEST, MAGIC, SCHEMA, Recorder, read_journal
from hardware.recording.journal_reader import raw_log
from hardware.toy_car import CAR
from sysid_evo.errors import InvalidArgument, InvalidData

GO = Command(0, 5.0, 5.0, np.array([1.0, 0.0]))


def measurement(number, body="car"):
    time = 5.0 + 0.005 * number
    return Measurement(time, time + 0.004, number, body, True, np.array([0.005 * number, -2.0, 0.5]))


def session(path, frames=40):
    """Return a recorder that was told of ``frames`` frames, a command every ten, a status after each."""
    recorder = Recorder(path, CAR, robot="toy")
    for number in range(frames):
        recorder.on_measurement(measurement(number))
        if number % 10 == 0:
            tick, time = number // 10, 5.0 + 0.005 * number
            recorder.on_command(Command(tick, time, time, np.array([1.0, -1.0])))
            recorder.on_status(
                RobotStatus(time + 0.01, 100.0 + time, "driving", np.array([1.0, 0.0]), {"crc": tick, "late": 7})
            )
    return recorder


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.rcj"


def frames_of(path):
    return [event for event in read_journal(path).events if isinstance(event, Measurement)]


def rewritten(path, data):
    path.write_bytes(data)
    return read_journal(path)


def test_all_events_are_read_in_the_order_they_were_recorded(path):
    with session(path) as recorder:
        pass
    recorder.close()
    journal = read_journal(path)
    assert (journal.system, journal.closed, journal.torn) == (CAR, True, 0)
    frames = frames_of(path)
    assert (journal.header["robot"], [frame.frame for frame in frames]) == ("toy", list(range(40)))
    assert repr(frames[7]) == repr(measurement(7))
    assert np.array_equal(frames[7].pose, measurement(7).pose)
    assert [timed.command.tick for timed in journal.commands] == [0, 1, 2, 3]
    assert np.array_equal(journal.commands[0].command.control, [1.0, -1.0])
    status = [event for event in journal.events if isinstance(event, RobotStatus)][2]
    assert (status.state, dict(status.counters), status.robot_time) == ("driving", {"crc": 2, "late": 7}, 105.1)
    kinds = [type(event).__name__ for event in journal.events[:4]]
    assert kinds == ["Measurement", "TimedCommand", "RobotStatus", "Measurement"]


def test_commands_carry_the_time_on_the_robots_clock(path):
    session(path).close()
    times = [timed.robot_time for timed in read_journal(path).commands]
    assert math.isnan(times[0])
    assert times[1:] == pytest.approx([100.0 + 5.0 + 0.05 * tick - 0.01 for tick in (1, 2, 3)])


def test_unfinished_journal_is_whole_up_to_its_last_record(path):
    recorder = session(path)
    journal = read_journal(path)
    assert len(frames_of(path)) == 40
    assert not journal.closed
    recorder.close()
    assert read_journal(path).closed


def test_torn_tail_costs_the_last_record_only(path):
    session(path).close()
    data = path.read_bytes()
    whole = read_journal(path).events
    end = len(data) - 9
    for cut in range(end - 1, end - 58, -1):
        journal = rewritten(path, data[:cut])
        assert len(journal.events) == len(whole) - 1
        assert journal.torn > 0 or cut == end - 57
    damaged = bytearray(data[:end])
    damaged[-10] ^= 1
    assert len(rewritten(path, bytes(damaged)).events) == len(whole) - 1
    assert rewritten(path, data[:end] + bytes(4096)).torn == 4096


def test_damage_in_the_middle_is_refused(path):
    session(path).close()
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x10
    with pytest.raises(InvalidData, match=r"run\.rcj, byte \d+"):
        rewritten(path, bytes(data))


def record(kind, payload, length=None):
    front = struct.pack("<IB", len(payload) if length is None else length, kind) + payload
    return front + struct.pack("<I", zlib.crc32(front))


def header(**fields):
    return json.dumps({"schema": SCHEMA, "system": CAR.to_dict(), **fields}).encode()


@pytest.mark.parametrize(
    "data, said",
    [
        (b"", "begins with"),
        (b"t,x,y\n", "begins with"),
        (MAGIC, "nothing was recorded"),
        (MAGIC + record(1, b"{}", length=2**31), f"at most {LONGEST} bytes"),
        (MAGIC + record(1, b"{"), "not JSON"),
        (MAGIC + record(1, b"[" * 5000), "not JSON"),
        (MAGIC + record(1, b"[]"), "an object"),
        (MAGIC + record(1, b'{"schema": "sysid-evo/journal/2"}'), "schema"),
        (MAGIC + record(1, b'{"schema": "sysid-evo/journal/1", "system": {"states": 3}}'), "a system"),
        (MAGIC + record(1, header(limits={"speed": -1.0})), "limits of the gate: gate: speed: expected a number"),
        (MAGIC + record(1, header(limits={"pace": 1.0})), "limits of the gate"),
        (MAGIC + record(1, header(limits={"speed": "9"})), "limits of the gate"),
        (MAGIC + record(2, b""), "header, as the first record"),
        (MAGIC + record(77, b""), "no kind of record has the number 77"),
    ],
)
def test_hostile_files_are_refused(data, said, path):
    with pytest.raises(InvalidData, match=said):
        rewritten(path, data)


@pytest.mark.parametrize(
    "kind, payload",
    [(1, b"{}"), (2, b""), (2, bytes(25) + b"\xff" * 24), (2, bytes(26) + bytes(16)), (3, bytes(31)), (4, bytes(40)),
     (2, struct.pack("<ddqBB", 0, 0, 0, 1, 2) + b"\xff\xff" + bytes(24)),
     (4, struct.pack("<ddBH", 0, 0, 0, 5) + b"[[[[[" + bytes(16)),
     (4, struct.pack("<ddBH", 0, 0, 0, 8) + b'{"a":[]}' + bytes(16))],
)  # fmt: skip
def test_records_that_do_not_hold_what_they_should_are_refused(kind, payload, path):
    session(path)
    with pytest.raises(InvalidData, match="byte"):
        rewritten(path, path.read_bytes() + record(kind, payload) + record(2, b""))


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=4), st.integers(0, 10**6))
def test_flipped_and_cut_journals_are_a_beginning_of_the_events_or_invalid_data(tmp_path_factory, flips, cut):
    path = tmp_path_factory.mktemp("flipped") / "run.rcj"
    session(path, 12).close()
    whole = read_journal(path).events
    data = bytearray(path.read_bytes())
    for place, value in flips:
        data[place % len(data)] = value
    path.write_bytes(data[: len(data) - cut % (len(data) + 1) if cut % 2 else len(data)])
    try:
        events = read_journal(path).events
    except InvalidData:
        return
    assert [repr(event) for event in events] == [repr(event) for event in whole[: len(events)]]


def test_journal_is_never_overwritten(path):
    session(path).close()
    with pytest.raises(InvalidArgument, match="exists already"):
        Recorder(path, CAR, robot="toy")


def test_a_full_disk_is_reported_and_raises_nothing(path, monkeypatch):
    recorder = session(path, 5)
    write = os.write
    monkeypatch.setattr(os, "write", lambda file, data: write(file, data[:10]))
    recorder.on_measurement(measurement(5))
    monkeypatch.undo()
    assert recorder.lost == 1
    assert "disk full" in str(recorder.problem)
    recorder.on_measurement(measurement(6))
    recorder.close()
    assert [frame.frame for frame in frames_of(path)] == [0, 1, 2, 3, 4, 6]


def test_events_that_cannot_be_packed_are_counted_not_raised(path):
    with session(path, 1) as recorder:
        recorder.on_measurement(Measurement(0.0, 0.0, 2**70, "car", True, np.zeros(3)))
        recorder.on_measurement(measurement(3, body="ü" * 400))
    assert recorder.lost == 1
    assert frames_of(path)[-1].body == "ü" * 127


def driven(path, frames, **options):
    """Record a frame, a command and further frames; return the journal."""
    with Recorder(path, CAR, robot="toy", **options) as recorder:
        recorder.on_measurement(measurement(0))
        recorder.on_command(GO)
        for frame in frames:
            recorder.on_measurement(frame)
    return read_journal(path)


def test_commands_are_in_force_for_150_ms_at_most(path):
    log, _ = raw_log(driven(path, map(measurement, range(1, 61))))
    assert np.flatnonzero(log.controls[:, 0] == 0.0)[0] == 31
    assert log.pose[:, 0] == pytest.approx(0.005 * np.arange(61))


def test_break_of_the_track_leaves_a_hole_that_no_preparation_bridges(path):
    frames = [measurement(number) for number in range(1, 61)]
    frames[9:20] = [replace(frame, pose=np.array([0.05, -2.0, 0.5])) for frame in frames[9:20]]
    log, _ = raw_log(driven(path, frames))
    (hole,) = np.flatnonzero(np.diff(log.time) > 0.006)
    assert log.time[hole] == pytest.approx(0.005 * 19)
    assert np.diff(log.time)[hole] == pytest.approx(0.03)


def test_journal_keeps_the_limits_of_its_gate(path):
    limits = GateLimits(speed=math.inf, jump=math.inf, turn=2.0, frozen=None)
    journal = driven(path, [measurement(900)], limits=limits)
    assert journal.limits == limits
    assert len(raw_log(journal)[0].time) == 2
    with pytest.raises(InvalidData, match="at least two plausible frames"):
        raw_log(journal, GateLimits())


def test_journal_without_a_run_is_refused_as_a_log(path):
    session(path, 0).close()
    with pytest.raises(InvalidData, match="never driven"):
        raw_log(read_journal(path))
