"""Replay: a log as a tracker, at its own pace or as fast as it is asked."""

from __future__ import annotations

import select
from pathlib import Path

import numpy as np
import pytest

from hardware.connection import Measurement
from hardware.recording.journal import Recorder
from sysid_evo.errors import InvalidArgument, InvalidData, LinkLost
from sysid_evo.registry import trackers
from sysid_evo.system import System
from tests.fixtures.trackers import read_all


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.csv"
    path.write_text("t,x,y,heading,drive\n" + "".join(f"{1 + 0.01 * i},{i},0.5,-0.25,1\n" for i in range(20)))
    return path


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_replay_keeps_the_pace_of_the_log_and_ends(log, speed):
    with trackers.make("replay", body="car", path=str(log), speed=speed).open() as stream:
        frames, last = read_all(stream)
    assert [frame.pose[0] for frame in frames] == list(range(20))
    assert np.diff([frame.source_time for frame in frames]) == pytest.approx(0.01 / speed)
    assert frames[-1].arrival_time - frames[0].arrival_time >= 0.18 / speed
    assert all(frame.arrival_time >= frame.source_time for frame in frames)
    assert "ended" in last


def test_replay_at_speed_0_gives_frames_when_asked_with_the_times_of_the_log(log):
    with trackers.make("replay", body="car", path=str(log), speed=0.0).open() as stream:
        assert select.select([stream], [], [], 0.0)[0] == [stream]
        frames, _ = read_all(stream)
    assert [frame.source_time for frame in frames] == pytest.approx(1.0 + 0.01 * np.arange(20))


def test_replay_of_a_journal_gives_its_frames(car: System, tmp_path):
    told = [
        Measurement(t, t + 0.004, n, "car", n != 2, np.array([t, 0, 0])) for n, t in enumerate((1.0, 1.1, 1.2, 1.3))
    ]
    with Recorder(tmp_path / "run.rcj", car, robot="toy") as recorder:
        for frame in told:
            recorder.measured(frame)
    with trackers.make("replay", body="car", path=str(tmp_path / "run.rcj"), speed=0.0).open() as stream:
        frames, _ = read_all(stream)
    assert [(frame.source_time, frame.valid) for frame in frames] == [(one.source_time, one.valid) for one in told]
    with pytest.raises(LinkLost, match="no frame of 'truck'"):
        trackers.make("replay", body="truck", path=str(tmp_path / "run.rcj"), speed=0.0).open()


def test_logs_that_cannot_be_replayed_are_refused(tmp_path):
    with pytest.raises(InvalidArgument, match="speed"):
        trackers.make("replay", body="car", path="x.csv", speed=-1.0)
    with pytest.raises(InvalidData, match="expected a log"):
        trackers.make("replay", body="car", path=str(tmp_path / "x.csv")).open()
    (tmp_path / "x.csv").write_text("t,x,y,heading\n1,0,0,0\n0,0,0,0\n")
    with pytest.raises(InvalidData, match="rising"):
        trackers.make("replay", body="car", path=str(tmp_path / "x.csv")).open()
