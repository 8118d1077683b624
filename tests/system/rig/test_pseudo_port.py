"""The pseudo-terminal as a serial port: raw bytes both ways, and a plug that can be pulled."""

import os
import select
import tty

import pytest

from tests.system.rig.pseudo_port import PseudoPort

EVERY_BYTE = bytes(range(256))


def host(port):
    """Open the port as a host does."""
    end = os.open(port.link, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(end)
    return end


def test_every_byte_passes_unchanged_both_ways(tmp_path):
    port = PseudoPort(tmp_path / "port")
    port.plug()
    end = host(port)
    os.write(end, EVERY_BYTE)
    select.select([port.fileno()], [], [], 5.0)
    assert port.read() == EVERY_BYTE
    assert port.read() == b""
    port.write(EVERY_BYTE)
    assert os.read(end, 4096) == EVERY_BYTE
    os.close(end)
    port.unplug()


def test_hosts_come_and_go(tmp_path):
    port = PseudoPort(tmp_path / "port")
    port.plug()
    for _ in range(3):
        os.close(host(port))
        assert port.read() == b""
    port.unplug()


def test_a_pulled_plug_ends_the_host_s_session_and_comes_back_under_the_same_name(tmp_path):
    port = PseudoPort(tmp_path / "port")
    port.plug()
    end = host(port)
    port.unplug()
    assert not port.link.exists()
    assert os.read(end, 1) == b""
    with pytest.raises(OSError, match="error"):
        os.write(end, b"x")
    assert port.read() == b""
    port.write(b"x")
    port.plug()
    again = host(port)
    port.write(b"back")
    assert os.read(again, 4) == b"back"
    os.close(end)
    os.close(again)
    port.unplug()


def test_what_the_host_does_not_read_is_lost_and_nobody_waits(tmp_path):
    port = PseudoPort(tmp_path / "port")
    port.plug()
    for _ in range(100):
        port.write(EVERY_BYTE)
    port.unplug()
