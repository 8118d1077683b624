"""The fail-safes of the whole chain, few times each; ``python -m tests.benchmarks.robot`` does it many times.

Bounds in time are those of the firmware, which opens the buttons when a command outlives its 150 ms,
plus what a loaded machine may take from the processes that watch it.
"""

import signal
from pathlib import Path

import numpy as np
import pytest

from hardware.connection import GateLimits
from sysid_evo.errors import LinkLost
from tests.benchmarks.robot.blinding import BOUND, blind
from tests.benchmarks.robot.cutting import cut
from tests.benchmarks.robot.killing import kill
from tests.benchmarks.robot.stopping import stop
from tests.benchmarks.robot.suspending import suspend
from tests.system.rig.faults import Fault
from tests.system.rig.journal import read_journal
from tests.system.rig.killed_recorder import kill_once
from tests.system.rig.terminal_car import TerminalCar

LOAD = 0.2  # s
SEED = 5
FORWARD = np.array([1.0, 0.0])


def check(rows):
    for row in rows:
        assert row.holds, f"{row.case}: {row.demand}: {row.passed} of {row.count}, {row.figures}"


@pytest.mark.parametrize("repeats", [1, pytest.param(20, marks=pytest.mark.nightly)])
def test_buttons_open_when_the_host_is_killed(tmp_path, repeats):
    check(kill(tmp_path, repeats=repeats, seed=SEED, margin=LOAD))


def test_a_terminated_host_stops_the_car_and_says_that_it_failed(tmp_path):
    check(stop(tmp_path, repeats=1, seed=SEED, bound=0.05 + LOAD, cases=(signal.SIGTERM,)))


def test_a_host_that_was_stopped_for_a_second_does_not_drive_on(tmp_path):
    check(suspend(tmp_path, repeats=1, seed=SEED, durations=(1.0,)))


def test_a_cut_line_stops_the_car_and_another_version_is_refused(tmp_path):
    check(cut(tmp_path, repeats=1, seed=SEED, margin=LOAD, kinds=("unplug",)))


def test_a_blind_tracker_stops_the_car_and_no_speed_comes_out_of_a_jump(tmp_path):
    check(blind(tmp_path, repeats=1, seed=SEED, bound=BOUND + LOAD, faults=(("dropout", 0.3), ("identity_swap", 0.3))))


@pytest.mark.nightly
@pytest.mark.parametrize(
    "attack",
    [
        lambda folder: stop(folder, repeats=2, seed=SEED, bound=0.05 + LOAD),
        lambda folder: cut(folder, repeats=3, seed=SEED, margin=LOAD),
        lambda folder: blind(folder, repeats=3, seed=SEED, bound=BOUND + LOAD),
        lambda folder: suspend(folder, repeats=3, seed=SEED),
    ],
    ids=[
        "a host that ends in any way",
        "a clogged line and a reset",
        "all faults of the tracker",
        "stops of any length",
    ],
)
def test_the_car_stops_in_every_case_of_the_benchmarks(tmp_path, attack):
    check(attack(tmp_path))


def test_recorder_that_is_killed_loses_at_most_one_record(tmp_path):
    for number in range(3):
        trial = kill_once(tmp_path / f"{number}.rcj", delay=0.02 + 0.013 * number)
        assert 0 <= trial.lost <= 1
        assert trial.stored > 10


def forward_for_a_second(journals):
    """Return connection, poses and journal; begin anew where the machine pauses longer than a command lives."""
    for attempt in range(5):
        journal, poses = journals / f"journal{attempt}", []
        connection = TerminalCar(journal=journal, gate=GateLimits(speed=8.0)).connect(seed=1)
        try:
            for _ in range(20):
                connection.send(FORWARD, valid_for=0.15)
                due = connection.time + 0.05
                while (left := due - connection.time) > 0.0:
                    if (frame := connection.measure(left)) is not None:
                        poses.append(frame.pose)
        except LinkLost as lost:
            connection.close()
            if "longest pause" not in str(lost):
                raise
        else:
            return connection, poses, journal
    raise AssertionError("this machine pauses too often")


def test_a_physical_connection_drives_the_car_and_closing_ends_its_process_once(tmp_path):
    connection, poses, journal = forward_for_a_second(tmp_path)
    assert connection.gate_limits == GateLimits(speed=8.0)
    assert connection.status.state == "driving"
    np.testing.assert_array_equal(connection.status.control, FORWARD)
    connection.close()
    connection.close()
    assert poses[-1][0] > 0.3
    entries = read_journal(journal)
    assert entries[-1].event == "end"
    assert [entry.value for entry in entries if entry.event == "buttons"] == [1, 0]
    assert not Path(f"/proc/{entries[0].value}").exists()
    with pytest.raises(LinkLost, match="closed"):
        connection.measure(0.0)


def test_a_pulled_plug_is_a_lost_link():
    with TerminalCar(faults=[Fault(kind="unplug", at=0.5)]).connect(seed=1) as connection:
        with pytest.raises(LinkLost, match="gone"):
            [connection.measure(0.05) for _ in range(2000)]  # ten seconds of frames
        with pytest.raises(LinkLost, match="gone"):
            connection.send(FORWARD, valid_for=0.15)
