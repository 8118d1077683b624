"""A made-up drive whose velocities are known, and log files written from it."""

import numpy as np
import pytest

from sysid_evo.data import RawLog
from tests.fixtures.recordings import CAR_MAP, POSE_MAP

FINE = 20  # integration steps for each row


class Drive:
    """A body with sinusoidal velocities: forward 1 + 0.5 sin, lateral 0.2 cos, yaw rate 1.5 sin + 0.3.

    ``pose`` (N, 3) is integrated twenty times finer than the rows, at ``time`` (N,).
    """

    def __init__(self, *, rate=200.0, seconds=6.0, frequency=1.0):
        self.frequency = frequency
        self.time = np.arange(round(rate * seconds) + 1) / rate
        fine = np.arange((len(self.time) - 1) * FINE + 1) / (rate * FINE)
        forward, lateral, yaw_rate = self.velocity(fine).T
        heading = _integral(yaw_rate, fine)
        x = _integral(forward * np.cos(heading) - lateral * np.sin(heading), fine)
        y = _integral(forward * np.sin(heading) + lateral * np.cos(heading), fine)
        self.pose = np.stack([x, y, heading], axis=1)[::FINE]

    def velocity(self, time):
        """Return forward speed, lateral speed and yaw rate, (N, 3)."""
        angle = 2.0 * np.pi * self.frequency * time
        return np.stack([1.0 + 0.5 * np.sin(angle), 0.2 * np.cos(angle), 1.5 * np.sin(angle) + 0.3], axis=1)

    def log(self, *, keep=None, stamps=None, name="drive"):
        """Return a log, of the rows ``keep`` only; its controls are the number of the row and 1."""
        keep = np.arange(len(self.time)) if keep is None else keep
        controls = np.stack([keep.astype(float), np.ones(len(keep))], axis=1)
        time = self.time if stamps is None else stamps
        return RawLog(name, time[keep], self.pose[keep], controls)


def _integral(rate, time):
    middle = 0.5 * (rate[1:] + rate[:-1]) * np.diff(time)
    return np.concatenate([[0.0], np.cumsum(middle)])


@pytest.fixture
def make_drive():
    return Drive


@pytest.fixture
def columns_file(tmp_path):
    """A function that writes the column map of a car with its pose, with some text replaced, and returns its path."""

    def write(*changes, name="car.toml"):
        text = CAR_MAP + POSE_MAP
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


@pytest.fixture
def table():
    """Columns of a 20 Hz log of the drive above without sideways motion, 10 s."""
    drive = Drive(rate=20.0, seconds=10.0, frequency=0.4)
    time = drive.time
    forward, _, yaw_rate = drive.velocity(time).T
    heading = drive.pose[:, 2]
    x, y = _integral(forward * np.cos(heading), time), _integral(forward * np.sin(heading), time)
    switch = np.sign(np.sin(3.0 * time)).round()
    wrapped = np.arctan2(np.sin(heading), np.cos(heading))
    return {
        "t": time, "x": x, "y": y, "yaw": wrapped, "u": forward, "r": yaw_rate,
        "throttle": 0.8 * np.cos(2.0 * time), "steering": switch,
    }  # fmt: skip


@pytest.fixture
def write_csv(tmp_path):
    """A function that writes columns as CSV and returns the path."""

    def write(columns, name="log.csv", separator=","):
        path = tmp_path / name
        rows = zip(*(column.tolist() for column in columns.values()), strict=True)
        lines = [separator.join(columns), *(separator.join(map(repr, row)) for row in rows)]
        path.write_text("\n".join(lines) + "\n")
        return path

    return write
