"""The emulated car behind the connection of a physical robot."""

from pathlib import Path

import numpy as np
import pytest

from hardware.connection import GateLimits
from sysid_evo.errors import LinkLost
from tests.system.rig.faults import Fault
from tests.system.rig.journal import read_journal
from tests.system.rig.terminal_car import TerminalCar

FORWARD = np.array([1.0, 0.0])


def test_it_drives_where_it_is_told(tmp_path):
    car = TerminalCar(journal=tmp_path / "journal")
    with car.connect(seed=1) as connection:
        poses = []
        for _ in range(20):
            connection.send(FORWARD, valid_for=0.15)
            due = connection.time + 0.05
            while (left := due - connection.time) > 0.0:
                frame = connection.measure(left)
                if frame is not None:
                    poses.append(frame.pose)
        assert connection.status is not None
        assert connection.status.state == "driving"
        np.testing.assert_array_equal(connection.status.control, FORWARD)
    assert poses[-1][0] > 0.3
    entries = read_journal(tmp_path / "journal")
    assert entries[-1].event == "end"
    assert [entry.value for entry in entries if entry.event == "buttons"] == [1, 0]


def test_its_session_has_the_gate_it_was_made_with_and_closing_ends_the_process_once(tmp_path):
    connection = TerminalCar(journal=tmp_path / "journal", gate=GateLimits(speed=8.0)).connect(seed=1)
    assert connection.gate_limits == GateLimits(speed=8.0)
    connection.close()
    connection.close()
    entries = read_journal(tmp_path / "journal")
    assert entries[-1].event == "end"
    assert not Path(f"/proc/{entries[0].value}").exists()
    with pytest.raises(LinkLost, match="closed"):
        connection.measure(0.0)


def test_a_pulled_plug_is_a_lost_link():
    with TerminalCar(faults=[Fault(kind="unplug", at=0.5)]).connect(seed=1) as connection:
        with pytest.raises(LinkLost, match="gone"):
            _watch(connection, 10.0)
        with pytest.raises(LinkLost, match="gone"):
            connection.send(FORWARD, valid_for=0.15)


def _watch(connection, seconds):
    deadline = connection.time + seconds
    while connection.time < deadline:
        connection.measure(0.05)
